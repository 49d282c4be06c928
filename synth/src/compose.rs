use crate::augment::{ColourMap, Frame, Layer, Placement, Pyramid, warp};
use crate::blend::{Blend, Blender};
use crate::config::{LabelRule, SynthConfig};
use crate::crop::Crop;
use crate::error::{Error, Result};
use crate::sample_rng::SampleRng;
use crate::synthesizer::Sample;
use image::{ImageBuffer, Pixel, Primitive as _};

/// An object or distractor as it ended up in a sample.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Instance {
    /// Class in the label map; 0 for a distractor.
    pub class: u8,
    /// Index of the crop among the object crops, or among the distractors when `class` is 0.
    pub crop: usize,
    /// Box around the visible pixels: left, top, width, height, in sample pixels.
    pub bbox: [u32; 4],
    /// Number of labelled, visible pixels.
    pub visible_px: u32,
    /// Visible share of the whole object, 0 to 1; parts outside the sample and parts hidden by others do not count.
    pub visible_fraction: f64,
    /// How it was blended.
    pub blend: Blend,
    /// Size relative to the photo.
    pub scale: f64,
    /// Turn in the image plane, in degrees, clockwise as seen.
    pub rotation_deg: f64,
    /// Whether it was mirrored left to right.
    pub flipped: bool,
}

/// A crop made ready for warping.
#[derive(Clone, Debug)]
pub(crate) struct Prepared {
    class: u8,
    pyramid: Pyramid,
    /// Middle of the object's bounding box, in crop pixels, and its size.
    middle: [f64; 2],
    size: [f64; 2],
    /// Covered area in camera pixels.
    area: f64,
}

impl Prepared {
    pub(crate) fn new(crop: &Crop, class: u8) -> Result<Self> {
        let bounds = crop.object_bounds().ok_or_else(|| Error::EmptyMask { name: crop.name.clone() })?;
        let (left, top, right, bottom) = bounds;
        let coverage: u64 = crop.image.pixels().map(|pixel| u64::from(pixel[3])).sum();
        Ok(Self {
            class,
            pyramid: Pyramid::new(&crop.image),
            middle: [0.5 * f64::from(left + right), 0.5 * f64::from(top + bottom)],
            size: [f64::from(right - left + 1), f64::from(bottom - top + 1)],
            area: coverage as f64 / 255.0,
        })
    }

    pub(crate) fn class(&self) -> u8 {
        self.class
    }
}

/// Buffers of one thread; nothing in them outlives a sample.
#[derive(Default)]
pub(crate) struct Workspace {
    layer: Layer,
    before: Vec<u8>,
}

/// A picture while objects are put into it, each over the ones before.
pub(crate) struct Composition<'a> {
    config: &'a SynthConfig,
    frame: Frame,
    /// Its owners are 1 + index into `placed` until the end; its instances wait in `placed`.
    sample: Sample,
    placed: Vec<Placed>,
}

struct Placed {
    instance: Instance,
    /// Area of the whole object in sample pixels.
    area: f64,
    /// Labelled pixels when it was placed.
    own_px: u32,
}

impl<'a> Composition<'a> {
    /// Begins on the background that `sample.image` shows; the rest of `sample` is only buffers.
    pub(crate) fn new(config: &'a SynthConfig, frame: Frame, mut sample: Sample) -> Self {
        let size = sample.image.dimensions();
        sample.label = zeroed(sample.label, size);
        sample.owners = zeroed(sample.owners, size);
        sample.instances.clear();
        Self { config, frame, sample, placed: Vec::new() }
    }

