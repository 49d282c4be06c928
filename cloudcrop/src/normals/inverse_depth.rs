//! Inverse depth over the pixels, and what hangs together in it.

use nalgebra::{Point3, Vector3};

use super::moments::{LocalPlane, Moments};
use crate::mask::eroded_along;
use crate::{CameraIntrinsics, OrganizedCloud};

/// Relative depth step between neighbouring readings at which a surface ends. At a focal length of 500 pixels a
/// surface reaches it at 84° to the line of sight; a Kinect's steps of 11 mm at 2 m stay well below.
const JUMP: f32 = 0.02;

/// Inverse depth at every pixel in 1/m, 0 where there is no reading.
pub(super) struct InverseDepth {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) values: Vec<f32>,
    /// Behind a lens: where the pinhole camera sees each reading, in pixels from the principal point.
    pub(super) places: Option<Vec<[f32; 2]>>,
}

impl InverseDepth {
    pub(super) fn new(cloud: &OrganizedCloud) -> Self {
        let (fx, fy) = (cloud.camera().fx as f32, cloud.camera().fy as f32);
        let place = |point: &Point3<f32>| [point.x / point.z * fx, point.y / point.z * fy];
        let has_lens = !cloud.distortion().is_none();
        let inverse = |z: f32| {
            if z > f32::MIN_POSITIVE { z.recip() } else { 0.0 }
        };
        Self {
            width: cloud.width() as usize,
            height: cloud.height() as usize,
            values: cloud.points().iter().map(|point| inverse(point.z)).collect(),
            places: has_lens.then(|| cloud.points().iter().map(place).collect()),
        }
    }

    /// The normal at a pixel, of the plane that `fit` finds there; NaN if there is no reading or no plane.
    pub(super) fn normal_at(
        &self,
        (u, v): (usize, usize),
        camera: &CameraIntrinsics,
        fit: impl FnOnce((usize, usize)) -> Option<LocalPlane>,
    ) -> Vector3<f32> {
        let pixel = v * self.width + u;
        let plane = if self.values[pixel] > 0.0 { fit((u, v)) } else { None };
        plane.map_or(Vector3::repeat(f32::NAN), |plane| {
            let [du, dv] = match &self.places {
                None => [u as f32 - camera.cx as f32, v as f32 - camera.cy as f32],
                Some(places) => places[pixel],
            };
            plane.normal(camera, du, dv)
        })
    }

    /// For every pixel, whether no two readings that follow each other along a row or column of its window jump.
    pub(super) fn windows_without_jump(&self, radius: usize) -> Vec<bool> {
        let along_rows = [self.width, 1];
        let along_columns = [self.height, self.width];
        let mut calm = self.calm_along(along_rows, along_columns, radius);
        calm = eroded_along(&calm, along_columns, along_rows, radius);
        let columns = self.calm_along(along_columns, along_rows, radius);
        let columns = eroded_along(&columns, along_rows, along_columns, radius);
        for (calm, column) in calm.iter_mut().zip(columns) {
            *calm &= column;
        }
        calm
    }

    /// The same for windows one line high; `steps` along the lines and `lines` are [count, stride].
    fn calm_along(&self, steps: [usize; 2], lines: [usize; 2], radius: usize) -> Vec<bool> {
        let mut calm = vec![true; self.values.len()];
        for line in 0..lines[0] {
            let index = |step: usize| line * lines[1] + step * steps[1];
            let mut last: Option<usize> = None;
            for step in (0..steps[0]).filter(|&step| self.values[index(step)] > 0.0) {
                if let Some(last) = last
                    && jumps(self.values[index(last)], self.values[index(step)])
                {
                    for centre in step.saturating_sub(radius)..=(last + radius).min(steps[0] - 1) {
                        calm[index(centre)] = false;
                    }
                }
                last = Some(step);
            }
        }
        calm
    }

    /// Sums over the readings around (`u`, `v`) that are reached along its column, then along rows, without a jump.
    pub(super) fn connected_moments(&self, u: usize, v: usize, radius: usize) -> Moments {
        let mut moments = Moments::default();
        let top = v.saturating_sub(radius);
        let bottom = (v + radius).min(self.height - 1);
        self.add_connected_row(u, v, v, radius, &mut moments);
        self.add_connected_rows(u, v, (top..v).rev(), radius, &mut moments);
        self.add_connected_rows(u, v, v + 1..=bottom, radius, &mut moments);
        moments
    }

    /// Adds one `row` after the other until the column `u` jumps between them; the window is centred at (`u`, `v`).
    fn add_connected_rows(
        &self,
        u: usize,
        v: usize,
        rows: impl Iterator<Item = usize>,
        radius: usize,
        moments: &mut Moments,
    ) {
        let mut last = self.values[v * self.width + u];
        for row in rows {
            let value = self.values[row * self.width + u];
            if value == 0.0 {
                continue; // A hole in the column; its row is left out.
            }
            if jumps(last, value) {
                break;
            }
            last = value;
            self.add_connected_row(u, row, v, radius, moments);
        }
    }

    /// Adds the readings of `row` reached from column `u`; the window is centred at (`u`, `v`).
    fn add_connected_row(&self, u: usize, row: usize, v: usize, radius: usize, moments: &mut Moments) {
        let start = row * self.width;
        match &self.places {
            None => {
                let (middle, y) = (u as f32, row as f32 - v as f32);
                self.for_each_connected(u, row, radius, |x, value| moments.add(x as f32 - middle, y, value));
            }
            Some(places) => {
                let [middle_x, middle_y] = places[v * self.width + u];
                self.for_each_connected(u, row, radius, |x, value| {
                    let [place_x, place_y] = places[start + x];
                    moments.add(place_x - middle_x, place_y - middle_y, value);
                });
            }
        }
    }

    /// Takes the readings of `row` reached from column `u`: columns and inverse depths.
    fn for_each_connected(&self, u: usize, row: usize, radius: usize, mut take: impl FnMut(usize, f32)) {
        let values = &self.values[row * self.width..][..self.width];
        take(u, values[u]);
        let mut last = values[u];
        for (x, &value) in (u + 1..=u + radius).zip(&values[u + 1..]).filter(|&(_, &value)| value > 0.0) {
            if jumps(last, value) {
                break;
            }
            last = value;
            take(x, value);
        }
        last = values[u];
        let first = u.saturating_sub(radius);
        for (x, &value) in (first..u).zip(&values[first..u]).rev().filter(|&(_, &value)| value > 0.0) {
            if jumps(last, value) {
                break;
            }
            last = value;
            take(x, value);
        }
    }
}

/// Whether the farther of two inverse depths lies more than [`JUMP`] behind the nearer.
fn jumps(one: f32, other: f32) -> bool {
    one.max(other) > (1.0 + JUMP) * one.min(other)
}
