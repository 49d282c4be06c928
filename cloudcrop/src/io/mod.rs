//! Point clouds and meshes in files.
//!
//! ```
//! use cloudcrop::io::{read_ply, write_ply, PointCloud};
//! use nalgebra::Point3;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("triangle.ply");
//! let triangle = PointCloud {
//!     points: vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)],
//!     faces: vec![[0, 1, 2]],
//!     ..PointCloud::default()
//! };
//! write_ply(&path, &triangle)?;
//! assert_eq!(read_ply(&path)?, triangle);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod beside;
mod pcd;
mod ply;

use nalgebra::{Point3, Vector3};

pub use pcd::{PcdCloud, PcdEncoding, PcdFault, parse_pcd, read_pcd, write_pcd};
pub use ply::{PlyEncoding, PlyFault, parse_ply, read_ply, write_ply, write_ply_as};

/// A cloud or mesh as stored in a file. A list that the file does not have is empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointCloud {
    /// The vertices, all finite, in the unit of the file: readers never scale (BOP models are in millimetres).
    pub points: Vec<Point3<f32>>,
    /// One normal per vertex, or none at all. NaN marks a vertex without normal.
    pub normals: Vec<Vector3<f32>>,
    /// One sRGB colour per vertex, or none at all.
    pub colors: Vec<[u8; 3]>,
    /// Triangles as indices into `points`.
    pub faces: Vec<[u32; 3]>,
}

impl PointCloud {
    /// Multiplies all coordinates by `factor`; 0.001 turns millimetres into metres.
    #[must_use]
    pub fn scaled(mut self, factor: f32) -> Self {
        for point in &mut self.points {
            point.coords *= factor;
        }
        self
    }
}
