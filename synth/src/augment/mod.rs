//! Turning, scaling and recolouring a crop into the pixels of the output image.

mod bilinear;
mod colour;
mod homography;
mod layer;
mod placement;
mod pyramid;
mod warp;

pub(crate) use colour::ColourMap;
pub(crate) use layer::{HALF, Layer, Rectangle};
pub(crate) use placement::{Frame, Placement};
pub(crate) use pyramid::Pyramid;
pub(crate) use warp::{Drawing, warp};
