//! From a mask to the points of one object.

use image::GrayImage;
use nalgebra::Point3;

use crate::centroid::{centroid, robust_centroid};
use crate::jump::{Grid, jumps};
use crate::mask::{check_size, eroded};
use crate::{Error, OrganizedCloud, Result};

/// The point around which [`crop_to_object`] sets its ball.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum CropCenter {
    /// [`robust_centroid`]: leaked background does not move it. The default.
    #[default]
    Robust,
    /// [`centroid`](crate::centroid), the mean of the masked points, as in the paper. A share s of leaked points that
    /// lie a distance d behind the object moves it by s·d.
    Mean,
}

/// How [`crop_to_object`] cleans the points under a mask.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct CropConfig {
    /// Radius in metres of the ball around the centre of the masked points outside which points are dropped;
    /// positive, infinity = off. The paper calls it a function of the object's size and states no number; see
    /// [`CropConfig::for_diameter`]. Default 0.5.
    pub margin: f32,
    /// The centre of that ball. Default [`CropCenter::Robust`].
    pub center: CropCenter,
    /// Depth step, relative to the nearer of two neighbouring pixels, at which both count as lying at a jump and are
    /// dropped; `0.0` = off. At jumps sensors report *flying pixels*, points in the air between object and
    /// background. A surface at 86° to the line of sight steps by 0.03 per pixel at a focal length of 500 pixels.
    /// Default 0.03.
    pub jump: f32,
    /// Pixels taken off the silhouette of the mask beforehand. Default 0.
    pub erode_px: u32,
    /// Fewest points a crop may have. Default 10.
    pub min_points: usize,
}

impl Default for CropConfig {
    fn default() -> Self {
        Self { margin: 0.5, center: CropCenter::Robust, jump: 0.03, erode_px: 0, min_points: 10 }
    }
}

impl CropConfig {
    /// The default with the margin of an object of which no two points are more than `diameter` metres apart.
    ///
    /// The margin is the diameter itself: from wherever one looks, the centre of the visible points lies within
    /// their hull, hence no farther than one diameter from any point of the object.
    #[must_use]
    pub fn for_diameter(diameter: f32) -> Self {
        Self { margin: diameter, ..Self::default() }
    }

    /// The paper's own crop: the masked points within `margin` metres of their plain centroid, nothing else dropped.
    ///
    /// This is point cloud cropping as Haarslev et al. 2020 describe it. It differs from [`CropConfig::default`] in two
    /// ways: leaked background pulls the ball off the object, so that the margin must be wide enough for both; and
    /// flying pixels within the margin stay.
    ///
    /// ```
    /// use cloudcrop::{crop_to_object, CameraIntrinsics, CropConfig, DepthImage, OrganizedCloud};
    /// use image::{GrayImage, Luma};
    ///
    /// // A tenth of the mask leaks onto a wall 4 m behind the object, so the mean lies 0.4 m behind it.
    /// let camera = CameraIntrinsics::new(500.0, 500.0, 49.5, 49.5, 100, 100)?;
    /// let depth = DepthImage::from_fn(100, 100, |u, _| Luma([if u < 90 { 1.0 } else { 5.0 }]));
    /// let mask = GrayImage::from_pixel(100, 100, Luma([255]));
    /// let cloud = OrganizedCloud::from_depth(&depth, &camera)?;
    ///
    /// assert!(crop_to_object(&cloud, &mask, &CropConfig::paper(0.3)).is_err()); // the ball is empty
    /// assert_eq!(crop_to_object(&cloud, &mask, &CropConfig::paper(0.6))?.points.len(), 9000);
    /// assert_eq!(crop_to_object(&cloud, &mask, &CropConfig::for_diameter(0.3))?.points.len(), 8900);
    /// # Ok::<(), cloudcrop::Error>(())
    /// ```
    #[must_use]
    pub fn paper(margin: f32) -> Self {
        Self { margin, center: CropCenter::Mean, jump: 0.0, erode_px: 0, min_points: 1 }
    }

    fn validate(&self) -> Result<()> {
        let refuse = |name, found: f32, needed| Err(Error::Config { name, found: f64::from(found), needed });
        if self.margin.is_nan() || self.margin <= 0.0 {
            return refuse("CropConfig::margin", self.margin, "positive (infinity = off)");
        }
        if !self.jump.is_finite() || self.jump < 0.0 {
            return refuse("CropConfig::jump", self.jump, "finite and not negative (0 = off)");
        }
        Ok(())
    }
}

