//! The `posepipe` program: teach an object from captures, find it in frames, score it, or see it all in a demo.

mod cli;

fn main() -> std::process::ExitCode {
    cli::run()
}
