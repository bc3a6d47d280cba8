//! Tests of the program and the library from outside. One binary, because each would link everything.

mod calibrate;
mod checks;
mod cli;
mod config;
mod desk;
mod docs;
mod fixed_point;
mod fixtures;
mod fleet;
mod fuzz;
mod joint_names;
mod options;
mod outputs;
mod pairs;
mod plan;
mod program;
mod real;
mod reports;
mod robot;
mod row_layouts;
mod rule_registry;
mod tables;
mod two_arms;
mod unnamed_columns;
mod viewer;
mod watch;
