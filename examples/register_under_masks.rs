//! How well poses come out when the mask is known: every frame of the office cabinet, cropped by its true mask and
//! registered from the visible centroid with its yaw unknown. Needs nothing but `cloudcrop`, `icp` and a BOP reader.
//!
//! `cargo run --release -p examples --example register_under_masks` prints a line per missed frame and the share of
//! frames within 20 mm and 5 degrees. The frames are looked for in `../shared/data`, or where `POSEPIPE_DATA` says.

#![allow(clippy::print_stdout, reason = "examples talk")]

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use cloudcrop::{CropConfig, OrganizedCloud, PlaneConfig, crop_to_object, fit_plane, io::read_ply};
use icp::{DepthView, HypothesisConfig, IcpConfig, Pinhole, Sight, SightModel, Symmetry, Target, hypotheses};
use image::GrayImage;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use posepipe::bop::{BopScene, Frame};

/// Diagonal of the cabinet in metres.
const DIAMETER: f32 = 1.06;
const TURNS: usize = 24;

/// The model in all the forms that a search needs.
struct Cabinet {
    target: Target,
    sight: SightModel,
    /// Few points, for finding out what is visible.
    thin: Vec<Point3<f32>>,
    symmetry: Symmetry,
}

impl Cabinet {
    fn load(path: &Path) -> Result<Self> {
        let millimetres = read_ply(path)?.points;
        let model: Vec<Point3<f32>> = millimetres.iter().map(|point| Point3::from(point.coords * 1e-3)).collect();
        let thin: Vec<Point3<f32>> = model.iter().step_by(50).copied().collect();
        Ok(Self {
            target: Target::new(&model, &IcpConfig::default())?,
            sight: SightModel::new(&thin, None)?,
            thin,
            symmetry: Symmetry::Cyclic { axis: Vector3::z_axis(), point: Point3::origin(), fold: 2 },
        })
    }

    /// The best pose, `camera_from_object`.
    fn register(&self, frame: &Frame, mask: &GrayImage) -> Result<Isometry3<f64>> {
        let cloud = OrganizedCloud::from_depth(&frame.depth, &frame.camera)?;
        let crop = crop_to_object(&cloud, mask, &CropConfig::for_diameter(DIAMETER))?.points;
        let centroid = icp::centroid(&crop).context("the crop is empty")?;
        let upright = upright(&cloud, mask, &centroid)?;
        let guesses = hypotheses::yaw_about(&Vector3::z_axis(), &Point3::origin(), TURNS)
            .iter()
            .map(|yaw| hypotheses::at_visible_centroid(&self.thin, &centroid, &(yaw.rotation * upright)))
            .collect::<icp::Result<Vec<_>>>()?;
        let camera = &frame.camera;
        let pinhole = Pinhole {
            width: camera.width,
            height: camera.height,
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
        };
        let view = DepthView::new(frame.depth.as_raw(), &pinhole)?;
        let sight = Sight { view: &view, model: &self.sight, tolerance: 0.03 };
        let search = HypothesisConfig { symmetry: self.symmetry.clone(), ..HypothesisConfig::default() };
        let found = self.target.align_in_view(&self.target.prepare(&crop)?, &guesses, &search, &sight)?;
        let best = found.first().context("no start led to a pose")?;
        Ok(best.alignment.target_from_source.inverse())
    }
}

/// The turn that stands the object on the floor around it, object from camera; the yaw is left open.
fn upright(cloud: &OrganizedCloud, mask: &GrayImage, centroid: &Point3<f64>) -> Result<UnitQuaternion<f64>> {
    let near = |point: &Point3<f32>| (point.cast::<f64>() - centroid).norm() < 1.5;
    let around = cloud.points().iter().zip(mask.as_raw()).filter(|(point, inside)| **inside == 0 && near(point));
    let around: Vec<Point3<f32>> = around.map(|(point, _)| *point).collect();
    let search = PlaneConfig { distance: 0.012, iterations: 300, seed: 0, min_inliers: 300 };
    let up = fit_plane(&around, &search)?.plane.facing_origin().normal;
    UnitQuaternion::rotation_between_axis(&up, &Vector3::z_axis()).context("the camera stands on its head")
}

fn main() -> Result<()> {
    let data = std::env::var_os("POSEPIPE_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    let folder = data.join("rgbd/tum_fr3_cabinet");
    if !folder.is_dir() {
        println!("skipped: {} is no folder; set POSEPIPE_DATA", folder.display());
        return Ok(());
    }
    let cabinet = Cabinet::load(&folder.join("models/obj_000001.ply"))?;
    let scene = BopScene::open(&folder.join("test/000001"))?;
    let (mut good, mut shifts) = (0, Vec::new());
    for info in scene.frames() {
        let frame = scene.load(info.image)?;
        let mask = scene.mask_visib(info.image, 0)?.context("a frame without mask")?;
        let truth = frame.ground_truth.first().context("a frame without pose")?.camera_from_object;
        let found = cabinet.register(&frame, &mask)?;
        let (turn, shift) = cabinet.symmetry.fold_error(&found.inverse(), &truth.inverse());
        if turn < 5_f64.to_radians() && shift < 0.02 {
            good += 1;
        } else {
            println!("frame {}: off by {:.1} degrees, {:.0} mm", info.image, turn.to_degrees(), shift * 1e3);
        }
        shifts.push(shift);
    }
    shifts.sort_by(f64::total_cmp);
    let count = shifts.len();
    let share = 100.0 * f64::from(good) / count as f64;
    println!(
        "{good} of {count} frames ({share:.1} %) within 20 mm and 5 degrees, median {:.1} mm",
        shifts[count / 2] * 1e3
    );
    Ok(())
}
