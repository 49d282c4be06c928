use crate::blend::Blend;
use crate::error::{Result, require};
use crate::sample_rng::SampleRng;

/// How training images are composed.
///
/// Defaults are those of Haarslev et al. 2020 where the paper states them (5 % background only, Gaussian and Poisson
/// blending mixed within an image); what it leaves open is marked below.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct SynthConfig {
    /// Seed of all random choices. Default 0.
    pub seed: u64,
    /// Width of the samples in pixels. Default 288.
    pub width: u32,
    /// Height of the samples in pixels. Default 160.
    pub height: u32,
    /// Width of the photos that the crops were cut from, in pixels. Default 640.
    ///
    /// Objects are turned and scaled in camera pixels and then resized to the sample, as inference resizes the
    /// camera's picture: 640x480 squeezed to 288x160 does not keep proportions, and samples must not either.
    pub camera_width: u32,
    /// Height of those photos, in pixels. Default 480.
    pub camera_height: u32,
    /// Fewest and most objects in a sample. Default (1, 3); the paper's N is not printed.
    pub objects: (u32, u32),
    /// Share of samples without any object or distractor. Default 0.05.
    pub background_only: f64,
    /// Smallest and largest size of an object relative to its photo. Default (0.5, 1.0); open in the paper.
    pub scale: (f64, f64),
    /// Smallest and largest turn in the image plane, in degrees. Default (-30, 30); open in the paper.
    pub rotation_deg: (f64, f64),
    /// Smallest and largest turn out of the image plane, in degrees, about an axis of random direction; the crop is
    /// taken as a flat picture seen by a camera with a focal length of `camera_width` pixels (or of the largest crop's
    /// diagonal, if that is more). Default (0, 0): not in the paper.
    pub tilt_deg: (f64, f64),
    /// Mirror every second object left to right. Default true.
    pub flip: bool,
    /// Added to an object's colours, as a share of white, -1 to 1. Default (0, 0): not in the paper.
    pub brightness: (f64, f64),
    /// Growth of the distances from middle grey, as a share, -1 (all grey) to 10. Default (0, 0): not in the paper.
    pub contrast: (f64, f64),
    /// Rotation about the grey axis, in degrees. Default (0, 0): not in the paper.
    pub hue_deg: (f64, f64),
    /// Standard deviation of an object's own blur, as of a camera out of focus, in sample pixels. Default (0, 0): not
    /// in the paper.
    pub blur_px: (f64, f64),
    /// How often each blend is chosen, per object.
    pub blend_weights: BlendWeights,
    /// Make each layout once with every blend of positive weight (Dwibedi et al. 2017): with *n* blends, samples
    /// *n·k* to *n·k + n - 1* differ in the blend alone, and in labels if these follow it
    /// ([`LabelRule::Changed`]). A [placer](crate::Synthesizer::placed_by) then sees the background without objects,
    /// whose blends differ. Default false; the paper found no benefit.
    pub paired_blends: bool,
    /// Standard deviation of the Gaussian blend in sample pixels, 5x5 kernel. Default 2.
    pub gaussian_sigma: f64,
    /// Fewest and most distractors in a sample; they are labelled background. Default (0, 0).
    pub distractors: (u32, u32),
    /// Largest share of an object that later ones may hide, 0 to 1. Default 0.75.
    pub max_occlusion: f64,
    /// Largest share of an object that may lie outside the sample, 0 to 1 (exclusive). Default 0.25.
    pub truncation: f64,
    /// Attempts to place an object within the limits before it is left out. Default 10.
    pub attempts: u32,
    /// Smallest side of the background's cut-out as a share of the largest possible one. Default 0.5.
    pub background_zoom: f64,
    /// Which pixels are labelled.
    pub label_rule: LabelRule,
}