    /// Puts an object at a random place within the limits of truncation and occlusion; after
    /// [`attempts`](SynthConfig::attempts) failures it is left out.
    pub(crate) fn place(
        &mut self,
        (index, crop): (usize, &Prepared),
        blend: Blend,
        rng: &mut SampleRng,
        blender: &mut Blender,
        workspace: &mut Workspace,
    ) {
        let colour = self.draw_colour(rng);
        for _ in 0..self.config.attempts {
            let placement = self.draw_placement(crop, rng);
            let area = crop.area * placement.scale.powi(2) / self.frame.camera_per_output.iter().product::<f64>();
            if !self.warp_within_limits(crop, placement, area, &colour, blend, workspace) {
                continue;
            }
            let instance = Instance {
                class: crop.class,
                crop: index,
                bbox: [0; 4],
                visible_px: 0,
                visible_fraction: 0.0,
                blend,
                scale: placement.scale,
                rotation_deg: placement.rotation.to_degrees(),
                flipped: placement.flip,
            };
            self.put(instance, area, blender, workspace);
            return;
        }
    }

    fn draw_colour(&self, rng: &mut SampleRng) -> ColourMap {
        let config = self.config;
        let [brightness, contrast, hue] =
            [config.brightness, config.contrast, config.hue_deg].map(|range| rng.uniform(range));
        if brightness == 0.0 && contrast == 0.0 && hue == 0.0 {
            return ColourMap::IDENTITY;
        }
        ColourMap::new(brightness, contrast, hue)
    }

    /// An object larger than the sample is shrunk to fit.
    fn draw_placement(&self, crop: &Prepared, rng: &mut SampleRng) -> Placement {
        let config = self.config;
        let mut placement = Placement {
            scale: rng.uniform(config.scale),
            rotation: rng.uniform(config.rotation_deg).to_radians(),
            flip: config.flip && rng.chance(0.5),
            centre: [0.0; 2],
        };
        let output = [f64::from(self.frame.width), f64::from(self.frame.height)];
        let half = placement.half_extent(crop.size, &self.frame);
        let fit = (output[0] / (2.0 * half[0])).min(output[1] / (2.0 * half[1])).min(1.0);
        placement.scale *= fit;
        placement.centre = [0, 1].map(|axis| {
            // So much of the box may stick out on each side; pixel centres run from 0 to length - 1.
            let inset = fit * half[axis] * (1.0 - 2.0 * config.truncation);
            rng.uniform((inset - 0.5, output[axis] - 0.5 - inset))
        });
        placement
    }

    /// Warps the crop into the workspace's layer; false if too little of it, or of the objects below, stays visible.
    fn warp_within_limits(
        &self,
        crop: &Prepared,
        placement: Placement,
        area: f64,
        colour: &ColourMap,
        blend: Blend,
        workspace: &mut Workspace,
    ) -> bool {
        // Rounding of the outline must not fail an object that lies wholly inside.
        const ROUNDING: f64 = 0.05;
        let Some(rectangle) = placement.rectangle(crop.size, Blender::reach(blend), &self.frame) else {
            return false;
        };
        workspace.layer.cover(rectangle);
        warp(&crop.pyramid, &placement.to_crop(crop.middle, &self.frame), colour, &mut workspace.layer);
        let inside = workspace.layer.object_area() as f64;
        let enough = (1.0 - self.config.truncation - ROUNDING).max(0.0) * area;
        inside >= enough.max(1.0) && self.leaves_others_visible(&workspace.layer)
    }

    fn leaves_others_visible(&self, layer: &Layer) -> bool {
        if self.config.max_occlusion >= 1.0 || self.placed.is_empty() {
            return true;
        }
        let mut visible = vec![0_u32; self.placed.len() + 1];
        for owner in self.sample.owners.as_raw() {
            visible[usize::from(*owner)] += 1;
        }
        self.for_each_pixel(layer, |index, pixel| {
            if layer.is_object(index) {
                visible[usize::from(self.sample.owners.as_raw()[pixel])] -= 1;
            }
        });
        let stays = 1.0 - self.config.max_occlusion;
        let enough = |(placed, &visible): (&Placed, &u32)| f64::from(visible) >= stays * f64::from(placed.own_px);
        self.placed.iter().zip(&visible[1..]).all(enough)
    }

