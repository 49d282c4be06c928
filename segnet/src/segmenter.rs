//! A trained network, ready for images.

mod parts;
pub(crate) mod upsampling;

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use burn::module::Module;
use burn::tensor::Device;
use fast_image_resize::images::Image;
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer};
use image::{GrayImage, ImageBuffer, Luma, RgbImage};
use serde::{Deserialize, Serialize};

use crate::kernels::Isa;
use crate::plan::folded::FoldedNet;
use crate::weights::{Renaming, TensorFile, encode, write};
use crate::{BiSeNet, BiSeNetConfig, Error, Normalization, Plan, Precision, Result};

/// Raised when the file changes its meaning.
const VERSION: u32 = 1;

/// What must be known of a network to apply it; stored with its weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkDescription {
    version: u32,
    /// The architecture.
    pub net: BiSeNetConfig,
    /// One name per class, the background first.
    pub class_names: Vec<String>,
    /// What it sees of a colour.
    pub normalization: Normalization,
    /// Width of the images it sees, in pixels.
    pub width: u32,
    /// Height of the images it sees, in pixels.
    pub height: u32,
    /// Probability that a part must reach somewhere, see [`Segmenter::with_peak`]; 0 = all parts stay.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub peak: f32,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_zero(value: &f32) -> bool {
    *value == 0.0
}

impl NetworkDescription {
    /// Classes are named `background`, `class 1`, `class 2`, ...
    pub fn new(net: BiSeNetConfig, normalization: Normalization, width: u32, height: u32) -> Self {
        let name = |class| if class == 0 { "background".to_owned() } else { format!("class {class}") };
        let class_names = (0..net.classes).map(name).collect();
        Self { version: VERSION, net, class_names, normalization, width, height, peak: 0.0 }
    }

    fn validate(&self) -> Result<()> {
        self.net.validate()?;
        self.normalization.validate()?;
        for (field, side) in [("width", self.width), ("height", self.height)] {
            self.net.check_side(field, side as usize)?;
        }
        if self.class_names.len() != self.net.classes {
            return Err(Error::config("class_names", format!("{:?}", self.class_names), "one name per class"));
        }
        if !(0.0..1.0).contains(&self.peak) {
            return Err(Error::config("peak", self.peak, "a probability from 0 to below 1"));
        }
        Ok(())
    }
}

/// What the network found in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Segmentation {
    /// Class of each pixel, 0 = background; of the image's size.
    pub labels: GrayImage,
    /// Probability of not being background, 0 to 1, of the network's size.
    pub foreground: ImageBuffer<Luma<f32>, Vec<f32>>,
    /// Mean probability of the foreground over the pixels labelled so; `None` if there are none.
    pub confidence: Option<f32>,
}

/// A network, its description, and nothing left to choose.
#[derive(Clone, Debug)]
pub struct Segmenter {
    net: BiSeNet,
    description: NetworkDescription,
    plans: Arc<Plans>,
}

/// Plans for calls at the same time: each takes one that is free, or makes one.
#[derive(Debug)]
struct Plans {
    net: Arc<FoldedNet>,
    size: [usize; 2],
    precision: Precision,
    free: Mutex<Vec<Plan>>,
}

impl Plans {
    /// No lock is held while `work` runs: it runs on the threads of the pool, which may call this again.
    fn with<T>(&self, work: impl FnOnce(&mut Plan) -> Result<T>) -> Result<T> {
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let plan = free().pop();
        let mut plan = plan.unwrap_or_else(|| Plan::new(&self.net, self.size, self.precision, Isa::detect()));
        let found = work(&mut plan)?;
        free().push(plan);
        Ok(found)
    }
}

impl Segmenter {
    /// From a network in memory.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if the description is impossible, [`Error::WeightsNeed`] if it describes another network.
    #[expect(clippy::needless_pass_by_value, reason = "the network is handed over: what trained it ends here")]
    pub fn from_net(net: BiSeNet, description: NetworkDescription) -> Result<Self> {
        description.validate()?;
        if net.config() != &description.net {
            let (needed, found) = (format!("{:?}", description.net), format!("{:?}", net.config()));
            return Err(Error::WeightsNeed { what: "the architecture", needed, found });
        }
        let net = net.valid();
        let size = [description.height as usize, description.width as usize];
        let folded = Arc::new(net.folded()?);
        let plans = Arc::new(Plans { net: folded, size, precision: Precision::default(), free: Mutex::default() });
        Ok(Self { net, description, plans })
    }

