//! Which points of a model hide behind others: a small depth buffer of the points themselves.

use nalgebra::Point3;

use super::DepthView;

/// The nearest depth of the model in each cell of a coarse image, about four cells to a point's share of the surface.
pub(super) struct Occluders<'a> {
    view: &'a DepthView<'a>,
    spacing: f64,
    /// Edge of a cell in pixels.
    cell: f64,
    columns: usize,
    nearest: Vec<f64>,
}

/// Cells along the edge of the square of surface that falls to one point.
const CELLS_PER_SPACING: f64 = 2.0;
/// A point covers the cells up to this many columns and rows away, less the corners: about a disc of 1.2 spacings, since
/// random samples have holes of more than their spacing (one place in a hundred is further than that from any point).
const COVER: usize = 2;
/// How far a cover reaches from its point, in spacings.
const REACH: f64 = 1.5;

impl<'a> Occluders<'a> {
    /// Enters all points (in the camera's frame) that appear in the image.
    pub(super) fn new(view: &'a DepthView<'a>, points: &[Point3<f64>], spacing: f64) -> Self {
        let camera = view.camera();
        let before = points.iter().map(|point| point.z).filter(|z| *z > 0.0);
        let count = before.clone().count().max(1) as f64;
        let distance = before.sum::<f64>() / count;
        // As wide as at the middle of the model; not finer than the pixels, not coarser than the image.
        let longest = f64::from(camera.width.max(camera.height));
        let cell = (spacing / CELLS_PER_SPACING * camera.fx.max(camera.fy) / distance).clamp(1.0, longest);
        let cells = |pixels: u32| (f64::from(pixels) / cell).ceil() as usize;
        let (columns, rows) = (cells(camera.width), cells(camera.height));
        let mut occluders = Self { view, spacing, cell, columns, nearest: vec![f64::INFINITY; columns * rows] };
        for point in points {
            occluders.enter(point, rows);
        }
        occluders
    }

    fn enter(&mut self, point: &Point3<f64>, rows: usize) {
        let Some((column, row)) = self.cell_of(point) else { return };
        for below in 0..=2 * COVER {
            for right in 0..=2 * COVER {
                let corner = below.abs_diff(COVER) + right.abs_diff(COVER) == 2 * COVER;
                let (column, row) = (column + right, row + below);
                // The cover sticks out of the image by up to its half.
                let inside = (COVER..self.columns + COVER).contains(&column) && (COVER..rows + COVER).contains(&row);
                if inside && !corner {
                    let nearest = &mut self.nearest[(row - COVER) * self.columns + column - COVER];
                    *nearest = nearest.min(point.z);
                }
            }
        }
    }

    /// Whether the model hides a point of a surface on which depth changes by `slope` times what the place does, and whose
    /// own surroundings therefore must not hide it.
    pub(super) fn hide(&self, point: &Point3<f64>, slope: f64, tolerance: f64) -> bool {
        let Some((column, row)) = self.cell_of(point) else { return false };
        self.nearest[row * self.columns + column] < point.z - tolerance - REACH * self.spacing * slope
    }

    fn cell_of(&self, point: &Point3<f64>) -> Option<(usize, usize)> {
        let (column, row) = self.view.pixel(point)?;
        // To whole pixels, since the edge of a cell need not be exact.
        Some(((column as f64 / self.cell) as usize, (row as f64 / self.cell) as usize))
    }
}
