//! Images as a camera without lens would have taken them.

use image::{GrayImage, ImageBuffer, Luma, Pixel, Rgb, RgbImage};
use nalgebra::Point2;

use crate::distorted_camera::check_image;
use crate::{CameraIntrinsics, DepthImage, DistortedCamera, Result};

/// The way from the images of a [`DistortedCamera`] to those of a pinhole camera in the same place.
///
/// Each pixel of the pinhole image is looked up where the lens shows its ray; the places are computed once. Depths are
/// along the optical axis, which both cameras share, so they stay what they are. What the lens does not show is black,
/// without reading, or background.
///
/// ```
/// use cloudcrop::{CameraIntrinsics, DepthImage, DistortedCamera, Distortion, OrganizedCloud, Undistortion};
/// use image::Luma;
///
/// let pinhole = CameraIntrinsics::new(60.0, 60.0, 31.5, 23.5, 64, 48)?;
/// let camera = DistortedCamera::new(pinhole, Distortion { k1: 0.2, ..Distortion::default() })?;
/// let straight = Undistortion::new(&camera, &pinhole)?;
/// let depth = straight.depth(&DepthImage::from_pixel(64, 48, Luma([1.5])))?;
/// let cloud = OrganizedCloud::from_depth(&depth, &pinhole)?;
/// assert_eq!(cloud.at(32, 24).map(|point| point.z), Some(1.5));
/// assert_eq!(cloud.at(0, 0), None); // a pincushion shows the corners outside of the image
/// # Ok::<(), cloudcrop::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Undistortion {
    source: CameraIntrinsics,
    target: CameraIntrinsics,
    /// For each pixel of the target its place in the source in pixels; NaN where the lens shows nothing.
    places: Vec<Point2<f32>>,
}

impl Undistortion {
    /// From the images of `source` to those of `target`, a pinhole camera with the same centre and axes; often
    /// [`DistortedCamera::pinhole`], or one with a shorter focal length to keep the corners.
    ///
    /// # Errors
    ///
    /// [`Error::Intrinsics`](crate::Error::Intrinsics) if `target` is not valid.
    pub fn new(source: &DistortedCamera, target: &CameraIntrinsics) -> Result<Self> {
        target.validate()?;
        let pixels = (0..target.height).flat_map(|v| (0..target.width).map(move |u| (u, v)));
        let place = |(u, v)| {
            let place = source.project(&target.unproject(f64::from(u), f64::from(v), 1.0));
            place.map_or(Point2::new(f32::NAN, f32::NAN), Point2::cast)
        };
        Ok(Self { source: *source.pinhole(), target: *target, places: pixels.map(place).collect() })
    }

    /// The pinhole camera of the images that come out.
    pub fn target(&self) -> &CameraIntrinsics {
        &self.target
    }

    /// A colour image, bilinear between the four pixels around each place.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`](crate::Error::SizeMismatch) if the image has not the size of the source camera's.
    pub fn color(&self, image: &RgbImage) -> Result<RgbImage> {
        check_image("the colour image", image.dimensions(), &self.source)?;
        Ok(self.looked_up(|place| bilinear(image, place)))
    }

    /// A depth image in metres, each reading that of the nearest pixel: between two surfaces there is no third.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`](crate::Error::SizeMismatch) if the image has not the size of the source camera's.
    pub fn depth(&self, depth: &DepthImage) -> Result<DepthImage> {
        check_image("the depth image", depth.dimensions(), &self.source)?;
        Ok(self.looked_up(|place| nearest(depth, place)))
    }

    /// A mask or label map, each pixel that of the nearest one.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`](crate::Error::SizeMismatch) if the mask has not the size of the source camera's image.
    pub fn mask(&self, mask: &GrayImage) -> Result<GrayImage> {
        check_image("the mask", mask.dimensions(), &self.source)?;
        Ok(self.looked_up(|place| nearest(mask, place)))
    }

    /// The image of what is found at each place.
    fn looked_up<P: Pixel>(&self, at: impl Fn(Point2<f32>) -> Option<P>) -> ImageBuffer<P, Vec<P::Subpixel>> {
        let mut out = ImageBuffer::new(self.target.width, self.target.height);
        for (pixel, &place) in out.pixels_mut().zip(&self.places) {
            if let Some(found) = at(place) {
                *pixel = found;
            }
        }
        out
    }
}