/// The points of one object, and what became of the other pixels of its mask.
///
/// Every pixel of the mask is counted once: `points.len() + eroded + without_depth + at_jumps + beyond_margin` is the
/// area of the mask.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectCloud {
    /// The points in metres, camera frame, in the order of their pixels. All finite.
    pub points: Vec<Point3<f32>>,
    /// For each point its pixel, `v·width + u`; ascending.
    pub pixels: Vec<u32>,
    /// The mean of `points`.
    pub centroid: Point3<f32>,
    /// The centre of the ball that `margin` is the radius of: the [`CropConfig::center`] of the masked points.
    pub ball_center: Point3<f32>,
    /// Pixels of the mask taken off its silhouette.
    pub eroded: usize,
    /// Pixels of the remaining mask without a depth reading.
    pub without_depth: usize,
    /// Points dropped because they lie at a depth jump.
    pub at_jumps: usize,
    /// Points dropped because they lie outside the ball.
    pub beyond_margin: usize,
}

/// Keeps the points of `cloud` under `mask` that lie within a margin of their centre.
///
/// The mask of a network leaks over the silhouette of the object; pixels of the background beside it land far away in
/// space, so a ball around the centroid removes them (Haarslev et al. 2020, point cloud cropping). Leaked pixels also
/// pull the plain centroid towards the background, by their share times their distance. The ball is therefore set
/// around the [`robust_centroid`]; the paper's own crop is [`CropConfig::paper`]. Neither centre depends on the margin:
/// a wider margin keeps all that a narrower one kept.
///
/// # Errors
///
/// [`Error::SizeMismatch`] if `mask` and `cloud` differ in size, [`Error::Config`] if a field is out of range,
/// [`Error::TooFewPoints`] if fewer than `min_points` (or none) are left; its message says where the others went.
///
/// # Examples
///
/// A leaked strip of wall, 3 m behind the object:
///
/// ```
/// use cloudcrop::{crop_to_object, CameraIntrinsics, CropConfig, DepthImage, OrganizedCloud};
/// use image::{GrayImage, Luma};
///
/// let camera = CameraIntrinsics::new(500.0, 500.0, 49.5, 49.5, 100, 100)?;
/// let depth = DepthImage::from_fn(100, 100, |u, _| Luma([if u < 80 { 1.0 } else { 4.0 }]));
/// let mask = GrayImage::from_fn(100, 100, |u, _| Luma([if u < 90 { 255 } else { 0 }]));
///
/// let cloud = OrganizedCloud::from_depth(&depth, &camera)?;
/// let object = crop_to_object(&cloud, &mask, &CropConfig { margin: 0.3, ..CropConfig::default() })?;
/// assert_eq!(object.points.len(), 79 * 100);
/// assert_eq!((object.at_jumps, object.beyond_margin), (200, 900)); // two columns beside the step, nine behind
/// # Ok::<(), cloudcrop::Error>(())
/// ```
pub fn crop_to_object(cloud: &OrganizedCloud, mask: &GrayImage, config: &CropConfig) -> Result<ObjectCloud> {
    config.validate()?;
    check_size(cloud, mask)?;

    let area = mask.as_raw().iter().filter(|&&value| value != 0).count();
    let inside = eroded(mask, config.erode_px);
    let mut pixels: Vec<u32> = (0..).zip(&inside).filter(|&(_, &is_inside)| is_inside).map(|(i, _)| i).collect();
    let remaining = pixels.len();
    pixels.retain(|&pixel| !cloud.points()[pixel as usize].z.is_nan());
    let with_depth = pixels.len();
    if config.jump > 0.0 {
        let (grid, width) = (Grid::of(cloud), cloud.width());
        pixels.retain(|&pixel| {
            let (u, v) = (pixel % width, pixel / width);
            !grid.any_neighbour(u, v, |depth, other| jumps(depth, other, config.jump))
        });
    }
    let smooth = pixels.len();

    let mut points: Vec<Point3<f32>> = pixels.iter().map(|&pixel| cloud.points()[pixel as usize]).collect();
    let ball_center = match config.center {
        CropCenter::Robust => robust_centroid(&points),
        CropCenter::Mean => centroid(&points),
    };
    if let Some(center) = ball_center {
        let squared_margin = config.margin * config.margin;
        pixels.retain(|&pixel| (cloud.points()[pixel as usize] - center).norm_squared() <= squared_margin);
        points.retain(|point| (point - center).norm_squared() <= squared_margin);
    }
    let counts = [area - remaining, remaining - with_depth, with_depth - smooth, smooth - points.len()];
    match (ball_center, centroid(&points)) {
        (Some(ball_center), Some(centroid)) if points.len() >= config.min_points => Ok(ObjectCloud {
            points,
            pixels,
            centroid,
            ball_center,
            eroded: counts[0],
            without_depth: counts[1],
            at_jumps: counts[2],
            beyond_margin: counts[3],
        }),
        _ => Err(too_few(area, counts, points.len(), config.min_points)),
    }
}

