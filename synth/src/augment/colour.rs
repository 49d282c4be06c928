use crate::config::SynthConfig;
use crate::sample_rng::SampleRng;

/// An affine change of colour, `matrix · rgb + offset`, in grey levels of 0 to 255.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ColourMap {
    matrix: [[f32; 3]; 3],
    offset: f32,
}

impl ColourMap {
    pub(crate) const IDENTITY: Self = Self { matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], offset: 0.0 };

    /// Brightness as a share of white that is added, contrast as a share by which distances from middle grey grow,
    /// hue as a rotation about the grey axis (Rodrigues' formula).
    pub(crate) fn new(brightness: f64, contrast: f64, hue_deg: f64) -> Self {
        let (sin, cos) = hue_deg.to_radians().sin_cos();
        let gain = 1.0 + contrast;
        let (along, across) = ((1.0 - cos) / 3.0, sin / 3.0_f64.sqrt());
        let matrix = [
            [cos + along, along - across, along + across],
            [along + across, cos + along, along - across],
            [along - across, along + across, cos + along],
        ];
        Self {
            matrix: matrix.map(|row| row.map(|value| (gain * value) as f32)),
            offset: (255.0 * brightness + 127.5 * (1.0 - gain)) as f32,
        }
    }

    /// A random one within the ranges of `config`; `None` if it changes nothing.
    pub(crate) fn drawn(config: &SynthConfig, rng: &mut SampleRng) -> Option<Self> {
        let ranges = [config.brightness, config.contrast, config.hue_deg];
        let [brightness, contrast, hue] = ranges.map(|range| rng.uniform(range));
        let same = brightness == 0.0 && contrast == 0.0 && hue == 0.0;
        (!same).then(|| Self::new(brightness, contrast, hue))
    }

    /// Changes a colour that is weighted by its coverage (0 to 1); white is `255 · coverage`.
    pub(crate) fn apply(&self, [r, g, b]: [f32; 3], coverage: f32) -> [f32; 3] {
        let change = |row: [f32; 3]| {
            let value = row[0] * r + row[1] * g + row[2] * b + self.offset * coverage;
            value.min(255.0 * coverage).max(0.0)
        };
        self.matrix.map(change)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_keeps_its_hue_and_a_third_of_a_turn_permutes_the_channels() {
        let turn = ColourMap::new(0.0, 0.0, 120.0);
        for (found, wanted) in turn.apply([200.0, 10.0, 60.0], 1.0).iter().zip([60.0, 200.0, 10.0]) {
            assert!((found - wanted).abs() < 1e-3, "{found} {wanted}");
        }
        assert!(turn.apply([90.0; 3], 1.0).iter().all(|value| (value - 90.0).abs() < 1e-3));
    }

    #[test]
    fn brightness_and_contrast_by_hand() {
        let map = ColourMap::new(0.1, 0.5, 0.0);
        // 1.5·100 + 25.5 - 63.75
        assert!((map.apply([100.0; 3], 1.0)[0] - 111.75).abs() < 1e-3);
        // Half covered: everything halves.
        assert!((map.apply([50.0; 3], 0.5)[0] - 55.875).abs() < 1e-3);
    }

    #[test]
    fn coverage_below_zero_by_rounding_is_none() {
        let map = ColourMap::new(0.2, 0.3, 10.0);
        assert!(map.apply([1.0, 2.0, 3.0], -6e-8).iter().all(|value| *value == 0.0));
    }
}
