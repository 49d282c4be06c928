use crate::augment::{ColourMap, Drawing, Frame, HALF, Layer, Placement, Pyramid, Rectangle, warp};
use crate::blend::{Blend, Blender};
use crate::config::{LabelRule, SynthConfig};
use crate::crop::Crop;
use crate::error::{Error, Result};
use crate::placer::{Candidate, PlaceFn};
use crate::sample_rng::SampleRng;
use crate::synthesizer::Sample;
use image::{ImageBuffer, Pixel, Primitive as _};
use std::ops::Range;

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
    /// Turn out of the image plane, in degrees.
    pub tilt_deg: f64,
    /// Whether it was mirrored left to right.
    pub flipped: bool,
}

/// A crop made ready for warping.
#[derive(Clone, Debug)]
pub(crate) struct Prepared {
    class: u8,
    pyramid: Pyramid,
    /// Middle of the object's bounding box, in crop pixels, its size, and its corners (left, top, right, bottom).
    middle: [f64; 2],
    size: [f64; 2],
    bounds: [f64; 4],
    /// Pixels that are at least half covered.
    area: f64,
}

impl Prepared {
    pub(crate) fn new(crop: &Crop, class: u8) -> Result<Self> {
        let bounds = crop.object_bounds().ok_or_else(|| Error::EmptyMask { name: crop.name.clone() })?;
        let (left, top, right, bottom) = bounds;
        let area = crop.image.pixels().filter(|pixel| pixel[3] >= HALF).count();
        if area == 0 {
            return Err(Error::EmptyMask { name: crop.name.clone() });
        }
        Ok(Self {
            class,
            pyramid: Pyramid::new(&crop.image),
            middle: [0.5 * f64::from(left + right), 0.5 * f64::from(top + bottom)],
            size: [f64::from(right - left + 1), f64::from(bottom - top + 1)],
            bounds: [left, top, right, bottom].map(f64::from),
            area: area as f64,
        })
    }

    pub(crate) fn class(&self) -> u8 {
        self.class
    }

    /// Length of the diagonal of the object's box, in camera pixels.
    pub(crate) fn diagonal(&self) -> f64 {
        self.size[0].hypot(self.size[1])
    }
}

/// Buffers of one thread; nothing in them outlives a sample.
#[derive(Default)]
pub(crate) struct Workspace {
    layer: Layer,
    before: Vec<u8>,
}

/// How an object looks, besides where it is.
struct Look {
    colour: ColourMap,
    /// Standard deviation in output pixels.
    blur: f64,
}

/// A picture while objects are put into it, each over the ones before.
pub(crate) struct Composition<'a> {
    config: &'a SynthConfig,
    frame: Frame,
    /// Its owners are 1 + index into `placed` until the end; its instances wait in `placed`.
    sample: Sample,
    placed: Vec<Placed>,
    placer: Option<&'a PlaceFn>,
}

struct Placed {
    instance: Instance,
    /// Where its pixels lie.
    rectangle: Rectangle,
    /// Area of the whole object in sample pixels.
    area: f64,
    /// Labelled pixels when it was placed, and now.
    own_px: u32,
    visible_px: u32,
}

impl<'a> Composition<'a> {
    /// Begins on the background that `sample.image` shows; the rest of `sample` is only buffers.
    pub(crate) fn new(config: &'a SynthConfig, frame: Frame, placer: Option<&'a PlaceFn>, mut sample: Sample) -> Self {
        let size = sample.image.dimensions();
        sample.label = zeroed(sample.label, size);
        sample.owners = zeroed(sample.owners, size);
        sample.instances.clear();
        Self { config, frame, sample, placed: Vec::new(), placer }
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
        let look = self.draw_look(rng);
        for attempt in 0..self.config.attempts {
            let mut placement = self.draw_turn(rng);
            self.draw_centre(&mut placement, index, crop, attempt, rng);
            let area = crop.area * placement.scale.powi(2) * placement.tilt.cos()
                / self.frame.camera_per_output.iter().product::<f64>();
            if !self.warp_within_limits(crop, placement, area, &look, blend, workspace) {
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
                tilt_deg: placement.tilt.to_degrees(),
                flipped: placement.flip,
            };
            self.put(instance, area, blender, workspace);
            return;
        }
    }