/// The pixel whose area holds `place`; `None` outside the image.
fn nearest<T: image::Primitive>(image: &ImageBuffer<Luma<T>, Vec<T>>, place: Point2<f32>) -> Option<Luma<T>> {
    let (u, v) = ((place.x + 0.5).floor(), (place.y + 0.5).floor());
    let is_inside = u >= 0.0 && v >= 0.0 && u < image.width() as f32 && v < image.height() as f32;
    is_inside.then(|| *image.get_pixel(u as u32, v as u32))
}

/// The mixture of the four pixels around `place`; `None` outside the image's border, which is half a pixel from the
/// outer centres.
fn bilinear(image: &RgbImage, place: Point2<f32>) -> Option<Rgb<u8>> {
    let (last_u, last_v) = (image.width() as f32 - 1.0, image.height() as f32 - 1.0);
    let is_inside = place.x >= -0.5 && place.y >= -0.5 && place.x <= last_u + 0.5 && place.y <= last_v + 0.5;
    if !is_inside {
        return None;
    }
    let (x, y) = (place.x.clamp(0.0, last_u), place.y.clamp(0.0, last_v));
    let (u, v) = (x as u32, y as u32);
    let (right, down) = ((u + 1).min(image.width() - 1), (v + 1).min(image.height() - 1));
    let (along_u, along_v) = (x - u as f32, y - v as f32);
    let mix = |a: u8, b: u8, share: f32| f32::from(a) * (1.0 - share) + f32::from(b) * share;
    let [above_left, above_right] = [image.get_pixel(u, v), image.get_pixel(right, v)];
    let [below_left, below_right] = [image.get_pixel(u, down), image.get_pixel(right, down)];
    Some(Rgb(std::array::from_fn(|channel| {
        let above = mix(above_left[channel], above_right[channel], along_u);
        let below = mix(below_left[channel], below_right[channel], along_u);
        (above * (1.0 - along_v) + below * along_v).round() as u8
    })))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Distortion, Error};

    #[test]
    fn a_resized_camera_reads_where_its_pixels_lie() {
        // Twice the focal length: pixel 0 of the target looks half a source pixel's quarter left of pixel 0.
        let source = CameraIntrinsics::new(10.0, 10.0, 0.0, 0.0, 2, 1).unwrap();
        let target = CameraIntrinsics { fx: 20.0, cx: 1.0, width: 4, ..source };
        let straight = Undistortion::new(&DistortedCamera::straight(source).unwrap(), &target).unwrap();
        // Places in the source: -0.5, 0, 0.5, 1.
        let color = RgbImage::from_raw(2, 1, vec![10, 20, 30, 110, 120, 130]).unwrap();
        let color = straight.color(&color).unwrap();
        assert_eq!(color.as_raw(), &[10, 20, 30, 10, 20, 30, 60, 70, 80, 110, 120, 130]);
        let depth = straight.depth(&DepthImage::from_raw(2, 1, vec![1.0, 3.0]).unwrap()).unwrap();
        assert_eq!(depth.as_raw(), &[1.0, 1.0, 3.0, 3.0]); // none in between
        let mask = straight.mask(&GrayImage::from_raw(2, 1, vec![7, 0]).unwrap()).unwrap();
        assert_eq!(mask.as_raw(), &[7, 7, 0, 0]);
    }

    #[test]
    fn images_of_another_size_are_refused() {
        let pinhole = CameraIntrinsics::new(10.0, 10.0, 0.0, 0.0, 4, 3).unwrap();
        let camera = DistortedCamera::new(pinhole, Distortion { k1: 0.1, ..Distortion::default() }).unwrap();
        let straight = Undistortion::new(&camera, &pinhole).unwrap();
        assert_eq!(
            straight.color(&RgbImage::new(3, 4)).unwrap_err().to_string(),
            "the colour image is 3x4 pixels, 4x3 are needed"
        );
        assert!(matches!(straight.depth(&DepthImage::new(1, 1)), Err(Error::SizeMismatch { .. })));
        assert!(matches!(straight.mask(&GrayImage::new(1, 1)), Err(Error::SizeMismatch { .. })));
        let broken = CameraIntrinsics { width: 0, ..pinhole };
        assert!(matches!(Undistortion::new(&camera, &broken), Err(Error::Intrinsics { name: "width", .. })));
    }
}