impl Default for SynthConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            width: 288,
            height: 160,
            camera_width: 640,
            camera_height: 480,
            objects: (1, 3),
            background_only: 0.05,
            scale: (0.5, 1.0),
            rotation_deg: (-30.0, 30.0),
            tilt_deg: (0.0, 0.0),
            flip: true,
            brightness: (0.0, 0.0),
            contrast: (0.0, 0.0),
            hue_deg: (0.0, 0.0),
            blur_px: (0.0, 0.0),
            blend_weights: BlendWeights::default(),
            paired_blends: false,
            gaussian_sigma: 2.0,
            distractors: (0, 0),
            max_occlusion: 0.75,
            truncation: 0.25,
            attempts: 10,
            background_zoom: 0.5,
            label_rule: LabelRule::default(),
        }
    }
}

/// How often each blend is chosen, relative to the others.
///
/// The default is the paper's "both blending methods", Gaussian and Poisson; its comparison without blending is
/// `BlendWeights { none: 1.0, gaussian: 0.0, poisson: 0.0, ..BlendWeights::default() }`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct BlendWeights {
    /// Weight of [`Blend::None`]. Default 0.
    pub none: f64,
    /// Weight of [`Blend::Gaussian`]. Default 1.
    pub gaussian: f64,
    /// Weight of [`Blend::Poisson`]. Default 1.
    pub poisson: f64,
    /// Weight of [`Blend::Mixed`]. Default 0.
    pub mixed: f64,
    /// Weight of [`Blend::Box`]. Default 0.
    pub box_filter: f64,
    /// Weight of [`Blend::Motion`], which blurs a whole sample when one of its objects draws it: meant for
    /// [`paired_blends`](SynthConfig::paired_blends). Default 0.
    pub motion: f64,
}

impl Default for BlendWeights {
    fn default() -> Self {
        Self { none: 0.0, gaussian: 1.0, poisson: 1.0, mixed: 0.0, box_filter: 0.0, motion: 0.0 }
    }
}

impl BlendWeights {
    fn entries(&self) -> [(Blend, f64); 6] {
        [
            (Blend::None, self.none),
            (Blend::Gaussian, self.gaussian),
            (Blend::Poisson, self.poisson),
            (Blend::Mixed, self.mixed),
            (Blend::Box, self.box_filter),
            (Blend::Motion, self.motion),
        ]
    }

    /// Blends of positive weight.
    pub(crate) fn used(&self) -> Vec<Blend> {
        let entries = self.entries().into_iter();
        entries.filter(|entry| entry.1 > 0.0).map(|entry| entry.0).collect()
    }

    pub(crate) fn draw(&self, rng: &mut SampleRng) -> Blend {
        let total: f64 = self.entries().iter().map(|entry| entry.1).sum();
        let mut left = rng.unit() * total;
        let mut last = Blend::None;
        for (blend, weight) in self.entries().into_iter().filter(|entry| entry.1 > 0.0) {
            last = blend;
            left -= weight;
            if left < 0.0 {
                break;
            }
        }
        last
    }
}

/// Which pixels of a placed object are labelled.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum LabelRule {
    /// Pixels at least half covered by the object.
    #[default]
    Geometric,
    /// Pixels that the blend changed by more than `tolerance` grey levels in some channel: the paper's words.
    ///
    /// Not the default: gradient-domain blending changes some pixels of an object not at all, and blurred edges change
    /// pixels beside it. With OpenCV's clone such labels differ from the geometry by 19 to 36 % of `IoU`.
    Changed {
        /// Largest change, in grey levels, that counts as none.
        tolerance: u8,
    },
}

/// Largest width and height of samples, photos and crops, in pixels.
pub(crate) const MAX_SIDE: u32 = 1 << 14;

impl SynthConfig {
    pub(crate) fn validate(&self) -> Result<()> {
        let sides = [
            ("width", self.width),
            ("height", self.height),
            ("camera_width", self.camera_width),
            ("camera_height", self.camera_height),
        ];
        for (field, side) in sides {
            require((1..=MAX_SIDE).contains(&side), field, side, "1 to 16384 pixels")?;
        }
        require(self.objects.0 <= self.objects.1, "objects", self.objects, "(fewest, most)")?;
        require(self.distractors.0 <= self.distractors.1, "distractors", self.distractors, "(fewest, most)")?;
        let many = self.objects.1.saturating_add(self.distractors.1);
        require(many <= 1000, "objects + distractors", many, "at most 1000")?;
        self.validate_ranges()?;
        self.validate_shares()?;
        require(self.attempts > 0, "attempts", self.attempts, "at least 1")?;
        let sigma = self.gaussian_sigma;
        require(sigma.is_finite() && sigma > 0.0, "gaussian_sigma", sigma, "a positive number of pixels")?;
        let weights = self.blend_weights.entries();
        let valid = weights.iter().all(|entry| entry.1.is_finite() && entry.1 >= 0.0);
        let any = weights.iter().any(|entry| entry.1 > 0.0);
        require(valid && any, "blend_weights", self.blend_weights, "no negative weight and a positive one")
    }

