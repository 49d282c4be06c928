use nalgebra::Point3;

use crate::{Error, Result};

/// A camera without distortion: size of its image and projection, all in pixels, the centre of the first pixel at (0, 0).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Pinhole {
    /// Columns of the image.
    pub width: u32,
    /// Rows of the image.
    pub height: u32,
    /// Focal length across, above 0.
    pub fx: f64,
    /// Focal length down, above 0.
    pub fy: f64,
    /// Column of the optical axis.
    pub cx: f64,
    /// Row of the optical axis.
    pub cy: f64,
}

/// A depth image with its camera, checked to belong together.
///
/// Readings are metres along the optical axis; zero, negative, NaN or infinite ones are none.
#[derive(Clone, Copy, Debug)]
pub struct DepthView<'a> {
    depth: &'a [f32],
    camera: Pinhole,
}

impl<'a> DepthView<'a> {
    /// Takes the readings row by row, as many as the camera has pixels.
    ///
    /// # Errors
    ///
    /// [`Error::DepthSize`] if there are more or fewer readings than pixels, [`Error::BadSetting`] for an image without
    /// pixels, a focal length that is not positive and finite, or a principal point that is not finite.
    pub fn new(depth: &'a [f32], camera: &Pinhole) -> Result<Self> {
        let require = |holds: bool, setting: &'static str, found: f64, needed: &'static str| {
            if holds { Ok(()) } else { Err(Error::BadSetting { setting, found, needed }) }
        };
        let (positive, finite) = ("a positive finite number", "a finite number");
        let Pinhole { width, height, fx, fy, cx, cy } = *camera;
        require(width > 0, "Pinhole::width", f64::from(width), "at least 1")?;
        require(height > 0, "Pinhole::height", f64::from(height), "at least 1")?;
        require(fx.is_finite() && fx > 0.0, "Pinhole::fx", fx, positive)?;
        require(fy.is_finite() && fy > 0.0, "Pinhole::fy", fy, positive)?;
        require(cx.is_finite(), "Pinhole::cx", cx, finite)?;
        require(cy.is_finite(), "Pinhole::cy", cy, finite)?;
        if u64::from(width) * u64::from(height) != depth.len() as u64 {
            return Err(Error::DepthSize { found: depth.len(), width, height });
        }
        Ok(Self { depth, camera: *camera })
    }

    pub(super) fn camera(&self) -> &Pinhole {
        &self.camera
    }

    /// Where a point before the camera appears, in pixels; it may lie outside the image.
    pub(super) fn project(&self, point: &Point3<f64>) -> Option<(f64, f64)> {
        let Pinhole { fx, fy, cx, cy, .. } = self.camera;
        (point.z > 0.0).then(|| (fx * point.x / point.z + cx, fy * point.y / point.z + cy))
    }

    /// Column and row of the pixel that shows a point, if it is in the image.
    pub(super) fn pixel(&self, point: &Point3<f64>) -> Option<(usize, usize)> {
        let (u, v) = self.project(point)?;
        let (column, row) = (u.round(), v.round());
        let inside =
            column >= 0.0 && row >= 0.0 && column < f64::from(self.camera.width) && row < f64::from(self.camera.height);
        inside.then_some((column as usize, row as usize))
    }

    /// Metres along the optical axis, if the pixel has a reading.
    pub(super) fn reading(&self, column: usize, row: usize) -> Option<f64> {
        let reading = self.depth[row * self.camera.width as usize + column];
        (reading.is_finite() && reading > 0.0).then(|| f64::from(reading))
    }

    /// Metres across two pixels, from the first to the last of three columns or rows, at a depth in metres.
    pub(super) fn window(&self, depth: f64) -> f64 {
        2.0 * depth / self.camera.fx.min(self.camera.fy)
    }

    /// The readings of a pixel and its up to eight neighbours.
    pub(super) fn around(&self, column: usize, row: usize) -> impl Iterator<Item = f64> {
        let last = (self.camera.width as usize - 1, self.camera.height as usize - 1);
        let rows = row.saturating_sub(1)..=(row + 1).min(last.1);
        let columns = column.saturating_sub(1)..=(column + 1).min(last.0);
        rows.flat_map(move |row| columns.clone().map(move |column| (column, row)))
            .filter_map(|(column, row)| self.reading(column, row))
    }
}
