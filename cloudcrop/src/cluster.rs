//! Several objects under one mask.

use image::{GrayImage, Luma};

use crate::mask::check_size;
use crate::{Error, OrganizedCloud, Result};

/// How [`split_instances`] tells one object from the next.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct ClusterConfig {
    /// Distance in metres above which the points of two neighbouring pixels belong to different objects; positive,
    /// infinity = the mask alone decides. Neighbours on a frontal surface at 2 m are 4 mm apart at a focal
    /// length of 500 pixels, on one at 80° 23 mm. Default 0.03.
    pub gap: f32,
    /// Fewest pixels of an object; smaller pieces are dropped. Default 100.
    pub min_points: usize,
}

impl Default for ClusterConfig {
    fn default() -> Self {
        Self { gap: 0.03, min_points: 100 }
    }
}

/// One mask (0 / 255) per object: the pieces of `mask` that hang together over the image *and* in space.
///
/// Two pixels hang together if they are among each other's eight neighbours, both have depth, and their points are
/// no more than `gap` apart. Pixels without depth belong to no object. The largest object comes first; among equals
/// the one whose first pixel, row by row, comes first.
///
/// Finding none is an ordinary outcome: the list is empty.
///
/// # Errors
///
/// [`Error::SizeMismatch`] if `mask` and `cloud` differ in size, [`Error::Config`] if the gap is not positive.
///
/// ```
/// use cloudcrop::{split_instances, CameraIntrinsics, ClusterConfig, DepthImage, OrganizedCloud};
/// use image::{GrayImage, Luma};
///
/// // Two boxes side by side in the mask, one half a metre behind the other.
/// let camera = CameraIntrinsics::new(500.0, 500.0, 49.5, 49.5, 100, 100)?;
/// let depth = DepthImage::from_fn(100, 100, |u, _| Luma([if u < 60 { 1.0 } else { 1.5 }]));
/// let cloud = OrganizedCloud::from_depth(&depth, &camera)?;
/// let mask = GrayImage::from_pixel(100, 100, Luma([255]));
///
/// let objects = split_instances(&cloud, &mask, &ClusterConfig::default())?;
/// assert_eq!(objects.len(), 2);
/// assert_eq!(objects[0].get_pixel(59, 50).0, [255]);
/// assert_eq!(objects[1].get_pixel(60, 50).0, [255]);
/// # Ok::<(), cloudcrop::Error>(())
/// ```
pub fn split_instances(cloud: &OrganizedCloud, mask: &GrayImage, config: &ClusterConfig) -> Result<Vec<GrayImage>> {
    if config.gap.is_nan() || config.gap <= 0.0 {
        let found = f64::from(config.gap);
        return Err(Error::Config { name: "ClusterConfig::gap", found, needed: "positive (infinity = off)" });
    }
    check_size(cloud, mask)?;
    let mut pieces = connected_pieces(cloud, mask, config.gap);
    pieces.retain(|piece| piece.len() >= config.min_points);
    // The sort is stable and the pieces come in the order of their first pixels.
    pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));
    Ok(pieces.iter().map(|piece| mask_of(piece, mask)).collect())
}

/// The pixels of each piece, pieces in the order of their first pixels.
fn connected_pieces(cloud: &OrganizedCloud, mask: &GrayImage, gap: f32) -> Vec<Vec<usize>> {
    let points = cloud.points();
    let squared_gap = gap * gap;
    let mut open: Vec<bool> =
        mask.as_raw().iter().zip(points).map(|(&value, point)| value != 0 && !point.z.is_nan()).collect();
    let mut pieces = Vec::new();
    for seed in 0..open.len() {
        if !open[seed] {
            continue;
        }
        open[seed] = false;
        let mut piece = vec![seed];
        let mut visited = 0;
        while let Some(&pixel) = piece.get(visited) {
            visited += 1;
            for neighbour in neighbours(pixel, cloud.width() as usize, cloud.height() as usize) {
                if open[neighbour] && (points[neighbour] - points[pixel]).norm_squared() <= squared_gap {
                    open[neighbour] = false;
                    piece.push(neighbour);
                }
            }
        }
        pieces.push(piece);
    }
    pieces
}

/// The pixel itself and those that touch it by side or corner, within the image.
fn neighbours(pixel: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let (u, v) = (pixel % width, pixel / width);
    let columns = u.saturating_sub(1)..=(u + 1).min(width - 1);
    let rows = v.saturating_sub(1)..=(v + 1).min(height - 1);
    rows.flat_map(move |v| columns.clone().map(move |u| v * width + u))
}

fn mask_of(piece: &[usize], like: &GrayImage) -> GrayImage {
    let mut mask = GrayImage::from_pixel(like.width(), like.height(), Luma([0]));
    for &pixel in piece {
        mask.as_mut()[pixel] = 255;
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CameraIntrinsics, DepthImage};

    fn picture(rows: &[&str]) -> (OrganizedCloud, GrayImage) {
        let (width, height) = (rows[0].len() as u32, rows.len() as u32);
        let at = |u: u32, v: u32| rows[v as usize].as_bytes()[u as usize];
        let camera = CameraIntrinsics::new(1000.0, 1000.0, 0.0, 0.0, width, height).unwrap();
        // A digit is a depth of 1.0 to 1.9 m under the mask, 'o' a masked hole, '.' background.
        let depth = DepthImage::from_fn(width, height, |u, v| {
            Luma([if at(u, v).is_ascii_digit() { 1.0 + 0.1 * f32::from(at(u, v) - b'0') } else { 0.0 }])
        });
        let mask = GrayImage::from_fn(width, height, |u, v| Luma([if at(u, v) == b'.' { 0 } else { 255 }]));
        (OrganizedCloud::from_depth(&depth, &camera).unwrap(), mask)
    }

    fn drawn(mask: &GrayImage) -> Vec<String> {
        let symbol = |&value: &u8| if value == 0 { '.' } else { '#' };
        mask.as_raw().chunks(mask.width() as usize).map(|row| row.iter().map(symbol).collect()).collect()
    }

    #[test]
    fn pieces_are_told_apart_by_mask_depth_and_holes() {
        let (cloud, mask) = picture(&[
            "00.11o2", //
            "00.115o", //
            "..0....",
        ]);
        let config = ClusterConfig { gap: 0.05, min_points: 1 };
        let objects = split_instances(&cloud, &mask, &config).unwrap();
        let drawings: Vec<_> = objects.iter().map(drawn).collect();
        assert_eq!(drawings.len(), 4);
        // Joined over the corner; larger than the next.
        assert_eq!(drawings[0], ["##.....", "##.....", "..#...."]);
        assert_eq!(drawings[1], ["...##..", "...##..", "......."]);
        // Equal sizes: by position.
        assert_eq!(drawings[2], ["......#", ".......", "......."]);
        assert_eq!(drawings[3], [".......", ".....#.", "......."]);

        let large = ClusterConfig { min_points: 5, ..config };
        assert_eq!(split_instances(&cloud, &mask, &large).unwrap().len(), 1);
    }

    #[test]
    fn nothing_under_the_mask_is_an_empty_list() {
        let (cloud, mask) = picture(&["..o", "..."]);
        assert!(split_instances(&cloud, &mask, &ClusterConfig::default()).unwrap().is_empty());
        let config = ClusterConfig { gap: 0.0, ..ClusterConfig::default() };
        assert!(split_instances(&cloud, &mask, &config).is_err());
    }
}
