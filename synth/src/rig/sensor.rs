//! The depth camera: noise, steps, flying pixels, holes, and its small disagreement with the colour camera.

use image::{Luma, RgbImage};
use nalgebra::Point3;
use rand::Rng;

use super::DepthImage;
use super::lattice_noise::value_noise;
use super::noise_source::NoiseSource;
use super::photo::PhotoModel;
use super::shading::Rendering;

/// How a depth camera measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum DepthModel {
    /// Exact.
    Ideal,
    /// Microsoft Kinect of 2010, structured light: axial and lateral noise after Nguyen, Izadi and Lovell 2012
    /// (3DIMPVT), steps of 1/8 pixel of disparity over a baseline of 75 mm, 0.5 to 4.5 m.
    #[default]
    KinectV1,
    /// Stereo of the RealSense D400 family: noise z^2 * 0.08 px / (f * 50 mm), steps of 1/32 pixel of disparity,
    /// 0.3 to 6 m.
    StereoD400,
}

/// A colour and a depth camera in one housing.
///
/// Depth comes in the pixels of the colour camera, as a driver registers it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct Sensor {
    /// The depth camera.
    pub depth: DepthModel,
    /// The colour camera.
    pub photo: PhotoModel,
    /// Factor on the axial and lateral noise of the depth camera; 1 is the published model.
    pub noise: f32,
    /// Error of the registration of depth to colour: the depth camera is this much further right and down than the
    /// driver believes, metres. Depth edges then lie beside colour edges by focal length times this over z.
    pub registration_error: [f32; 2],
    /// Probability that a pixel at a depth jump reports a place between near and far surface.
    pub flying_share: f32,
    /// Slow error over the image, constant in time, share of z.
    pub distortion: f32,
}

impl Sensor {
    /// Exact depth and a clean picture.
    pub const IDEAL: Self = Self {
        depth: DepthModel::Ideal,
        photo: PhotoModel::IDEAL,
        noise: 0.0,
        registration_error: [0.0; 2],
        flying_share: 0.0,
        distortion: 0.0,
    };

    /// Microsoft Kinect of 2010.
    pub fn kinect_v1() -> Self {
        Self {
            depth: DepthModel::KinectV1,
            photo: PhotoModel::default(),
            noise: 1.0,
            registration_error: [0.002, 0.001],
            flying_share: 0.25,
            distortion: 0.0005,
        }
    }

    /// RealSense D400 family.
    pub fn stereo_d400() -> Self {
        let kinect = Self::kinect_v1();
        Self { depth: DepthModel::StereoD400, registration_error: [0.001, 0.0], flying_share: 0.5, ..kinect }
    }

    /// Millimetres per unit of a stored 16-bit depth image: 1 but for the ideal camera, which needs 0.1.
    pub fn depth_scale(&self) -> f64 {
        if self.depth == DepthModel::Ideal { 0.1 } else { 1.0 }
    }

    /// The colour and the depth image that this camera delivers of `rendering`; depth in metres, 0 = no reading.
    pub fn observe(&self, rendering: &Rendering, rng: &mut impl Rng) -> (RgbImage, DepthImage) {
        let picture = self.photo.develop(&rendering.color, rng);
        (picture, self.measure(rendering, rng))
    }

    fn measure(&self, rendering: &Rendering, rng: &mut impl Rng) -> DepthImage {
        let Some(optics) = self.depth.optics(rendering.camera.fx as f32) else {
            return rendering.depth.clone();
        };
        let (width, height) = rendering.depth.dimensions();
        let mut measured = DepthImage::new(width, height);
        let mut noise = NoiseSource(rng);
        for v in 0..height {
            let shadow = optics.shadowed_row(rendering, v);
            for u in 0..width {
                if !shadow[u as usize] {
                    let z = self.reading(rendering, &optics, u, v, &mut noise);
                    measured.put_pixel(u, v, Luma([z]));
                }
            }
        }
        measured
    }

    /// Depth at a pixel, metres, 0 if it fails.
    fn reading(
        &self,
        rendering: &Rendering,
        optics: &Optics,
        u: u32,
        v: u32,
        noise: &mut NoiseSource<impl Rng>,
    ) -> f32 {
        let nominal = rendering.depth.get_pixel(u, v).0[0];
        if nominal <= 0.0 {
            return 0.0;
        }
        let theta = rendering.incidence.get_pixel(u, v).0[0].clamp(0.0, 1.0).acos();
        let lateral = self.noise * optics.lateral_sigma(theta);
        let shift = self.registration_error.map(|error| optics.focal * error / nominal);
        let at = [u as f32 + shift[0] + lateral * noise.normal(), v as f32 + shift[1] + lateral * noise.normal()];
        let true_depth = self.depth_near(rendering, at, noise);
        if !optics.range.contains(&true_depth) || noise.even() < failure_share(theta) {
            return 0.0;
        }
        let slow = value_noise(&Point3::new(u as f32 / 90.0, v as f32 / 90.0, 0.5), 77);
        let axial = self.noise * optics.axial_sigma(true_depth, theta);
        optics.stepped(true_depth * (1.0 + self.distortion * slow) + axial * noise.normal())
    }

