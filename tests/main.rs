//! Tests of the program and the library from outside. One binary, because each would link everything.

mod calibrate;
mod checks;
mod cli;
mod columns;
mod config;
mod desk;
mod docs;
mod fixtures;
mod fleet;
mod fuzz;
mod meta;
mod names;
mod options;
mod outputs;
mod plan;
mod program;
mod real;
mod reports;
mod robot;
mod tables;
mod viewer;
mod watch;