    fn draw_look(&self, rng: &mut SampleRng) -> Look {
        let config = self.config;
        let [brightness, contrast, hue, blur] =
            [config.brightness, config.contrast, config.hue_deg, config.blur_px].map(|range| rng.uniform(range));
        let same = brightness == 0.0 && contrast == 0.0 && hue == 0.0;
        let colour = if same { ColourMap::IDENTITY } else { ColourMap::new(brightness, contrast, hue) };
        Look { colour, blur }
    }

    /// Everything about a placement but where it is.
    fn draw_turn(&self, rng: &mut SampleRng) -> Placement {
        let config = self.config;
        Placement {
            scale: rng.uniform(config.scale),
            rotation: rng.uniform(config.rotation_deg).to_radians(),
            flip: config.flip && rng.chance(0.5),
            tilt: rng.uniform(config.tilt_deg).to_radians(),
            tilt_axis: rng.uniform((0.0, std::f64::consts::TAU)),
            centre: [0.0; 2],
        }
    }

    /// Shrinks an object larger than the sample to fit and draws its place.
    fn draw_centre(&self, placement: &mut Placement, index: usize, crop: &Prepared, attempt: u32, rng: &mut SampleRng) {
        let output = [f64::from(self.frame.width), f64::from(self.frame.height)];
        let extent = placement.extent(crop.size, &self.frame);
        let sides = [0, 1].map(|axis| extent[axis] + extent[axis + 2]);
        let fit = (output[0] / sides[0]).min(output[1] / sides[1]).min(1.0);
        placement.scale *= fit;
        let extent = extent.map(|value| fit * value);
        let picture = &self.sample.image;
        let candidate = Candidate { class: crop.class, crop: index, extent, picture, attempt };
        let mut random = || rng.unit();
        placement.centre = match self.placer {
            Some(place) => place(&candidate, &mut random),
            None => candidate.random_centre(self.config.truncation, &mut random),
        };
    }

    /// Warps the crop into the workspace's layer; false if too little of it, or of the objects below, stays visible.
    fn warp_within_limits(
        &self,
        crop: &Prepared,
        placement: Placement,
        area: f64,
        look: &Look,
        blend: Blend,
        workspace: &mut Workspace,
    ) -> bool {
        // Rounding of the outline must not fail an object that lies wholly inside.
        const ROUNDING: f64 = 0.05;
        let reach = Blender::reach(blend) + (2.0 * look.blur).ceil() as usize;
        let Some(rectangle) = placement.rectangle(crop.size, reach, &self.frame) else {
            return false;
        };
        let drawing = Drawing {
            crop: &crop.pyramid,
            from_crop: placement.to_output(crop.middle, &self.frame),
            bounds: crop.bounds,
            reach,
            blur: look.blur,
            colour: look.colour,
        };
        warp(&drawing, rectangle, &mut workspace.layer);
        let inside = workspace.layer.object_area() as f64;
        let enough = (1.0 - self.config.truncation - ROUNDING).max(0.0) * area;
        inside >= enough.max(1.0) && self.leaves_others_visible(&workspace.layer)
    }

    fn leaves_others_visible(&self, layer: &Layer) -> bool {
        if self.config.max_occlusion >= 1.0 || self.placed.is_empty() {
            return true;
        }
        let mut hidden = vec![0_u32; self.placed.len() + 1];
        for (row, photo) in layer.photo.chunks_exact(layer.rectangle.width).enumerate() {
            let owners = &self.sample.owners.as_raw()[self.pixels(layer, row)];
            for (_, owner) in photo.iter().zip(owners).filter(|(pixel, _)| pixel[3] >= HALF) {
                hidden[usize::from(*owner)] += 1;
            }
        }
        let stays = 1.0 - self.config.max_occlusion;
        let enough = |(placed, &hidden): (&Placed, &u32)| {
            f64::from(placed.visible_px - hidden) >= stays * f64::from(placed.own_px)
        };
        self.placed.iter().zip(&hidden[1..]).all(enough)
    }

    /// Pixels of the sample that row `row` of the layer covers.
    fn pixels(&self, layer: &Layer, row: usize) -> Range<usize> {
        let start = (layer.rectangle.top + row) * self.frame.width as usize + layer.rectangle.left;
        start..start + layer.rectangle.width
    }

