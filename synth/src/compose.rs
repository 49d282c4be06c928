use crate::augment::{ColourMap, Drawing, Frame, Layer, Placement, Rectangle, warp};
use crate::bit_row::{WORD, mark, mark_half_covered};
use crate::blend::{Blend, Blender};
use crate::config::{LabelRule, SynthConfig};
use crate::ownership::Ownership;
use crate::photos::Shot;
use crate::placer::{Candidate, PlaceFn};
use crate::prepared::Prepared;
use crate::sample_rng::SampleRng;
use crate::synthesizer::Sample;
use image::{ImageBuffer, RgbImage};
use std::collections::BTreeSet;

/// An object or distractor as it ended up in a sample.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Instance {
    /// Class in the label map; 0 for a distractor.
    pub class: u8,
    /// Index of the crop among the object crops, or among the distractors when `class` is 0, or of the photo among the
    /// labelled photos when it is not `pasted`.
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
    /// Whether it was put into the picture; the others are what a [labelled photo](crate::LabelledPhoto) shows.
    pub pasted: bool,
}

/// Buffers of one thread; nothing in them outlives a sample.
#[derive(Default)]
pub(crate) struct Workspace {
    layer: Layer,
    before: Vec<u8>,
    /// Pixels by the geometry of the objects, and by the rule for labels where that is another.
    geometric: Ownership,
    changed: Ownership,
    /// Buffer of `geometric` where the sample's own is used for `changed`.
    spare: Vec<u16>,
    /// Which pixels of a row belong to the object at hand.
    belongs: Vec<u64>,
    placed: Vec<Placed>,
    /// What placers see of a sample that exists with several blends.
    empty: Option<RgbImage>,
}

/// How an object looks, besides where it is.
struct Look {
    colour: ColourMap,
    /// Standard deviation in output pixels.
    blur: f64,
    blend: Blend,
}

/// A picture while objects are put into it, each over the ones before.
///
/// Where an object goes depends on the geometry of those before, not on their blends or labels: the samples of one
/// layout agree in all of it.
pub(crate) struct Composition<'a> {
    config: &'a SynthConfig,
    frame: Frame,
    sample: Sample,
    placer: Option<&'a PlaceFn>,
    /// Pixels beyond an object's outline that some blend in use reads or writes.
    reach: usize,
    workspace: &'a mut Workspace,
}

struct Placed {
    instance: Instance,
    /// Area of the whole object in sample pixels.
    area: f64,
}

impl<'a> Composition<'a> {
    /// Begins on the background that `sample.image` shows; the rest of `sample` is only buffers.
    pub(crate) fn new(
        config: &'a SynthConfig,
        frame: Frame,
        placer: Option<&'a PlaceFn>,
        mut sample: Sample,
        workspace: &'a mut Workspace,
    ) -> Self {
        let size = sample.image.dimensions();
        let owners = std::mem::take(&mut sample.owners).into_raw();
        let spare = std::mem::take(&mut workspace.spare);
        if config.label_rule == LabelRule::Geometric {
            workspace.geometric.cleared(owners, size);
            workspace.spare = spare;
        } else {
            workspace.geometric.cleared(spare, size);
            workspace.changed.cleared(owners, size);
        }
        workspace.placed.clear();
        workspace.empty = (config.paired_blends && placer.is_some()).then(|| sample.image.clone());
        sample.instances.clear();
        let reaches = config.blend_weights.used().into_iter().map(Blender::reach);
        Self { config, frame, sample, placer, reach: reaches.max().unwrap_or(0), workspace }
    }

    /// Takes over the objects that a photo shows; the sample's picture is that of `shot`.
    pub(crate) fn show(&mut self, shot: &Shot, area_of: impl Fn(u8) -> f64) {
        let (width, height) = self.sample.image.dimensions();
        let whole = Rectangle { left: 0, top: 0, width: width as usize, height: height as usize };
        let labels = shot.label.as_raw();
        let classes: BTreeSet<u8> = labels.iter().copied().filter(|class| *class > 0).collect();
        let Workspace { geometric, changed, placed, belongs, .. } = &mut *self.workspace;
        let by_changes = self.config.label_rule != LabelRule::Geometric;
        for class in classes {
            let owned = if by_changes { vec![&mut *geometric, &mut *changed] } else { vec![&mut *geometric] };
            mark(labels.iter().map(|label| *label == class), belongs);
            for owned in owned {
                owned.add(whole);
                owned.claim(0, belongs);
            }
            let instance = Instance {
                class,
                crop: shot.photo,
                bbox: [0; 4],
                visible_px: 0,
                visible_fraction: 0.0,
                blend: Blend::None,
                scale: shot.area_scale.sqrt(),
                rotation_deg: 0.0,
                tilt_deg: 0.0,
                flipped: shot.flipped,
                pasted: false,
            };
            placed.push(Placed { instance, area: area_of(class) });
        }
    }

