//! What the program and the library do, from outside: one binary, as each links all that there is.

mod checks;
mod cli;
mod config;
mod docs;
mod fixtures;
mod fleet;
mod fuzz;
mod meta;
mod outputs;
mod program;
mod reports;
mod robot;
mod viewer;
