//! Many start poses for one view: the best of fifty.

use std::collections::BTreeMap;

use anyhow::Result;
use icp::{HypothesisConfig, IcpConfig, Target};
use nalgebra::Isometry3;
use serde_json::json;

use crate::tasks::{Tasks, median_ms, numbers, pose};

/// The starts of `sixdof_bunny`, all those of a view at once; the answer is emitted as case `v#_h0`.
pub(crate) fn run(tasks: &Tasks) -> Result<()> {
    let mut views = BTreeMap::<String, Vec<Vec<String>>>::new();
    for row in tasks.rows("align")?.into_iter().filter(|row| row[0] == "sixdof_bunny") {
        views.entry(row[3].clone()).or_default().push(row);
    }
    let config = IcpConfig::default();
    for (view, rows) in &views {
        let target = Target::new(&tasks.cloud(&rows[0][2])?, &config)?;
        let source = tasks.cloud(view)?;
        let guesses = rows.iter().map(|row| pose(&row[7])).collect::<Result<Vec<Isometry3<f64>>>>()?;
        let search = HypothesisConfig { turned: true, ..HypothesisConfig::default() };
        let (ms, found) = median_ms(5, || target.align_from_many(&source, &guesses, &search));
        let best = found?.into_iter().next();
        let (reached, iterations) =
            best.map_or((Isometry3::identity(), 0), |best| (best.target_from_source, best.iterations));
        tasks.emit(
            "align",
            json!({
                "method": "best of 50", "suite": "sixdof_bunny", "case": rows[0][1], "ms": ms, "iters": iterations,
                "T": numbers(&reached),
            }),
        );
    }
    Ok(())
}
