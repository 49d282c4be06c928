//! Arguments and dispatch of the program.

mod demo;
mod eval;
mod find;
mod progress;
mod say;
mod simulate;
mod summary;
mod teach;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use say::complain;

/// Teach a known rigid object from RGB-D photos, then find its pose, on an ordinary CPU.
#[derive(Debug, Parser)]
#[command(version, about)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The whole job on simulated captures: simulate, crop, train, find, report.
    Demo(demo::Arguments),
    /// Write simulated captures of the paper's laundry bin, with true poses and masks.
    Simulate(simulate::Arguments),
    /// Teach an object from a BOP-format folder of captures.
    Teach(Box<teach::Arguments>),
    /// Find a taught object in one RGB-D frame and print its pose as JSON.
    Find(find::Arguments),
    /// Find a taught object in frames with known poses, and report masks, poses and times.
    Eval(eval::Arguments),
}

/// Runs the program; errors go to standard error with their causes.
pub(crate) fn run() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Teach(arguments) => teach::run(&arguments),
        Command::Find(arguments) => find::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&format!("error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
