use crate::augment::Frame;
use crate::backgrounds::{Backgrounds, Scratch};
use crate::blend::{Blend, Blender, MotionBlur};
use crate::compose::{Composition, Instance, Workspace};
use crate::config::SynthConfig;
use crate::crop::Crop;
use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::photos::{LabelledPhoto, Photos};
use crate::placer::{Candidate, Placer};
use crate::prepared::Prepared;
use crate::sample_rng::SampleRng;
use image::{GrayImage, ImageBuffer, Luma, RgbImage};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A training image with its truth.
///
/// `Sample::default()` is empty, a place for [`Synthesizer::sample_into`] to write to.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Sample {
    /// The composed picture.
    pub image: RgbImage,
    /// Class of each pixel, 0 for the background; the size of `image`.
    pub label: GrayImage,
    /// Owner of each pixel, 1 + index into `instances`, 0 for the background; the size of `image`.
    ///
    /// The pixels of one value are the visible mask of one instance, distractors included.
    pub owners: ImageBuffer<Luma<u16>, Vec<u16>>,
    /// What was placed and can be seen, in the order of placing.
    pub instances: Vec<Instance>,
}

/// Makes training samples: sample *i* is a pure function of configuration, inputs and *i*.
///
/// The same sample comes out alone, in any order and on any number of threads. A `Synthesizer` can be shared by
/// threads without a lock.
#[derive(Clone, Debug)]
pub struct Synthesizer {
    config: SynthConfig,
    frame: Frame,
    crops: Vec<Prepared>,
    distractors: Vec<Prepared>,
    backgrounds: Backgrounds,
    blends: Vec<Blend>,
    blender: Blender,
    placer: Option<Placer>,
    photos: Option<Photos>,
    digest: u64,
}

#[derive(Default)]
struct Buffers {
    workspace: Workspace,
    blender: Option<Blender>,
    scratch: Scratch,
}

thread_local! {
    /// Buffers that the samples of one thread share; each sample overwrites what it reads.
    static BUFFERS: RefCell<Buffers> = RefCell::default();
}

impl Synthesizer {
    /// Checks configuration and inputs and prepares the crops.
    ///
    /// # Errors
    ///
    /// [`Error::InvalidConfig`] for values out of range, an object crop of class 0 or a crop of more than 16384 pixels
    /// a side, [`Error::NoCrops`] if objects or distractors are asked for and there is none, [`Error::EmptyMask`] for a
    /// crop without an object pixel.
    pub fn new(
        crops: Vec<Crop>,
        distractors: Vec<Crop>,
        backgrounds: Backgrounds,
        config: SynthConfig,
    ) -> Result<Self> {
        config.validate()?;
        require_crops("object crops", &crops, config.objects)?;
        require_crops("distractor crops", &distractors, config.distractors)?;
        for crop in &crops {
            crate::error::require(crop.class > 0, "class", crop.class, "1 to 255 for an object crop")?;
        }
        let digest = digest_of(&crops, &distractors, &backgrounds, &config);
        let prepared = |crops: Vec<Crop>| -> Result<Vec<Prepared>> {
            crops.into_iter().map(|crop| Prepared::new(&crop, crop.class)).collect()
        };
        let crops = prepared(crops)?;
        let distractors = distractors.into_iter().map(|crop| Crop { class: 0, ..crop }).collect();
        let distractors = prepared(distractors)?;
        // However it is tilted, nothing of an object reaches the camera's plane.
        let widest = crops.iter().chain(&distractors).map(Prepared::diagonal).fold(0.0, f64::max);
        let frame = Frame {
            width: config.width,
            height: config.height,
            camera_per_output: [
                f64::from(config.camera_width) / f64::from(config.width),
                f64::from(config.camera_height) / f64::from(config.height),
            ],
            focal: f64::from(config.camera_width).max(widest),
        };
        Ok(Self {
            frame,
            crops,
            distractors,
            backgrounds,
            blends: config.blend_weights.used(),
            blender: Blender::new(config.gaussian_sigma)?,
            config,
            placer: None,
            photos: None,
            digest,
        })
    }

