//! Readings at depth jumps.

use image::{GrayImage, Luma};

use crate::{DepthImage, Error, OrganizedCloud, Result};

/// Fewest of its eight neighbours that a reading hangs together with, unless it flies.
///
/// Beside a straight silhouette a pixel keeps five, at a right-angled corner three, and so does one in the corner of
/// the image; in a ramp of readings between two surfaces it keeps the two above and below.
const FEWEST_NEIGHBOURS: u32 = 3;

/// Which readings beside depth jumps are dropped, and what a jump is.
///
/// At a jump time-of-flight and structured light cameras report *flying pixels*: points in the air between object and
/// background, because the light of one pixel comes back from both. The step between neighbours tells them (the
/// jump-edge filter of May et al. 2009, *Three-dimensional mapping with time-of-flight cameras*, whose
/// angle between ray and surface is the same step, divided by the pixel's angle).
///
/// `step` is a depth step relative to the nearer of two neighbouring readings, finite and not negative. A surface
/// at the angle θ to its image plane steps by tan(θ)/f per pixel: at a focal length f of 500 pixels 0.03 is 86°.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case", deny_unknown_fields)
)]
#[non_exhaustive]
pub enum EdgeFilter {
    /// Every reading with a jump to one of its eight neighbours: safe, and it takes one pixel off each silhouette, on
    /// both sides.
    Jumps {
        /// The relative depth step above which two neighbours jump.
        step: f32,
    },
    /// Only readings in the air: those that hang together, without a jump, with fewer than three of their eight
    /// neighbours. Silhouettes and corners stay; wires and slits one pixel wide, and readings alone among holes, go.
    FlyingPixels {
        /// The relative depth step above which two neighbours jump.
        step: f32,
    },
}

impl EdgeFilter {
    fn validate(self) -> Result<()> {
        let (Self::Jumps { step } | Self::FlyingPixels { step }) = self;
        if step.is_finite() && step >= 0.0 {
            return Ok(());
        }
        Err(Error::Config { name: "EdgeFilter::step", found: f64::from(step), needed: "finite and not negative" })
    }

    /// Whether the reading `pixel` of `depths`, one per pixel with NaN or 0 for none, is dropped.
    fn drops(self, depths: &Grid, u: u32, v: u32) -> bool {
        match self {
            Self::Jumps { step } => depths.any_neighbour(u, v, |depth, other| jumps(depth, other, step)),
            Self::FlyingPixels { step } => {
                depths.count_neighbours(u, v, |depth, other| other > 0.0 && !jumps(depth, other, step))
                    < FEWEST_NEIGHBOURS
            }
        }
    }
}

/// Marks (255) the readings of a depth image that `filter` drops.
///
/// # Errors
///
/// [`Error::Config`] if the filter's step is out of range.
///
/// ```
/// use cloudcrop::{edge_pixels, DepthImage, EdgeFilter};
/// use image::Luma;
///
/// // An object at 1 m, a wall at 2 m, and a column of flying pixels between them.
/// let depth = DepthImage::from_fn(9, 9, |u, _| Luma([[1.0, 1.5, 2.0][(u.clamp(3, 5) - 3) as usize]]));
/// let flying = edge_pixels(&depth, EdgeFilter::FlyingPixels { step: 0.03 })?;
/// let jumps = edge_pixels(&depth, EdgeFilter::Jumps { step: 0.03 })?;
/// let columns = |mask: &image::GrayImage| (0..9).filter(|&u| mask.get_pixel(u, 4).0 == [255]).collect::<Vec<_>>();
/// assert_eq!(columns(&flying), [4]);
/// assert_eq!(columns(&jumps), [3, 4, 5]);
/// # Ok::<(), cloudcrop::Error>(())
/// ```
pub fn edge_pixels(depth: &DepthImage, filter: EdgeFilter) -> Result<GrayImage> {
    filter.validate()?;
    let readable = |&z: &f32| if z > 0.0 && z.is_finite() { z } else { f32::NAN };
    let grid = Grid { width: depth.width(), height: depth.height(), depths: depth.iter().map(readable).collect() };
    Ok(GrayImage::from_fn(depth.width(), depth.height(), |u, v| {
        let is_dropped = grid.at(u, v) > 0.0 && filter.drops(&grid, u, v);
        Luma([if is_dropped { 255 } else { 0 }])
    }))
}

