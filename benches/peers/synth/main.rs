//! Our side of the comparison of training images: reads the files that every rival reads, prints one JSON line.
//!
//! `synth_rival blend --data DIR --mode normal|mixed --crop NAME --background NAME --rounds R --out PNG`: see
//! [`blend`].
//! `synth_rival image --data DIR --size 640x480 --crops S|L --blend random|poisson --n 60 [--out DIR] [--streamed]`:
//! see [`image`]. Bind it to one core; it starts no thread.

#![allow(clippy::print_stdout, reason = "results go to standard output")]

mod blend;
mod image;

use clap::{Parser, Subcommand};

#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Seamless cloning of one crop into the middle of one background.
    Blend(blend::Options),
    /// Whole training images: three objects on a photo.
    Image(image::Options),
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().task {
        Task::Blend(options) => blend::run(&options),
        Task::Image(options) => image::run(&options),
    }
}
