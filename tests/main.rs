//! What the program and the library do, from outside: one binary, as each links all that there is.

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
