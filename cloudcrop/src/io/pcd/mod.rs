//! PCD, the format of the Point Cloud Library ("The PCD (Point Cloud Data) file format", version 0.7).

mod fault;
mod header;
mod lzf;
mod reader;
mod table;
#[cfg(test)]
mod tests;
mod writer;

use nalgebra::{Isometry3, Point3, Vector3};

pub use fault::PcdFault;
pub use reader::{parse_pcd, read_pcd};
pub use writer::{PcdEncoding, write_pcd};

use super::PointCloud;
use crate::OrganizedCloud;

/// A cloud as stored in a PCD file, in rows or as a heap. A list that the file does not have is empty.
///
/// ```
/// use cloudcrop::io::{read_pcd, write_pcd, PcdCloud, PcdEncoding};
/// use cloudcrop::{CameraIntrinsics, DepthImage, OrganizedCloud};
/// use image::Luma;
///
/// // An ordered cloud keeps its rows and its holes.
/// let camera = CameraIntrinsics::new(500.0, 500.0, 31.5, 23.5, 64, 48)?;
/// let depth = DepthImage::from_fn(64, 48, |u, v| Luma([if u == v { 0.0 } else { 1.0 }]));
/// let cloud = OrganizedCloud::from_depth(&depth, &camera)?;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("view.pcd");
/// write_pcd(&path, &PcdCloud::from(&cloud), PcdEncoding::BinaryCompressed)?;
/// let stored = read_pcd(&path)?;
/// assert_eq!((stored.width, stored.height), (64, 48));
/// assert_eq!(OrganizedCloud::from_points(stored.points, &camera)?.depth(), depth);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PcdCloud {
    /// Points in a row; all of them in a cloud without order.
    pub width: u32,
    /// Rows; 1 in a cloud without order.
    pub height: u32,
    /// The points row by row, in the unit of the file, metres by custom. NaN in all coordinates marks a pixel without
    /// reading.
    pub points: Vec<Point3<f32>>,
    /// One normal per point, or none at all. NaN marks a point without normal.
    pub normals: Vec<Vector3<f32>>,
    /// One sRGB colour per point, or none at all.
    pub colors: Vec<[u8; 3]>,
    /// One label per point, or none at all.
    pub labels: Vec<u32>,
    /// The `VIEWPOINT`, where the sensor stood; `None` if there is no such line or its quaternion has no direction. The
    /// points are as in the file, not moved by it. Written as the identity if `None`.
    pub cloud_from_sensor: Option<Isometry3<f64>>,
}

impl PcdCloud {
    /// Whether the points are in rows, one for each pixel of an image.
    pub fn is_organized(&self) -> bool {
        self.height > 1
    }

    /// The points that are readings, without order, with their normals and colours; labels are left out.
    pub fn readings(&self) -> PointCloud {
        let is_reading = |point: &Point3<f32>| point.iter().all(|coordinate| coordinate.is_finite());
        let kept: Vec<usize> = (0..self.points.len()).filter(|&place| is_reading(&self.points[place])).collect();
        PointCloud {
            points: kept.iter().map(|&place| self.points[place]).collect(),
            normals: kept.iter().filter_map(|&place| self.normals.get(place).copied()).collect(),
            colors: kept.iter().filter_map(|&place| self.colors.get(place).copied()).collect(),
            faces: Vec::new(),
        }
    }
}

impl From<&OrganizedCloud> for PcdCloud {
    fn from(cloud: &OrganizedCloud) -> Self {
        let (width, height) = (cloud.width(), cloud.height());
        Self { width, height, points: cloud.points().to_vec(), ..Self::default() }
    }
}

/// Points, normals and colours; the format has no faces. A cloud of more than 2^32 - 1 points cannot be written: its
/// width stays that number.
impl From<&PointCloud> for PcdCloud {
    fn from(cloud: &PointCloud) -> Self {
        Self {
            width: u32::try_from(cloud.points.len()).unwrap_or(u32::MAX),
            height: 1,
            points: cloud.points.clone(),
            normals: cloud.normals.clone(),
            colors: cloud.colors.clone(),
            ..Self::default()
        }
    }
}