    /// The same network, applied with another precision; the default is [`Precision::F32`]. It is not saved.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        let Plans { net, size, .. } = &*self.plans;
        let plans = Arc::new(Plans { net: Arc::clone(net), size: *size, precision, free: Mutex::default() });
        Self { plans, ..self }
    }

    /// The same network, asked to be surer: an object's class is taken only where the network held it for likelier than
    /// `probability` against the background; 0.5 changes nothing.
    ///
    /// A network that has seen few of the things which resemble its object takes in parts of others, with less certainty
    /// than the object itself. The threshold becomes part of the last layer's bias, so it is saved with the network, and
    /// moves [`Segmentation::foreground`] and [`Segmentation::confidence`] too.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if the probability is not above 0 and below 1.
    pub fn with_threshold(self, probability: f64) -> Result<Self> {
        let margin = (probability / (1.0 - probability)).ln();
        if !margin.is_finite() {
            return Err(Error::config("threshold", probability, "a probability above 0 and below 1"));
        }
        let Self { mut net, description, plans } = self;
        net.lower_objects(margin as f32);
        Ok(Self::from_net(net, description)?.with_precision(plans.precision))
    }

    /// The same network, whose parts are only taken if it is sure of them somewhere: pixels of one class that touch become
    /// background together unless one of them has at least this probability; 0 changes nothing. Hysteresis thresholding
    /// (Canny 1986) of probabilities: a whole object has a pixel beyond doubt, what merely resembles it seldom.
    ///
    /// Probabilities are those behind [`Segmenter::with_threshold`]. The peak is saved with the network, and used by
    /// [`Segmenter::segment`]; a [`Plan`] of the network gives logits without it.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if the probability is not from 0 to below 1.
    pub fn with_peak(mut self, probability: f64) -> Result<Self> {
        self.description.peak = probability as f32;
        self.description.validate()?;
        Ok(self)
    }

    /// Reads what [`Segmenter::save`] wrote.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] or [`Error::Format`] if the file cannot be read, [`Error::Config`] if its description is
    /// impossible, and the errors of tensors that do not fit, as for [`crate::load_backbone`].
    pub fn load(path: &Path) -> Result<Self> {
        let file = TensorFile::read(path)?;
        let description: NetworkDescription = serde_json::from_str(&file.description()?)
            .map_err(|error| file.wrong(format!("its description is no network's: {error}")))?;
        if description.version != VERSION {
            return Err(file.wrong(format!("its version is {}, this program reads {VERSION}", description.version)));
        }
        description.validate()?;
        let mut net = description.net.init(&Device::flex())?;
        let renaming = Renaming::own(&net);
        file.check(&net, &renaming, |_| false)?;
        file.load_into(&mut net, &renaming)?;
        Self::from_net(net, description)
    }

    /// Writes one safetensors file, weights under the names of PyTorch's modules and the description as JSON in the
    /// metadata. The file is written beside and renamed: it is complete or not there.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let description = serde_json::to_string(&self.description).map_err(|error| Error::Burn(error.to_string()))?;
        write(path, &encode(&self.net, &Renaming::own(&self.net), &[], description)?)
    }

    /// What must be known of the network.
    pub fn description(&self) -> &NetworkDescription {
        &self.description
    }

    /// The network, on a plain device.
    pub fn net(&self) -> &BiSeNet {
        &self.net
    }

    /// Finds the classes in an image of any size. It is squeezed to the network's size (each side by its own factor,
    /// with a filter over the covered area), and probabilities are stretched back before the likeliest class is taken.
    ///
    /// # Errors
    ///
    /// [`Error::EmptyImage`] if it has no pixels.
    pub fn segment(&self, image: &RgbImage) -> Result<Segmentation> {
        let (width, height) = image.dimensions();
        if width == 0 || height == 0 {
            return Err(Error::EmptyImage { width, height });
        }
        let mut probabilities = self.probabilities(&self.resized(image)?)?;
        let size = [self.description.height as usize, self.description.width as usize];
        if self.description.peak > 0.0 {
            parts::leave_out_unsure(&mut probabilities, size, self.description.peak);
        }
        let pixels = size[0] * size[1];
        let upsampled = upsampling::Upsampled::new(&probabilities, size, [height as usize, width as usize]);
        let (labels, confidence) = upsampled.labels(self.description.net.classes);
        let foreground = probabilities[..pixels].iter().map(|background| 1.0 - background).collect();
        let foreground = ImageBuffer::from_raw(self.description.width, self.description.height, foreground)
            .ok_or_else(|| Error::Burn("the probabilities do not fill the network's size".to_owned()))?;
        Ok(Segmentation { labels, foreground, confidence })
    }

    /// `[classes, height, width]` of an image of the network's size.
    fn probabilities(&self, image: &RgbImage) -> Result<Vec<f32>> {
        let mut planes = self.plans.with(|plan| plan.image_logits(image, &self.description.normalization))?;
        softmax(&mut planes, self.description.net.classes);
        Ok(planes)
    }

    fn resized(&self, image: &RgbImage) -> Result<RgbImage> {
        resize(image, self.description.width, self.description.height)
    }
}

/// Logits `[classes][pixels]` to probabilities.
fn softmax(planes: &mut [f32], classes: usize) {
    let pixels = planes.len() / classes;
    let mut largest = planes[..pixels].to_vec();
    for plane in planes.chunks_exact(pixels).skip(1) {
        largest.iter_mut().zip(plane).for_each(|(largest, logit)| *largest = largest.max(*logit));
    }
    let mut sums = vec![0.0; pixels];
    for plane in planes.chunks_exact_mut(pixels) {
        for ((value, largest), sum) in plane.iter_mut().zip(&largest).zip(&mut sums) {
            *value = (*value - largest).exp();
            *sum += *value;
        }
    }
    for plane in planes.chunks_exact_mut(pixels) {
        plane.iter_mut().zip(&sums).for_each(|(value, sum)| *value /= sum);
    }
}

/// A bilinear filter that widens with the factor when an image shrinks, so that every pixel counts.
pub(crate) fn resize(image: &RgbImage, width: u32, height: u32) -> Result<RgbImage> {
    if image.dimensions() == (width, height) {
        return Ok(image.clone());
    }
    let wrong = |error: String| Error::Burn(format!("resize to {width}x{height}: {error}"));
    let source =
        fast_image_resize::images::ImageRef::new(image.width(), image.height(), image.as_raw(), PixelType::U8x3);
    let source = source.map_err(|error| wrong(error.to_string()))?;
    let mut target = Image::new(width, height, PixelType::U8x3);
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
    Resizer::new().resize(&source, &mut target, &options).map_err(|error| wrong(error.to_string()))?;
    RgbImage::from_raw(width, height, target.into_vec()).ok_or_else(|| wrong("wrong size".to_owned()))
}

#[cfg(test)]
mod tests;
