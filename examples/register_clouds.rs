//! Registers a partial, noisy view of an object to its model cloud.
//!
//! Shows `icp` alone: a model prepared once, many start turns, the paper's point-to-point scheme beside the default.
//! Run with `cargo run --release -p examples --example register_clouds`. Prints both errors.

#![allow(clippy::print_stdout, reason = "an example talks")]

use std::f64::consts::TAU;

use icp::{HypothesisConfig, IcpConfig, Target, hypotheses};
use nalgebra::{Isometry3, Point3, Vector3};

fn main() -> anyhow::Result<()> {
    let model = bracket();
    let truth = Isometry3::new(Vector3::new(0.1, -0.05, 0.8), Vector3::new(0.0, 0.0, 2.2));
    let view = seen_from_one_side(&model, &truth);
    println!("model {} points, view {} points", model.len(), view.len());

    for (name, config) in [("paper", IcpConfig::paper(0.04)), ("default", IcpConfig::default())] {
        let target = Target::new(&model, &config)?;
        let seen = icp::centroid(&view).expect("the view has points");
        let upright = hypotheses::at_centroid(&target.centroid(), &seen, &nalgebra::UnitQuaternion::identity());
        let guesses: Vec<_> = hypotheses::yaw_about(&Vector3::z_axis(), &target.centroid(), 12)
            .into_iter()
            .map(|turn| turn * upright)
            .collect();
        let found = target.align_from_many(&view, &guesses, &HypothesisConfig::default())?;
        let best = found.first().ok_or_else(|| anyhow::anyhow!("no start led to a pose"))?;
        let error = best.target_from_source * truth;
        println!(
            "{name:>8}: {:.2} mm and {:.3} degrees off, {:.0} % of the view on the model, {} iterations",
            1000.0 * error.translation.vector.norm(),
            error.rotation.angle().to_degrees(),
            100.0 * best.inlier_share,
            best.iterations
        );
    }
    Ok(())
}

/// An L-shaped bracket of two plates, 0.3 m and 0.2 m long, sampled on a grid.
fn bracket() -> Vec<Point3<f32>> {
    let plate = |length: f32, place: fn(f32, f32) -> Point3<f32>| {
        let steps = (length / 0.004) as usize;
        (0..steps).flat_map(move |i| (0..30).map(move |j| place(i as f32 * 0.004, j as f32 * 0.004)))
    };
    let mut points: Vec<_> = plate(0.3, |along, across| Point3::new(along, across, 0.0)).collect();
    points.extend(plate(0.2, |along, across| Point3::new(0.0, across, along)));
    points.extend(plate(0.1, |along, across| Point3::new(across, 0.0, 0.7 * along)));
    points
}

/// The model moved to `camera_from_object`, without its far part, with a fixed ripple for noise.
fn seen_from_one_side(model: &[Point3<f32>], camera_from_object: &Isometry3<f64>) -> Vec<Point3<f32>> {
    model
        .iter()
        .filter(|point| point.x + point.z < 0.22)
        .enumerate()
        .map(|(index, point)| {
            let ripple = 0.001 * (index as f64 * TAU / 7.3).sin();
            let moved = camera_from_object * point.cast::<f64>();
            (moved + Vector3::z() * ripple).cast::<f32>()
        })
        .collect()
}
