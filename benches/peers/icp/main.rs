//! Our side of the registration comparison: reads task files and clouds, prints one JSON line per result.
//!
//! `icp_rival WORK THREADS SUITES`: `WORK` holds `clouds/*.f32` (little-endian x, y, z), `align.tsv`, `views.tsv`,
//! `voxel.tsv` and `nn.tsv`; `SUITES` is a comma list of `voxel`, `nn`, `speed`, `basin_bin`, `basin_lidar`,
//! `sixdof_bunny`, `views`, `starts`. Peers print the same lines; one script scores them all.

#![allow(clippy::print_stdout, reason = "results go to standard output")]

mod align;
mod starts;
mod tasks;
mod views;

use std::env;

use anyhow::{Context as _, Result, ensure};

use crate::tasks::Tasks;

fn main() -> Result<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    ensure!(arguments.len() == 3, "usage: icp_rival WORK THREADS SUITE[,SUITE]");
    let threads: usize = arguments[1].parse().context("THREADS")?;
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    let tasks = Tasks::new(&arguments[0], threads);
    for suite in arguments[2].split(',') {
        match suite {
            "voxel" => tasks.voxel_grids()?,
            "nn" => tasks.nearest_neighbors()?,
            "speed" => align::run(&tasks, |name| name.starts_with("speed"), tasks::REPEATS)?,
            "basin_bin" | "basin_lidar" | "sixdof_bunny" => align::run(&tasks, |name| name == suite, 1)?,
            "views" => views::run(&tasks)?,
            "starts" => starts::run(&tasks)?,
            other => anyhow::bail!("unknown suite {other}"),
        }
    }
    Ok(())
}
