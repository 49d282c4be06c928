//! Single views of a bin through three stages, from the centroid.

use anyhow::Result;
use icp::{IcpConfig, Metric, Target};
use nalgebra::Isometry3;
use serde_json::json;

use crate::align::METHODS;
use crate::tasks::{Tasks, median_ms, numbers, pose};

/// First leaves of the paper's scheme, metres.
const LEAVES: [f64; 3] = [0.04, 0.08, 0.12];

/// Three stages with the paper's distances, by any metric.
fn paper(leaf: f64, metric: Metric) -> IcpConfig {
    IcpConfig { metric, normal_neighbors: 20, ..IcpConfig::paper(leaf) }
}

pub(crate) fn run(tasks: &Tasks) -> Result<()> {
    let rows = tasks.rows("views")?;
    for leaf in LEAVES {
        for (method, metric) in METHODS {
            scheme(tasks, &rows, &format!("views_{leaf}"), method, &paper(leaf, metric))?;
        }
    }
    // The default does not take its leaf from the suite; it is listed with the first.
    scheme(tasks, &rows, "views_0.04", "default", &IcpConfig::default())?;
    Ok(())
}

fn scheme(tasks: &Tasks, rows: &[Vec<String>], suite: &str, method: &str, config: &IcpConfig) -> Result<()> {
    let target = Target::new(&tasks.cloud(&rows[0][1])?, config)?;
    for row in rows {
        let (view, start): (_, Isometry3<f64>) = (tasks.cloud(&row[2])?, pose(&row[4])?);
        let (ms, found) = median_ms(3, || target.align(&view, &start));
        let (reached, iterations) = found.map_or((start, 0), |found| (found.target_from_source, found.iterations));
        tasks.emit(
            "ms3",
            json!({
                "method": method, "suite": suite, "case": row[0], "ms": ms, "iters": iterations, "T": numbers(&reached),
            }),
        );
    }
    Ok(())
}
