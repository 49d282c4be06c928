use super::homography::Homography;
use super::layer::Rectangle;

/// The output image and the camera whose pixels it stands for.
///
/// Inference resizes the camera's picture to the network's input, which need not keep the aspect ratio (640x480 to
/// 288x160). Objects are turned and scaled in camera pixels and then resized the same way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Camera pixels per output pixel along a row and along a column.
    pub(crate) camera_per_output: [f64; 2],
    /// Focal length in camera pixels, for objects that are tilted.
    pub(crate) focal: f64,
}

/// Where and how a crop lies in the output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placement {
    /// Size relative to the photo, in camera pixels.
    pub(crate) scale: f64,
    /// Turn in camera pixels, radians, from x towards y (clockwise as seen).
    pub(crate) rotation: f64,
    /// Mirrored left to right before turning.
    pub(crate) flip: bool,
    /// The crop, taken as a flat picture, is turned out of the image plane by this angle, radians ...
    pub(crate) tilt: f64,
    /// ... about an axis in it of this direction, radians from x towards y.
    pub(crate) tilt_axis: f64,
    /// Output pixel (x, y) on which the middle of the object falls.
    pub(crate) centre: [f64; 2],
}

impl Placement {
    /// Crop pixel to output pixel; `middle` is the object's middle in crop pixels.
    pub(crate) fn to_output(self, middle: [f64; 2], frame: &Frame) -> Homography {
        let (sin, cos) = self.rotation.sin_cos();
        let mirror = if self.flip { -1.0 } else { 1.0 };
        let [rx, ry] = frame.camera_per_output.map(|ratio| self.scale / ratio);
        let turn = [[mirror * cos * rx, -sin * rx], [mirror * sin * ry, cos * ry]];
        Homography::shift([-middle[0], -middle[1]])
            .then(&Homography::tilt(self.tilt, self.tilt_axis, frame.focal))
            .then(&Homography::linear(turn))
            .then(&Homography::shift(self.centre))
    }

    /// Distances, in output pixels, from the middle to the left, top, right and bottom end of an object of `size`
    /// camera pixels.
    pub(crate) fn extent(self, size: [f64; 2], frame: &Frame) -> [f64; 4] {
        let map = Self { centre: [0.0; 2], ..self }.to_output([0.0; 2], frame);
        let corners = [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)];
        let [mut left, mut top, mut right, mut bottom] = [0.0_f64; 4];
        for (x, y) in corners {
            let [x, y] = map.apply(x * size[0], y * size[1]);
            (left, top) = (left.max(-x), top.max(-y));
            (right, bottom) = (right.max(x), bottom.max(y));
        }
        [left, top, right, bottom]
    }

    /// Output pixels that an object of `size` camera pixels can touch, `reach` pixels wider, within the frame;
    /// `None` when it lies outside.
    pub(crate) fn rectangle(self, size: [f64; 2], reach: usize, frame: &Frame) -> Option<Rectangle> {
        let extent = self.extent(size, frame);
        let range = |axis: usize, length: u32| {
            let first = (self.centre[axis] - extent[axis] - reach as f64).floor().max(0.0);
            let last = (self.centre[axis] + extent[axis + 2] + reach as f64).ceil().min(f64::from(length) - 1.0);
            (first <= last).then_some((first as usize, (last - first) as usize + 1))
        };
        let (left, width) = range(0, frame.width)?;
        let (top, height) = range(1, frame.height)?;
        Some(Rectangle { left, top, width, height })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { width: 100, height: 80, camera_per_output: [1.0, 1.0], focal: 100.0 };

    fn placement() -> Placement {
        let flat =
            Placement { scale: 1.0, rotation: 0.0, flip: false, tilt: 0.0, tilt_axis: 0.0, centre: [50.0, 40.0] };
        Placement { scale: 2.0, rotation: std::f64::consts::FRAC_PI_2, ..flat }
    }

    #[test]
    fn a_quarter_turn_by_hand() {
        let map = placement().to_output([10.0, 20.0], &FRAME);
        // A step right in the crop (x) becomes a step of two down in the output.
        let [x, y] = map.apply(11.0, 20.0);
        assert!((x - 50.0).abs() < 1e-12 && (y - 42.0).abs() < 1e-12);
        let extent = placement().extent([10.0, 4.0], &FRAME);
        assert!(extent.iter().zip([4.0, 10.0, 4.0, 10.0]).all(|(found, wanted)| (found - wanted).abs() < 1e-9));
    }

    #[test]
    fn what_is_tilted_away_is_smaller() {
        // About the x axis: what was above comes nearer, what was below goes away.
        let tilted = Placement { scale: 1.0, rotation: 0.0, tilt: 0.5, ..placement() };
        let [_, top, _, bottom] = tilted.extent([10.0, 40.0], &FRAME);
        let (sin, cos) = 0.5_f64.sin_cos();
        assert!((top - 100.0 * 20.0 * cos / (100.0 - 20.0 * sin)).abs() < 1e-9, "{top}");
        assert!((bottom - 100.0 * 20.0 * cos / (100.0 + 20.0 * sin)).abs() < 1e-9, "{bottom}");
    }
}