    /// Puts an object at a random place within the limits of truncation and occlusion; after
    /// [`attempts`](SynthConfig::attempts) failures it is left out.
    pub(crate) fn place(
        &mut self,
        (index, crop): (usize, &Prepared),
        blend: Blend,
        rng: &mut SampleRng,
        blender: &mut Blender,
    ) {
        let look = self.draw_look(blend, rng);
        for attempt in 0..self.config.attempts {
            let mut placement = self.draw_turn(rng);
            self.draw_centre(&mut placement, index, crop, attempt, rng);
            let area = crop.area(placement, &self.frame);
            if !self.warp_within_limits(crop, placement, area, &look) {
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
                pasted: true,
            };
            self.put(Placed { instance, area }, blender);
            return;
        }
    }

    fn draw_look(&self, blend: Blend, rng: &mut SampleRng) -> Look {
        let config = self.config;
        let colour = ColourMap::drawn(config, rng).unwrap_or(ColourMap::IDENTITY);
        Look { colour, blur: rng.uniform(config.blur_px), blend }
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
        let picture = self.workspace.empty.as_ref().unwrap_or(&self.sample.image);
        let candidate = Candidate { class: crop.class, crop: index, extent, picture, attempt };
        let mut random = || rng.unit();
        placement.centre = match self.placer {
            Some(place) => place(&candidate, &mut random),
            None => candidate.random_centre(self.config.truncation, &mut random),
        };
    }

    /// Warps the crop into the workspace's layer; false if too little of it, or of the objects below, stays visible.
    fn warp_within_limits(&mut self, crop: &Prepared, placement: Placement, area: f64, look: &Look) -> bool {
        // Rounding of the outline must not fail an object that lies wholly inside.
        const ROUNDING: f64 = 0.05;
        let reach = self.reach + (2.0 * look.blur).ceil() as usize;
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
            // A cloned object that fills the whole picture is pasted.
            object: Blender::needs_object(look.blend) || rectangle.area() == self.sample.image.as_raw().len() / 3,
        };
        let Workspace { layer, geometric, .. } = &mut *self.workspace;
        warp(&drawing, rectangle, layer);
        let inside = layer.object_area() as f64;
        let enough = (1.0 - self.config.truncation - ROUNDING).max(0.0) * area;
        inside >= enough.max(1.0) && geometric.stay_visible(layer, self.config.max_occlusion)
    }

    fn put(&mut self, placed: Placed, blender: &mut Blender) {
        let Workspace { layer, before, geometric, changed, placed: all, belongs, .. } = &mut *self.workspace;
        let image = &mut self.sample.image;
        let blend = placed.instance.blend;
        all.push(placed);
        geometric.add(layer.rectangle);
        belongs.resize(layer.rectangle.width.div_ceil(WORD), 0);
        for (row, photo) in layer.photo.chunks_exact(layer.rectangle.width).enumerate() {
            mark_half_covered(photo, belongs);
            geometric.claim(geometric.pixels(&layer.rectangle, row).start, belongs);
        }
        let LabelRule::Changed { tolerance } = self.config.label_rule else {
            return blender.blend_layer(image, layer, blend);
        };
        before.clear();
        before.extend_from_slice(image.as_raw());
        blender.blend_layer(image, layer, blend);
        changed.add(layer.rectangle);
        let (after, before) = (image.as_raw().as_chunks::<3>().0, before.as_chunks::<3>().0);
        for row in 0..layer.rectangle.height {
            let pixels = changed.pixels(&layer.rectangle, row);
            let colours = after[pixels.clone()].iter().zip(&before[pixels.clone()]);
            let differs = colours.map(|(after, before)| {
                after.iter().zip(before).any(|(after, before)| after.abs_diff(*before) > tolerance)
            });
            mark(differs, belongs);
            changed.claim(pixels.start, belongs);
        }
    }

    /// The sample, with the instances of which something is visible, and whether any object, visible or not, was drawn
    /// to be blurred by motion.
    pub(crate) fn finish(self) -> (Sample, bool) {
        const FITS: &str = "buffers of this size were made";
        let Self { mut sample, config, workspace, .. } = self;
        let Workspace { geometric, changed, placed, spare, .. } = workspace;
        let moving = placed.iter().any(|placed| placed.instance.blend == Blend::Motion);
        let labelled = if config.label_rule == LabelRule::Geometric {
            geometric
        } else {
            *spare = std::mem::take(&mut geometric.owners);
            changed
        };
        let mut labels = std::mem::take(&mut sample.label).into_raw();
        labels.clear();
        labels.resize(labelled.owners.len(), 0);
        for (index, placed) in placed.drain(..).enumerate() {
            let visible_px = labelled.objects[index].visible_px;
            if visible_px > 0 {
                let bbox = labelled.bounding_box(index);
                let visible_fraction = (f64::from(visible_px) / placed.area.max(1.0)).min(1.0);
                labelled.write_class(index, placed.instance.class, &mut labels);
                sample.instances.push(Instance { bbox, visible_px, visible_fraction, ..placed.instance });
            }
        }
        labelled.renumber();
        let (width, height) = sample.image.dimensions();
        let owners = std::mem::take(&mut labelled.owners);
        sample.label = ImageBuffer::from_raw(width, height, labels).expect(FITS);
        sample.owners = ImageBuffer::from_raw(width, height, owners).expect(FITS);
        (sample, moving)
    }
}
