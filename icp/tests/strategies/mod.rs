//! Clouds and motions shared by the tests: those of `icp::strategies`, and how to compare two poses.

#![allow(dead_code, unused_imports, reason = "each test file uses its own share")]

pub(crate) use icp::strategies::{cloud, motion, moved, solid};
use nalgebra::{Isometry3, Point3};

/// Rotation angle in radians and displacement of `at` in metres between two poses.
pub(crate) fn error(a: &Isometry3<f64>, b: &Isometry3<f64>, at: &Point3<f64>) -> (f64, f64) {
    (a.rotation.angle_to(&b.rotation), (a * at - b * at).norm())
}