    fn put(&mut self, instance: Instance, area: f64, blender: &mut Blender, workspace: &mut Workspace) {
        let (layer, before) = (&workspace.layer, &mut workspace.before);
        if matches!(self.config.label_rule, LabelRule::Changed { .. }) {
            before.clear();
            before.extend_from_slice(self.sample.image.as_raw());
        }
        blender.blend_layer(&mut self.sample.image, layer, instance.blend);
        let (class, owner) = (instance.class, self.placed.len() as u16 + 1);
        let rectangle = layer.rectangle;
        self.placed.push(Placed { instance, rectangle, area, own_px: 0, visible_px: 0 });
        for row in 0..rectangle.height {
            let pixels = self.pixels(layer, row);
            match self.config.label_rule {
                LabelRule::Geometric => {
                    let photo = &layer.photo[row * rectangle.width..][..rectangle.width];
                    self.own(pixels, class, owner, |at| photo[at][3] >= HALF);
                }
                LabelRule::Changed { tolerance } => {
                    let bytes = 3 * pixels.start..3 * pixels.end;
                    let (after, before) = (self.sample.image.as_raw()[bytes.clone()].to_vec(), &before[bytes]);
                    let changed = |at: &usize| after[*at].abs_diff(before[*at]) > tolerance;
                    self.own(pixels, class, owner, |at| (3 * at..3 * at + 3).any(|at| changed(&at)));
                }
            }
        }
    }

    /// Gives those of some pixels that belong to the last placed object to it.
    fn own(&mut self, pixels: Range<usize>, class: u8, owner: u16, belongs: impl Fn(usize) -> bool) {
        let owners = &mut self.sample.owners.as_mut()[pixels.clone()];
        let labels = &mut self.sample.label.as_mut()[pixels];
        let mut count = 0;
        for (at, (known, label)) in owners.iter_mut().zip(labels).enumerate() {
            if belongs(at) {
                if let Some(hidden) = usize::from(*known).checked_sub(1) {
                    self.placed[hidden].visible_px -= 1;
                }
                (*known, *label) = (owner, class);
                count += 1;
            }
        }
        let placed = &mut self.placed[usize::from(owner) - 1];
        placed.own_px += count;
        placed.visible_px += count;
    }

    /// The sample, with the instances of which something is visible.
    pub(crate) fn finish(self) -> Sample {
        let Self { mut sample, placed, frame, .. } = self;
        // 1 + index into the visible instances for 1 + index into what was placed.
        let mut renumbered = vec![0_u16; placed.len() + 1];
        for (index, placed) in placed.into_iter().enumerate() {
            if placed.visible_px > 0 {
                let bbox = bounding_box(&sample.owners, frame.width as usize, &placed.rectangle, index as u16 + 1);
                let visible_px = placed.visible_px;
                let visible_fraction = (f64::from(visible_px) / placed.area.max(1.0)).min(1.0);
                sample.instances.push(Instance { bbox, visible_px, visible_fraction, ..placed.instance });
                renumbered[index + 1] = sample.instances.len() as u16;
            }
        }
        if sample.instances.len() + 1 < renumbered.len() {
            sample.owners.iter_mut().for_each(|owner| *owner = renumbered[usize::from(*owner)]);
        }
        sample
    }
}

/// Left, top, width and height of the pixels of `owner`, all of which lie in `rectangle`.
fn bounding_box(owners: &[u16], width: usize, rectangle: &Rectangle, owner: u16) -> [u32; 4] {
    let (mut left, mut top, mut right, mut bottom) = (usize::MAX, usize::MAX, 0, 0);
    for y in rectangle.top..rectangle.top + rectangle.height {
        let row = &owners[y * width + rectangle.left..][..rectangle.width];
        if let Some(first) = row.iter().position(|&other| other == owner) {
            let last = row.iter().rposition(|&other| other == owner).unwrap_or(first);
            (left, right) = (left.min(rectangle.left + first), right.max(rectangle.left + last));
            (top, bottom) = (top.min(y), y);
        }
    }
    [left, top, right - left + 1, bottom - top + 1].map(|value| value as u32)
}

/// An image of zeros in the buffer of another.
fn zeroed<P: Pixel>(image: ImageBuffer<P, Vec<P::Subpixel>>, size: (u32, u32)) -> ImageBuffer<P, Vec<P::Subpixel>> {
    let mut pixels = image.into_raw();
    pixels.clear();
    pixels.resize(size.0 as usize * size.1 as usize * usize::from(P::CHANNEL_COUNT), P::Subpixel::DEFAULT_MIN_VALUE);
    ImageBuffer::from_raw(size.0, size.1, pixels).expect("the buffer was made for this size")
}