fn too_few(area: usize, counts: [usize; 4], found: usize, min_points: usize) -> Error {
    let [eroded, without_depth, at_jumps, beyond_margin] = counts;
    let what = format!(
        "the crop (mask of {area} pixels, {eroded} eroded, {without_depth} without depth, {at_jumps} at jumps, \
         {beyond_margin} beyond the margin)"
    );
    Error::TooFewPoints { what, found, needed: min_points.max(1) }
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;
    use crate::{CameraIntrinsics, DepthImage};

    fn cloud(width: u32, height: u32, depth: impl Fn(u32, u32) -> f32) -> OrganizedCloud {
        let camera = CameraIntrinsics::new(500.0, 500.0, 0.0, 0.0, width, height).unwrap();
        let depth = DepthImage::from_fn(width, height, |u, v| Luma([depth(u, v)]));
        OrganizedCloud::from_depth(&depth, &camera).unwrap()
    }

    #[test]
    fn every_masked_pixel_is_counted_once() {
        // Columns: 0-9 object at 1 m, 10 hole, 11-19 object, 20-24 wall at 9 m; the mask leaves out column 24.
        let cloud = cloud(25, 20, |u, _| match u {
            10 => 0.0,
            20.. => 9.0,
            _ => 1.0,
        });
        let mask = GrayImage::from_fn(25, 20, |u, _| Luma([u8::from(u < 24)]));
        let config = CropConfig { erode_px: 1, ..CropConfig::default() };
        let object = crop_to_object(&cloud, &mask, &config).unwrap();
        assert_eq!(object.eroded, 20); // column 23
        assert_eq!(object.without_depth, 20); // column 10
        assert_eq!(object.at_jumps, 40); // columns 19 and 20
        assert_eq!(object.beyond_margin, 40); // columns 21 and 22
        assert_eq!(object.points.len(), 18 * 20);
        assert!(object.pixels.iter().all(|pixel| pixel % 25 < 19 && pixel % 25 != 10));
    }

    #[test]
    fn an_empty_crop_says_where_the_pixels_went() {
        let cloud = cloud(6, 2, |u, _| if u < 3 { 0.0 } else { 1.0 });
        let mask = GrayImage::from_fn(6, 2, |u, _| Luma([u8::from(u < 4)]));
        let error = crop_to_object(&cloud, &mask, &CropConfig::default()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the crop (mask of 8 pixels, 0 eroded, 6 without depth, 0 at jumps, 0 beyond the margin) has 2 points, \
             at least 10 are needed"
        );
        let none = GrayImage::new(6, 2);
        let config = CropConfig { min_points: 0, ..CropConfig::default() };
        let error = crop_to_object(&cloud, &none, &config).unwrap_err();
        assert!(matches!(error, Error::TooFewPoints { found: 0, needed: 1, .. }));
    }

    #[test]
    fn unusable_configurations_and_sizes_are_refused() {
        let cloud = cloud(6, 2, |_, _| 1.0);
        let full = GrayImage::from_pixel(6, 2, Luma([255]));
        for margin in [0.0, -1.0, f32::NAN] {
            let config = CropConfig { margin, ..CropConfig::default() };
            assert!(matches!(
                crop_to_object(&cloud, &full, &config),
                Err(Error::Config { name: "CropConfig::margin", .. })
            ));
        }
        for jump in [-0.1, f32::NAN, f32::INFINITY] {
            let config = CropConfig { jump, ..CropConfig::default() };
            assert!(crop_to_object(&cloud, &full, &config).is_err());
        }
        let other = GrayImage::from_pixel(2, 6, Luma([255]));
        assert!(matches!(
            crop_to_object(&cloud, &other, &CropConfig::default()),
            Err(Error::SizeMismatch { what: "the mask", .. })
        ));
        let off = CropConfig { margin: f32::INFINITY, jump: 0.0, ..CropConfig::default() };
        assert_eq!(crop_to_object(&cloud, &full, &off).unwrap().points.len(), 12);
    }
}
