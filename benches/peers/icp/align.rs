//! Alignments of given clouds from given poses.

use anyhow::Result;
use icp::{IcpConfig, Metric, Source, Target};
use nalgebra::Isometry3;
use serde_json::json;

use crate::tasks::{Made, Tasks, median_ms, numbers, pose};

/// Names of the methods in the result lines.
pub(crate) const METHODS: [(&str, Metric); 3] =
    [("p2p", Metric::PointToPoint), ("p2l", Metric::PointToPlane { point_share: 0.0 }), ("gicp", Metric::Gicp)];

/// Until converged, as the peers are set: both steps below 1e-4, at most 50 iterations, normals of 20 neighbours.
fn config(metric: Metric, distance: f64) -> IcpConfig {
    IcpConfig {
        metric,
        normal_neighbors: 20,
        max_iterations: 50,
        rotation_epsilon: 1e-4,
        translation_epsilon: 1e-4,
        ..IcpConfig::every_point(distance)
    }
}

/// Twenty iterations, whatever the steps.
fn twenty(metric: Metric, distance: f64) -> IcpConfig {
    let never = f64::MIN_POSITIVE;
    IcpConfig { max_iterations: 20, rotation_epsilon: never, translation_epsilon: never, ..config(metric, distance) }
}

/// Runs the rows of `align.tsv` whose suite is `wanted`.
pub(crate) fn run(tasks: &Tasks, wanted: impl Fn(&str) -> bool, repeats: usize) -> Result<()> {
    let preparations = repeats.min(5);
    let mut targets = Made::<Target>::new();
    let mut sources = Made::<Source>::new();
    for row in tasks.rows("align")?.iter().filter(|row| wanted(&row[0])) {
        let (distance, start): (f64, Isometry3<f64>) = (row[5].parse()?, pose(&row[7])?);
        for (method, metric) in METHODS {
            let kinds = [("align", config(metric, distance)), ("fixed20", twenty(metric, distance))];
            for (kind, config) in &kinds[..if repeats > 1 { 2 } else { 1 }] {
                let key = format!("{kind} {method} {distance}");
                let (target_ms, target) = targets.get(&format!("{key} {}", row[2]), preparations, {
                    let points = tasks.cloud(&row[2])?;
                    move || Ok(Target::new(&points, config)?)
                })?;
                let (source_ms, source) = sources.get(&format!("{key} {}", row[3]), preparations, {
                    let points = tasks.cloud(&row[3])?;
                    move || Ok(target.prepare(&points)?)
                })?;
                let (ms, found) = median_ms(repeats, || target.align_prepared(source, &start));
                // A start from which nothing is found stays where it is, as with the peers.
                let (reached, iterations) =
                    found.map_or((start, 0), |found| (found.target_from_source, found.iterations));
                tasks.emit(
                    kind,
                    json!({
                        "method": method, "suite": row[0], "case": row[1], "ms": ms,
                        "prep_ms": target_ms + source_ms, "iters": iterations, "T": numbers(&reached),
                    }),
                );
            }
        }
    }
    Ok(())
}
