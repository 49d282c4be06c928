//! Task files, clouds, and the clock.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Instant;
use std::{fs, hint};

use anyhow::{Context as _, Result, ensure};
use icp::nearest::{FlatTree, NearestSearch};
use nalgebra::{Isometry3, Matrix4, Point3, Rotation3, UnitQuaternion};
use serde_json::{Value, json};

/// Calls of which the median is taken.
pub(crate) const REPEATS: usize = 15;

pub(crate) const PEER: &str = "ours";

/// A folder of tasks.
pub(crate) struct Tasks {
    folder: PathBuf,
    pub(crate) threads: usize,
}

impl Tasks {
    pub(crate) fn new(folder: impl AsRef<Path>, threads: usize) -> Self {
        Self { folder: folder.as_ref().to_owned(), threads }
    }

    /// The rows of a task file, as texts.
    pub(crate) fn rows(&self, name: &str) -> Result<Vec<Vec<String>>> {
        let path = self.folder.join(format!("{name}.tsv"));
        let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        Ok(text.lines().map(|line| line.split('\t').map(str::to_owned).collect()).collect())
    }

    pub(crate) fn cloud(&self, name: &str) -> Result<Vec<Point3<f32>>> {
        let path = self.folder.join("clouds").join(format!("{name}.f32"));
        let bytes = fs::read(&path).with_context(|| path.display().to_string())?;
        ensure!(bytes.len() % 12 == 0, "{}: {} bytes are no triples of floats", path.display(), bytes.len());
        let value = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        Ok(bytes.chunks_exact(12).map(|p| Point3::new(value(p), value(&p[4..]), value(&p[8..]))).collect())
    }

    pub(crate) fn voxel_grids(&self) -> Result<()> {
        for row in self.rows("voxel")? {
            let (cloud, leaf) = (self.cloud(&row[0])?, row[1].parse()?);
            let (ms, thinned) = median_ms(REPEATS, || icp::voxel_grid(&cloud, leaf));
            self.emit("voxel", json!({"cloud": row[0], "ms": ms, "n": thinned?.len()}));
        }
        Ok(())
    }

    pub(crate) fn nearest_neighbors(&self) -> Result<()> {
        for row in self.rows("nn")? {
            let (target, queries) = (self.cloud(&row[0])?, self.cloud(&row[1])?);
            let (build_ms, tree) = median_ms(REPEATS, || FlatTree::new(&target));
            let tree = tree?;
            let (query_ms, found) = median_ms(REPEATS, || tree.nearest(&queries, f32::INFINITY));
            let sum: f64 = found.iter().flatten().map(|found| f64::from(found.distance)).sum();
            self.emit("nn", json!({"cloud": row[0], "build_ms": build_ms, "query_ms": query_ms, "sum": sum}));
        }
        Ok(())
    }

    /// Prints a result; `fields` is an object.
    pub(crate) fn emit(&self, kind: &str, mut fields: Value) {
        if let Some(object) = fields.as_object_mut() {
            object.insert("kind".to_owned(), kind.into());
            object.insert("threads".to_owned(), self.threads.into());
            object.entry("peer").or_insert_with(|| PEER.into());
        }
        println!("{fields}");
    }
}

/// What was made once for a name, with the time it took.
pub(crate) struct Made<T> {
    made: HashMap<String, (f64, T)>,
}

impl<T> Made<T> {
    pub(crate) fn new() -> Self {
        Self { made: HashMap::new() }
    }

    /// Makes `key` if it is new, in the median of a few repeats.
    pub(crate) fn get(&mut self, key: &str, repeats: usize, make: impl FnMut() -> Result<T>) -> Result<&(f64, T)> {
        if !self.made.contains_key(key) {
            let (ms, made) = median_ms(repeats, make);
            self.made.insert(key.to_owned(), (ms, made?));
        }
        self.made.get(key).context("made above")
    }
}

/// Median of the times of `repeats` calls in milliseconds, and what the last one gave.
pub(crate) fn median_ms<R>(repeats: usize, mut call: impl FnMut() -> R) -> (f64, R) {
    let mut timed = || {
        let start = Instant::now();
        let result = hint::black_box(call());
        (start.elapsed().as_secs_f64() * 1e3, result)
    };
    let (first, mut result) = timed();
    let mut times = vec![first];
    for _ in 1..repeats {
        let (ms, latest) = timed();
        times.push(ms);
        result = latest;
    }
    times.sort_by(f64::total_cmp);
    (times[times.len() / 2], result)
}

/// A pose from sixteen numbers, row by row.
pub(crate) fn pose(text: &str) -> Result<Isometry3<f64>> {
    let numbers = text.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>()?;
    ensure!(numbers.len() == 16, "a pose has {} numbers, 16 are needed", numbers.len());
    let matrix = Matrix4::from_row_slice(&numbers);
    let rotation =
        Rotation3::from_matrix_eps(&matrix.fixed_view::<3, 3>(0, 0).into_owned(), 1e-12, 100, Rotation3::identity());
    let translation = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    Ok(Isometry3::from_parts(translation.into(), UnitQuaternion::from_rotation_matrix(&rotation)))
}

/// Sixteen numbers, row by row.
pub(crate) fn numbers(pose: &Isometry3<f64>) -> Vec<f64> {
    pose.to_homogeneous().transpose().iter().copied().collect()
}
