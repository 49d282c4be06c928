use image::RgbImage;
use std::fmt;
use std::sync::Arc;

/// An object that waits for a place in a sample.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Candidate<'a> {
    /// Its class; 0 for a distractor.
    pub class: u8,
    /// Index of its crop among the object crops, or among the distractors when `class` is 0.
    pub crop: usize,
    /// How far it reaches from its middle to the left, top, right and bottom, in sample pixels.
    pub extent: [f64; 4],
    /// The sample so far: the background and the objects placed before; with
    /// [`paired_blends`](crate::SynthConfig::paired_blends) only the background.
    pub picture: &'a RgbImage,
    /// How many places were refused before, because too much of this or of another object would be hidden.
    pub attempt: u32,
}

/// Chooses the pixel (x, y) on which an object's middle falls, with uniform random numbers in [0, 1) at its disposal.
pub(crate) type PlaceFn = dyn Fn(&Candidate, &mut dyn FnMut() -> f64) -> [f64; 2] + Send + Sync;

/// A user's choice of places, with a name for the digest.
#[derive(Clone)]
pub(crate) struct Placer {
    pub(crate) name: String,
    pub(crate) place: Arc<PlaceFn>,
}

impl fmt::Debug for Placer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Placer({:?})", self.name)
    }
}

impl Candidate<'_> {
    /// A place anywhere in the sample, of which `truncation` (a share of its width and height) may lie outside.
    pub fn random_centre(&self, truncation: f64, random: &mut dyn FnMut() -> f64) -> [f64; 2] {
        let output = [f64::from(self.picture.width()), f64::from(self.picture.height())];
        [0, 1].map(|axis| {
            let (before, behind) = (self.extent[axis], self.extent[axis + 2]);
            let outside = truncation * (before + behind);
            // Pixel centres run from 0 to length - 1.
            let (low, high) = (before - outside - 0.5, output[axis] - 0.5 - behind + outside);
            low + (high - low) * random()
        })
    }
}
