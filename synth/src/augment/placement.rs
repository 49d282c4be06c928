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
    /// Output pixel (x, y) on which the middle of the object falls.
    pub(crate) centre: [f64; 2],
}

/// Output pixel (x, y) to crop pixel: `p = linear · (x, y) + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ToCrop {
    pub(crate) linear: [[f64; 2]; 2],
    pub(crate) offset: [f64; 2],
}

impl ToCrop {
    pub(crate) fn apply(&self, x: f64, y: f64) -> [f64; 2] {
        [0, 1].map(|i| self.linear[i][0] * x + self.linear[i][1] * y + self.offset[i])
    }
}

impl Placement {
    /// The inverse map that the warp samples with; `middle` is the object's middle in crop pixels.
    pub(crate) fn to_crop(self, middle: [f64; 2], frame: &Frame) -> ToCrop {
        let (sin, cos) = self.rotation.sin_cos();
        let mirror = if self.flip { -1.0 } else { 1.0 };
        let [rx, ry] = frame.camera_per_output.map(|ratio| ratio / self.scale);
        let linear = [[mirror * cos * rx, mirror * sin * ry], [-sin * rx, cos * ry]];
        let [x, y] = self.centre;
        let offset = [0, 1].map(|i| middle[i] - linear[i][0] * x - linear[i][1] * y);
        ToCrop { linear, offset }
    }

    /// Half the width and height, in output pixels, of an object of `size` camera pixels.
    pub(crate) fn half_extent(self, size: [f64; 2], frame: &Frame) -> [f64; 2] {
        let (sin, cos) = self.rotation.sin_cos();
        let (sin, cos) = (sin.abs(), cos.abs());
        let half = 0.5 * self.scale;
        [
            half * (cos * size[0] + sin * size[1]) / frame.camera_per_output[0],
            half * (sin * size[0] + cos * size[1]) / frame.camera_per_output[1],
        ]
    }

    /// Output pixels that an object of `size` camera pixels can touch, `reach` pixels wider, within the frame;
    /// `None` when it lies outside.
    pub(crate) fn rectangle(self, size: [f64; 2], reach: usize, frame: &Frame) -> Option<Rectangle> {
        let half = self.half_extent(size, frame);
        let range = |axis: usize, length: u32| {
            let reach = half[axis] + reach as f64;
            let first = (self.centre[axis] - reach).floor().max(0.0);
            let last = (self.centre[axis] + reach).ceil().min(f64::from(length) - 1.0);
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

    #[test]
    fn a_quarter_turn_by_hand() {
        let frame = Frame { width: 100, height: 80, camera_per_output: [1.0, 1.0] };
        let placement =
            Placement { scale: 2.0, rotation: std::f64::consts::FRAC_PI_2, flip: false, centre: [50.0, 40.0] };
        let map = placement.to_crop([10.0, 20.0], &frame);
        // A step right in the crop (x) becomes a step of two down in the output.
        let [x, y] = map.apply(50.0, 42.0);
        assert!((x - 11.0).abs() < 1e-12 && (y - 20.0).abs() < 1e-12);
        let half = placement.half_extent([10.0, 4.0], &frame);
        assert!((half[0] - 4.0).abs() < 1e-9 && (half[1] - 10.0).abs() < 1e-9);
    }
}