    fn validate_ranges(&self) -> Result<()> {
        let ranges = [
            ("scale", self.scale),
            ("rotation_deg", self.rotation_deg),
            ("brightness", self.brightness),
            ("contrast", self.contrast),
            ("hue_deg", self.hue_deg),
            ("tilt_deg", self.tilt_deg),
            ("blur_px", self.blur_px),
        ];
        for (field, range) in ranges {
            let ordered = range.0.is_finite() && range.1.is_finite() && range.0 <= range.1;
            require(ordered, field, range, "(smallest, largest), both finite")?;
        }
        let sensible = self.scale.0 >= 1e-3 && self.scale.1 <= 1e3;
        require(sensible, "scale", self.scale, "a range within 0.001 to 1000")?;
        let brightness = self.brightness.0 >= -1.0 && self.brightness.1 <= 1.0;
        require(brightness, "brightness", self.brightness, "a range within -1 to 1")?;
        let contrast = self.contrast.0 >= -1.0 && self.contrast.1 <= 10.0;
        require(contrast, "contrast", self.contrast, "a range within -1 to 10")?;
        let tilt = self.tilt_deg.0 >= -75.0 && self.tilt_deg.1 <= 75.0;
        require(tilt, "tilt_deg", self.tilt_deg, "a range within -75 to 75")?;
        let blur = self.blur_px.0 >= 0.0 && self.blur_px.1 <= 50.0;
        require(blur, "blur_px", self.blur_px, "a range within 0 to 50")
    }

    fn validate_shares(&self) -> Result<()> {
        let shares = [
            ("background_only", self.background_only),
            ("max_occlusion", self.max_occlusion),
            ("truncation", self.truncation),
            ("background_zoom", self.background_zoom),
        ];
        for (field, share) in shares {
            require((0.0..=1.0).contains(&share), field, share, "a share from 0 to 1")?;
        }
        require(self.truncation < 1.0, "truncation", self.truncation, "less than 1")?;
        require(self.background_zoom > 0.0, "background_zoom", self.background_zoom, "more than 0")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_nan_is_not() {
        SynthConfig::default().validate().unwrap();
        let nan = SynthConfig { scale: (f64::NAN, 1.0), ..SynthConfig::default() };
        assert!(nan.validate().is_err());
        for (low, high) in [(-1.1, 0.0), (0.0, 10.5), (-1e300, 1e300)] {
            assert!(SynthConfig { brightness: (low, high), ..SynthConfig::default() }.validate().is_err());
            assert!(SynthConfig { contrast: (low, high), ..SynthConfig::default() }.validate().is_err());
        }
        let widest = SynthConfig { brightness: (-1.0, 1.0), contrast: (-1.0, 10.0), ..SynthConfig::default() };
        widest.validate().unwrap();
        let nothing = BlendWeights { gaussian: 0.0, poisson: 0.0, ..BlendWeights::default() };
        assert!(SynthConfig { blend_weights: nothing, ..SynthConfig::default() }.validate().is_err());
    }

    #[test]
    fn weights_are_respected() {
        let weights = BlendWeights { none: 1.0, gaussian: 3.0, poisson: 0.0, ..BlendWeights::default() };
        let mut rng = SampleRng::new(5, 0);
        let gaussian = (0..4000).filter(|_| weights.draw(&mut rng) == Blend::Gaussian).count();
        assert!((2850..3150).contains(&gaussian), "{gaussian}");
    }
}