    /// The same with places chosen by `place` instead of anywhere: on a table, say, or never on top of each other.
    ///
    /// `place` gives the pixel (x, y) on which an object's middle falls. What it decides must follow from its arguments
    /// alone, random numbers included, for samples to stay pure; `name` stands for it in the digest. The limits of
    /// truncation and occlusion hold as before: a place that breaks them is refused and another asked for.
    ///
    /// ```
    /// # use image::{Rgba, RgbaImage};
    /// use synth::{Backgrounds, Candidate, Crop, SynthConfig, Synthesizer};
    ///
    /// # let crop = Crop { image: RgbaImage::from_pixel(30, 30, Rgba([90, 60, 30, 255])), class: 1, name: String::new()
    /// }; let config = SynthConfig { background_only: 0.0, ..SynthConfig::default() }; let on_the_floor = |candidate:
    /// &Candidate, random: &mut dyn FnMut() -> f64| {     let [x, y] = candidate.random_centre(0.0, random);     [x,
    /// y.max(80.0)] }; let synthesizer = Synthesizer::new(vec![crop], vec![], Backgrounds::procedural(0, 2)?, config)?;
    /// let synthesizer = synthesizer.placed_by("lower half", on_the_floor); let sample = synthesizer.sample(0)?;
    /// assert!(sample.instances.iter().all(|instance| instance.bbox[1] + instance.bbox[3] / 2 >= 79));
    /// # Ok::<(), synth::Error>(())
    /// ```
    #[must_use]
    pub fn placed_by(
        mut self,
        name: impl Into<String>,
        place: impl Fn(&Candidate, &mut dyn FnMut() -> f64) -> [f64; 2] + Send + Sync + 'static,
    ) -> Self {
        let placer = Placer { name: name.into(), place: Arc::new(place) };
        let mut digest = Digest::new("placed by");
        digest.number(self.digest);
        digest.bytes(placer.name.as_bytes());
        self.digest = digest.finish();
        self.placer = Some(placer);
        self
    }

    /// The same with a share of the samples made from photos that are labelled already: captures, say, in which depth
    /// has found the object.
    ///
    /// Such a sample is a random cut-out of a photo, mirrored or not, its colours changed as an object's are;
    /// distractors are put on it, but no further objects. It shows what no composition does: true light, shadows and
    /// surroundings. Photos given before are no longer used. The share of background only counts among the other
    /// samples.
    ///
    /// # Errors
    ///
    /// [`Error::InvalidConfig`] for a share outside of 0 to 1, or above 0 without photos, or a photo without a pixel;
    /// [`Error::SizeMismatch`] if a photo and its label map differ in size.
    pub fn with_photos(mut self, photos: Vec<LabelledPhoto>, share: f64) -> Result<Self> {
        let photos = Photos::new(photos, share)?;
        if share == 0.0 {
            return Ok(self);
        }
        let mut digest = Digest::new("with photos");
        digest.number(self.digest);
        photos.digest(&mut digest);
        self.digest = digest.finish();
        self.photos = Some(photos);
        Ok(self)
    }

    /// The labelled photos that take part, see [`with_photos`](Self::with_photos).
    pub fn photos(&self) -> &[LabelledPhoto] {
        self.photos.as_ref().map_or(&[], Photos::all)
    }

    /// The configuration in use.
    pub fn config(&self) -> &SynthConfig {
        &self.config
    }

    /// Classes of the object crops and of labelled photos, ascending, each once.
    pub fn classes(&self) -> Vec<u8> {
        let photos = self.photos.iter().flat_map(Photos::classes);
        let classes: BTreeSet<u8> = self.crops.iter().map(|crop| crop.class).chain(photos).collect();
        classes.into_iter().collect()
    }

    /// A number that differs when configuration, crops, photos, backgrounds or the name of the placer differ.
    pub fn digest(&self) -> u64 {
        self.digest
    }

    /// Sample `index`.
    ///
    /// # Errors
    ///
    /// [`Error::NoBackgrounds`] if backgrounds are read from disk and none is left that can be; [`Error::Resize`] if
    /// one cannot be resized, which checked inputs do not cause.
    pub fn sample(&self, index: u64) -> Result<Sample> {
        let mut sample = Sample::default();
        self.sample_into(index, &mut sample)?;
        Ok(sample)
    }

    /// Sample `index`, in the buffers of `sample`, whatever they held before.
    ///
    /// From the second sample of a size on, the images are written where they lie and nothing is allocated for them.
    ///
    /// # Errors
    ///
    /// As [`sample`](Self::sample); `sample` then holds nothing of use.
    ///
    /// ```
    /// use synth::{Backgrounds, Sample, SynthConfig, Synthesizer};
    /// let config = SynthConfig { objects: (0, 0), ..SynthConfig::default() };
    /// let synthesizer = Synthesizer::new(vec![], vec![], Backgrounds::procedural(0, 2)?, config)?;
    /// let mut sample = Sample::default();
    /// for index in 0..4 {
    ///     synthesizer.sample_into(index, &mut sample)?;
    ///     assert_eq!(sample, synthesizer.sample(index)?);
    /// }
    /// # Ok::<(), synth::Error>(())
    /// ```
    pub fn sample_into(&self, index: u64, sample: &mut Sample) -> Result<()> {
        // Taken out while in use: a placer may ask for samples of its own.
        let mut buffers = BUFFERS.take();
        let composed = self.compose(index, std::mem::take(sample), &mut buffers);
        BUFFERS.set(buffers);
        *sample = composed?;
        Ok(())
    }

