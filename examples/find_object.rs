//! Finds a taught object in one RGB-D frame: the fifteen lines that a robot needs.
//!
//! Takes the object and the frames of the demo, so run that first: `cargo run --release -- demo`, then
//! `cargo run --release -p examples --example find_object`. Writes `out/examples/find_object.png`.

#![allow(clippy::print_stdout, reason = "an example talks")]

use std::path::Path;

use anyhow::Context as _;
use posepipe::bop::BopSplit;
use posepipe::report::save_png;
use posepipe::{Finder, ObjectFolder, Outcome, picture_of};

fn main() -> anyhow::Result<()> {
    let object = ObjectFolder::load(Path::new("out/demo/object")).context("run the demo first")?;
    let model = object.model.clone();
    let finder = Finder::new(object)?;

    let frame = BopSplit::open(Path::new("out/demo/captures_full_0/test"))?.scene(0)?.load(0)?;
    let finding = finder.find(&frame.color, &frame.depth, &frame.camera)?;
    match &finding.outcome {
        Outcome::Found(found) => println!("camera_from_object:{}", found.camera_from_object.to_homogeneous()),
        Outcome::Refused(reason) => println!("no pose: {reason}"),
    }
    println!("in {:.0} ms", 1000.0 * finding.times.total());

    std::fs::create_dir_all("out/examples")?;
    let path = Path::new("out/examples/find_object.png");
    save_png(path, &picture_of(&frame.color, &finding, &model, &frame.camera)?)?;
    println!("picture: {}", path.display());
    Ok(())
}