    /// True depth at a pixel position, or a mixture where the neighbours lie on two surfaces.
    fn depth_near(&self, rendering: &Rendering, [u, v]: [f32; 2], noise: &mut NoiseSource<impl Rng>) -> f32 {
        let (width, height) = rendering.depth.dimensions();
        let (u, v) = ((u + 0.5).max(0.0) as u32, (v + 0.5).max(0.0) as u32);
        let (u, v) = (u.min(width - 1), v.min(height - 1));
        let depth = |u: u32, v: u32| rendering.depth.get_pixel(u, v).0[0];
        let here = depth(u, v);
        let neighbours =
            [depth(u.saturating_sub(1), v), depth((u + 1).min(width - 1), v), depth(u, (v + 1).min(height - 1))];
        let other = neighbours.into_iter().max_by(|a, b| (a - here).abs().total_cmp(&(b - here).abs()));
        match other {
            Some(other) if (other - here).abs() > JUMP * here && other > 0.0 => {
                let flies = noise.even() < self.flying_share;
                if flies { here + (other - here) * noise.even() } else { here }
            }
            _ => here,
        }
    }
}

impl Default for Sensor {
    fn default() -> Self {
        Self::kinect_v1()
    }
}

/// Relative step between neighbours that counts as a jump from one surface to another.
const JUMP: f32 = 0.03;

/// Probability that a surface at an angle of `theta` between ray and normal sends too little light back.
fn failure_share(theta: f32) -> f32 {
    let [safe, lost] = [70f32.to_radians(), 88f32.to_radians()];
    0.001 + ((theta - safe) / (lost - safe)).clamp(0.0, 1.0).powi(2)
}

/// The measuring principle: triangulation over a baseline.
struct Optics {
    focal: f32,
    baseline: f32,
    /// Smallest step of disparity, pixels.
    disparity_step: f32,
    range: std::ops::Range<f32>,
    model: DepthModel,
}

impl DepthModel {
    fn optics(self, focal: f32) -> Option<Optics> {
        let optics =
            |baseline, disparity_step, range| Some(Optics { focal, baseline, disparity_step, range, model: self });
        match self {
            Self::Ideal => None,
            Self::KinectV1 => optics(0.075, 1.0 / 8.0, 0.5..4.5),
            Self::StereoD400 => optics(0.05, 1.0 / 32.0, 0.3..6.0),
        }
    }
}

impl Optics {
    /// Standard deviation along the ray, metres, at depth `z` and angle `theta` between ray and normal.
    fn axial_sigma(&self, z: f32, theta: f32) -> f32 {
        if self.model == DepthModel::StereoD400 {
            const SUBPIXEL: f32 = 0.08;
            return z * z * SUBPIXEL / (self.focal * self.baseline);
        }
        // Nguyen et al. 2012, equations 4 and 5.
        let frontal = 0.0012 + 0.0019 * (z - 0.4).powi(2);
        let beyond = std::f32::consts::FRAC_PI_2 - theta.min(1.54);
        let slanted = if theta > 60f32.to_radians() { 0.0001 / z.sqrt() * (theta / beyond).powi(2) } else { 0.0 };
        frontal + slanted
    }

    /// Standard deviation across the ray, pixels.
    fn lateral_sigma(&self, theta: f32) -> f32 {
        if self.model == DepthModel::StereoD400 {
            return 0.5;
        }
        // Nguyen et al. 2012, equation 3; beyond 80 deg the formula has no measurements behind it.
        let theta = theta.min(80f32.to_radians());
        0.8 + 0.035 * theta / (std::f32::consts::FRAC_PI_2 - theta)
    }

    /// Depth after rounding its disparity to whole steps, metres.
    fn stepped(&self, z: f32) -> f32 {
        let steps_metres = self.focal * self.baseline / self.disparity_step;
        let steps = (steps_metres / z.max(0.01)).round();
        if steps >= 1.0 { steps_metres / steps } else { 0.0 }
    }

    /// Which pixels of a row the second eye, a baseline to the right, cannot see because something nearer hides them.
    fn shadowed_row(&self, rendering: &Rendering, v: u32) -> Vec<bool> {
        let width = rendering.depth.width();
        let depth = |u: u32| rendering.depth.get_pixel(u, v).0[0];
        let disparity = |z: f32| self.focal * self.baseline / z;
        let most = disparity(self.range.start).ceil() as i32;
        let column = |u: u32, z: f32| ((u as f32 - disparity(z)).round() as i32 + most).max(0) as usize;
        let mut nearest = vec![f32::INFINITY; (width as i32 + most + 1) as usize];
        let seen = (0..width).filter(|&u| depth(u) > 0.0);
        for u in seen {
            let slot = &mut nearest[column(u, depth(u))];
            *slot = slot.min(depth(u));
        }
        let hidden = |u: u32| depth(u) > 0.0 && nearest[column(u, depth(u))] < depth(u) * (1.0 - JUMP);
        (0..width).map(hidden).collect()
    }
}