    /// Index within the layer and within the sample of each pixel of the layer.
    fn for_each_pixel(&self, layer: &Layer, mut visit: impl FnMut(usize, usize)) {
        let rectangle = layer.rectangle;
        for row in 0..rectangle.height {
            for column in 0..rectangle.width {
                let pixel = (rectangle.top + row) * self.frame.width as usize + rectangle.left + column;
                visit(row * rectangle.width + column, pixel);
            }
        }
    }

    fn put(&mut self, instance: Instance, area: f64, blender: &mut Blender, workspace: &mut Workspace) {
        let layer = &workspace.layer;
        let changed = matches!(self.config.label_rule, LabelRule::Changed { .. });
        if changed {
            workspace.before.clear();
            workspace.before.extend_from_slice(self.sample.image.as_raw());
        }
        blender.blend_layer(&mut self.sample.image, layer, instance.blend);
        let mut labelled = Vec::new();
        self.for_each_pixel(layer, |index, pixel| {
            let belongs = match self.config.label_rule {
                LabelRule::Geometric => layer.is_object(index),
                LabelRule::Changed { tolerance } => {
                    let range = 3 * pixel..3 * pixel + 3;
                    let after = &self.sample.image.as_raw()[range.clone()];
                    after.iter().zip(&workspace.before[range]).any(|(a, b)| a.abs_diff(*b) > tolerance)
                }
            };
            if belongs {
                labelled.push(pixel);
            }
        });
        let class = instance.class;
        let own_px = labelled.len() as u32;
        self.placed.push(Placed { instance, area, own_px });
        for pixel in labelled {
            self.sample.owners.as_mut()[pixel] = self.placed.len() as u16;
            self.sample.label.as_mut()[pixel] = class;
        }
    }

    /// The sample, with the instances of which something is visible.
    pub(crate) fn finish(self) -> Sample {
        let Self { mut sample, placed, frame, .. } = self;
        let mut boxes = vec![(u32::MAX, u32::MAX, 0, 0, 0_u32); placed.len()];
        for (pixel, owner) in sample.owners.as_raw().iter().enumerate().filter(|(_, owner)| **owner > 0) {
            let (x, y) = (pixel as u32 % frame.width, pixel as u32 / frame.width);
            let known = &mut boxes[usize::from(*owner) - 1];
            *known = (known.0.min(x), known.1.min(y), known.2.max(x), known.3.max(y), known.4 + 1);
        }
        let number_placed = placed.len();
        // 1 + index into the visible instances for 1 + index into what was placed.
        let mut renumbered = vec![0_u16; number_placed + 1];
        for (index, (mut placed, (left, top, right, bottom, count))) in placed.into_iter().zip(boxes).enumerate() {
            if count > 0 {
                placed.instance.bbox = [left, top, right - left + 1, bottom - top + 1];
                placed.instance.visible_px = count;
                placed.instance.visible_fraction = (f64::from(count) / placed.area.max(1.0)).min(1.0);
                sample.instances.push(placed.instance);
                renumbered[index + 1] = sample.instances.len() as u16;
            }
        }
        if sample.instances.len() < number_placed {
            sample.owners.iter_mut().for_each(|owner| *owner = renumbered[usize::from(*owner)]);
        }
        sample
    }
}

/// An image of zeros in the buffer of another.
fn zeroed<P: Pixel>(image: ImageBuffer<P, Vec<P::Subpixel>>, size: (u32, u32)) -> ImageBuffer<P, Vec<P::Subpixel>> {
    let mut pixels = image.into_raw();
    pixels.clear();
    pixels.resize(size.0 as usize * size.1 as usize * usize::from(P::CHANNEL_COUNT), P::Subpixel::DEFAULT_MIN_VALUE);
    ImageBuffer::from_raw(size.0, size.1, pixels).expect("the buffer was made for this size")
}