impl OrganizedCloud {
    /// The same cloud without the readings that `filter` drops.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if the filter's step is out of range.
    ///
    /// ```
    /// use cloudcrop::{CameraIntrinsics, DepthImage, EdgeFilter, OrganizedCloud};
    /// use image::Luma;
    ///
    /// let camera = CameraIntrinsics::new(500.0, 500.0, 4.0, 4.0, 9, 9)?;
    /// let depth = DepthImage::from_fn(9, 9, |u, _| Luma([if u < 5 { 1.0 } else { 2.0 }]));
    /// let cloud = OrganizedCloud::from_depth(&depth, &camera)?.without_edges(EdgeFilter::Jumps { step: 0.03 })?;
    /// assert!(cloud.at(4, 4).is_none() && cloud.at(5, 4).is_none() && cloud.at(3, 4).is_some());
    /// # Ok::<(), cloudcrop::Error>(())
    /// ```
    pub fn without_edges(self, filter: EdgeFilter) -> Result<Self> {
        filter.validate()?;
        let grid = Grid::of(&self);
        let pixels = (0..grid.height).flat_map(|v| (0..grid.width).map(move |u| (u, v)));
        let dropped: Vec<bool> = pixels.map(|(u, v)| grid.at(u, v) > 0.0 && filter.drops(&grid, u, v)).collect();
        Ok(self.without(&dropped))
    }
}

/// Whether the farther of two depths lies more than `step` times the nearer behind it; never with NaN.
pub(crate) fn jumps(depth: f32, other: f32, step: f32) -> bool {
    (other - depth).abs() > step * other.min(depth)
}

/// Depths in metres row by row, NaN where there is no reading.
pub(crate) struct Grid {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) depths: Vec<f32>,
}

impl Grid {
    pub(crate) fn of(cloud: &OrganizedCloud) -> Self {
        let depths = cloud.points().iter().map(|point| point.z).collect();
        Self { width: cloud.width(), height: cloud.height(), depths }
    }

    pub(crate) fn at(&self, u: u32, v: u32) -> f32 {
        self.depths[v as usize * self.width as usize + u as usize]
    }

    /// Whether `holds` of the depth at (`u`, `v`) and that of one of its up to eight neighbours.
    pub(crate) fn any_neighbour(&self, u: u32, v: u32, holds: impl Fn(f32, f32) -> bool) -> bool {
        self.count_neighbours(u, v, holds) > 0
    }

    /// Of how many of its up to eight neighbours, and its own depth, `holds`.
    fn count_neighbours(&self, u: u32, v: u32, holds: impl Fn(f32, f32) -> bool) -> u32 {
        let depth = self.at(u, v);
        let (first_u, last_u) = (u.saturating_sub(1), (u + 1).min(self.width - 1));
        let (first_v, last_v) = (v.saturating_sub(1), (v + 1).min(self.height - 1));
        let mut count = 0;
        for y in first_v..=last_v {
            let row = y as usize * self.width as usize;
            for (x, &other) in (first_u..).zip(&self.depths[row + first_u as usize..=row + last_u as usize]) {
                count += u32::from((x, y) != (u, v) && holds(depth, other));
            }
        }
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marked(rows: &[&str], filter: EdgeFilter) -> Vec<String> {
        let at = |u: u32, v: u32| rows[v as usize].as_bytes()[u as usize];
        // A digit is that depth in metres, '.' a hole.
        let depth = DepthImage::from_fn(rows[0].len() as u32, rows.len() as u32, |u, v| {
            Luma([if at(u, v) == b'.' { 0.0 } else { f32::from(at(u, v) - b'0') }])
        });
        let mask = edge_pixels(&depth, filter).unwrap();
        let symbol = |&value: &u8| if value == 0 { '.' } else { '#' };
        mask.as_raw().chunks(rows[0].len()).map(|row| row.iter().map(symbol).collect()).collect()
    }

    #[test]
    fn corners_stay_and_what_flies_goes() {
        let scene = ["4444444444", "4444444444", "4411144444", "4411124484", "4411124444", "4444444.44", "4444444444"];
        let flying = marked(&scene, EdgeFilter::FlyingPixels { step: 0.1 });
        // The two readings at 2 m between object and wall, and the lonely one at 8 m.
        let expected =
            ["..........", "..........", "..........", ".....#..#.", ".....#....", "..........", ".........."];
        assert_eq!(flying, expected);
        assert_eq!(marked(&["11444", "11444"], EdgeFilter::Jumps { step: 0.1 }), [".##..", ".##.."]);
    }

    #[test]
    fn holes_are_no_jumps_and_no_support() {
        assert_eq!(marked(&["11.11", "11.11"], EdgeFilter::Jumps { step: 0.1 }), [".....", "....."]);
        assert_eq!(marked(&["1...1", "....."], EdgeFilter::FlyingPixels { step: 0.1 }), ["#...#", "....."]);
    }

    #[test]
    fn unusable_steps_are_refused() {
        for step in [-0.1, f32::NAN, f32::INFINITY] {
            for filter in [EdgeFilter::Jumps { step }, EdgeFilter::FlyingPixels { step }] {
                let error = edge_pixels(&DepthImage::new(2, 2), filter).unwrap_err();
                assert!(matches!(error, Error::Config { name: "EdgeFilter::step", .. }));
            }
        }
    }
}