    /// Samples `indices`, spread over rayon's threads with the feature `parallel`.
    ///
    /// # Errors
    ///
    /// As [`sample`](Self::sample).
    pub fn samples(&self, indices: std::ops::Range<u64>) -> Result<Vec<Sample>> {
        #[cfg(feature = "parallel")]
        {
            use rayon::prelude::*;
            indices.into_par_iter().map(|index| self.sample(index)).collect()
        }
        #[cfg(not(feature = "parallel"))]
        indices.map(|index| self.sample(index)).collect()
    }

    fn compose(&self, index: u64, mut sample: Sample, buffers: &mut Buffers) -> Result<Sample> {
        let Buffers { workspace, blender, scratch } = buffers;
        // The kernel belongs to this synthesizer; the solver's buffers are worth keeping.
        let blender = blender.get_or_insert_with(|| self.blender.clone());
        blender.take_kernel(&self.blender);
        let (layout, forced) = self.layout_of(index);
        let mut rng = SampleRng::new(self.config.seed, layout);
        let aspect = f64::from(self.config.camera_width) / f64::from(self.config.camera_height);
        let output = (self.config.width, self.config.height);
        let (zoom, mut buffer) = (self.config.background_zoom, sample.image.into_raw());
        let mut shot = match &self.photos {
            Some(photos) => photos.draw(&self.config, &mut rng, scratch, &mut buffer)?,
            None => None,
        };
        sample.image = match &mut shot {
            Some(shot) => std::mem::take(&mut shot.image),
            None => self.backgrounds.draw(&mut rng, aspect, zoom, output, scratch, buffer)?,
        };
        let placer = self.placer.as_ref().map(|placer| &*placer.place);
        let mut composition = Composition::new(&self.config, self.frame, placer, sample, workspace);
        if let (Some(photos), Some(shot)) = (&self.photos, &shot) {
            composition.show(shot, |class| photos.pixels_of(shot.photo, class) as f64 * shot.area_scale);
        }
        if shot.is_some() || !rng.chance(self.config.background_only) {
            for crop in self.draw_crops(shot.is_none(), &mut rng) {
                let drawn = self.config.blend_weights.draw(&mut rng);
                composition.place(crop, forced.unwrap_or(drawn), &mut rng, blender);
            }
        }
        let (mut sample, moving) = composition.finish();
        if moving {
            MotionBlur::draw(&mut rng).blur(&mut sample.image);
        }
        Ok(sample)
    }

    /// Which layout a sample shows and, for paired blends, with which blend.
    fn layout_of(&self, index: u64) -> (u64, Option<Blend>) {
        if !self.config.paired_blends {
            return (index, None);
        }
        let count = self.blends.len() as u64;
        (index / count, self.blends.get((index % count) as usize).copied())
    }

    /// Objects, unless a photo shows some already, and distractors in the order in which they are placed.
    fn draw_crops(&self, with_objects: bool, rng: &mut SampleRng) -> Vec<(usize, &Prepared)> {
        let mut drawn = Vec::new();
        let objects = if with_objects { self.config.objects } else { (0, 0) };
        for (crops, range) in [(&self.crops, objects), (&self.distractors, self.config.distractors)] {
            for _ in 0..rng.between(range) {
                let index = rng.below(crops.len());
                drawn.push((index, &crops[index]));
            }
        }
        rng.shuffle(&mut drawn);
        drawn
    }
}

fn require_crops(what: &'static str, crops: &[Crop], range: (u32, u32)) -> Result<()> {
    if crops.is_empty() && range.1 > 0 {
        return Err(Error::NoCrops { what });
    }
    Ok(())
}

/// Changes whenever samples of the same inputs would come out differently.
const FORMAT: &str = "synth sample 6";

fn digest_of(crops: &[Crop], distractors: &[Crop], backgrounds: &Backgrounds, config: &SynthConfig) -> u64 {
    let mut digest = Digest::new(FORMAT);
    // Debug prints floating-point numbers so that they read back exactly.
    digest.bytes(format!("{config:?}").as_bytes());
    for set in [crops, distractors] {
        digest.number(set.len() as u64);
        for crop in set {
            digest.number(u64::from(crop.class));
            digest.number(u64::from(crop.image.width()));
            digest.bytes(crop.image.as_raw());
        }
    }
    backgrounds.digest(&mut digest);
    digest.finish()
}
