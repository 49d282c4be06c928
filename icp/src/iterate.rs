//! One stage after the other: match, step, repeat, and what can be said of the pose in the end.

use nalgebra::Isometry3;

use crate::alignment::{Alignment, Evidence, StopReason};
use crate::cloud::Source;
use crate::config::Metric;
use crate::motion::{Motion, closest_motion, gauss_newton};
use crate::nearest::PacketSearch;
use crate::pairs::{Hints, PairSum, Reach, no_hints, sum_pairs};
use crate::residual::{FLATNESS, PointSum, PointTotal, SpreadSum, Surface, SurfaceSum, Weighting};
use crate::target::Target;
use crate::{Error, Result};

/// The steps ahead are taken to add up to this many times the last one.
const STEPS_AHEAD: f64 = 2.0;
/// Looking this share of a voxel beyond each match costs no more than it saves.
const MOST_SLACK: f64 = 0.125;

/// How much beyond its match a point looks for others, after a step that moved it by `step` metres: far enough that
/// some of the next searches can be left out, and not at all where that would be too far.
fn slack_after(step: f64, leaf: f64) -> f64 {
    let slack = STEPS_AHEAD * step;
    if slack < MOST_SLACK * leaf { slack } else { 0.0 }
}

/// Where a stage ended, in local frames.
pub(crate) struct Reached {
    pub(crate) pose: Isometry3<f64>,
    pub(crate) iterations: u32,
    stop: StopReason,
    hints: Hints,
}

impl Target {
    /// Runs the stages from `first` on, starting at a local pose that took `iterations` to reach.
    pub(crate) fn finish(
        &self,
        source: &Source,
        local: &Isometry3<f64>,
        first: usize,
        iterations: u32,
    ) -> Result<Alignment> {
        let mut reached = self.run_stage(source, local, first)?;
        reached.iterations += iterations;
        for index in first + 1..self.stages().len() {
            let before = reached.iterations;
            reached = self.run_stage(source, &reached.pose, index)?;
            reached.iterations += before;
        }
        self.report(source, &mut reached)
    }

    /// Iterates one stage until it stands still.
    pub(crate) fn run_stage(&self, source: &Source, start: &Isometry3<f64>, index: usize) -> Result<Reached> {
        let (target, _, _) = self.at(source, index);
        match target.lookup() {
            Some(lookup) => self.run_metric(&lookup, source, start, index),
            None => self.run_metric(target.tree(), source, start, index),
        }
    }

    fn run_metric<S: PacketSearch>(
        &self,
        search: &S,
        source: &Source,
        start: &Isometry3<f64>,
        index: usize,
    ) -> Result<Reached> {
        let (motion, radius) = (&self.config.motion, self.radius);
        let weighting = self.config.robust.at(self.stages()[index].distance);
        match self.config.metric.surface() {
            None => self.iterate(search, source, start, index, &PointSum { weighting }, |sums: &PointTotal| {
                let step = match motion {
                    Motion::Rigid => closest_motion(sums),
                    _ => gauss_newton(&sums.equations(), motion, radius),
                };
                (sums.count, step)
            }),
            Some(surface) => {
                let sum = SurfaceSum { surface, weighting };
                self.iterate(search, source, start, index, &sum, |sums| {
                    (sums.count, gauss_newton(sums, motion, radius))
                })
            }
        }
    }

    fn iterate<S: PacketSearch, K: PairSum>(
        &self,
        search: &S,
        source: &Source,
        start: &Isometry3<f64>,
        index: usize,
        sum: &K,
        step: impl Fn(&K::Total) -> (usize, Option<Isometry3<f64>>),
    ) -> Result<Reached> {
        let (target, points, stage) = self.at(source, index);
        let mut hints = no_hints(points);
        let mut pose = *start;
        let mut reach = Reach { distance: stage.distance, slack: 0.0 };
        for iteration in 1..=self.config.max_iterations {
            let sums = sum_pairs(search, target, points, &pose, reach, sum, &mut hints);
            // Without enough matches there is nothing to compute a step from.
            let (found, motion) = step(&sums);
            self.enough(source, index, found)?;
            let motion = motion.ok_or(Error::Degenerate { stage: index, correspondences: found })?;
            pose = motion * pose;
            pose.rotation.renormalize();
            let turned = motion.rotation.angle();
            let moved = motion.translation.vector.norm();
            reach.slack = slack_after(turned * self.radius + moved, stage.leaf);
            if turned < stage.rotation_epsilon && moved < stage.translation_epsilon {
                return Ok(Reached { pose, iterations: iteration, stop: StopReason::Converged, hints });
            }
        }
        Ok(Reached { pose, iterations: self.config.max_iterations, stop: StopReason::MaxIterations, hints })
    }

    /// Distances of the source's points from the model at a local pose and a stage.
    pub(crate) fn distances_at(&self, source: &Source, local: &Isometry3<f64>, index: usize) -> PointTotal {
        self.sum_at(
            source,
            local,
            index,
            &PointSum { weighting: Weighting::Even },
            &mut no_hints(&source.levels[index]),
        )
    }

    fn sum_at<K: PairSum>(
        &self,
        source: &Source,
        local: &Isometry3<f64>,
        index: usize,
        sum: &K,
        hints: &mut Hints,
    ) -> K::Total {
        let (target, points, stage) = self.at(source, index);
        let reach = Reach { distance: stage.distance, slack: 0.0 };
        sum_pairs(target.tree(), target, points, local, reach, sum, hints)
    }

    /// What can be said of a pose (between the frames the clouds were given in) that was found otherwise.
    pub(crate) fn describe(
        &self,
        source: &Source,
        pose: &Isometry3<f64>,
        iterations: u32,
        stop: StopReason,
    ) -> Result<Alignment> {
        let hints = no_hints(&source.levels[self.stages().len() - 1]);
        let pose = self.to_local(source, pose);
        self.report(source, &mut Reached { pose, iterations, stop, hints })
    }

    /// Everything that is said of the pose is measured at the pose.
    fn report(&self, source: &Source, reached: &mut Reached) -> Result<Alignment> {
        let last = self.stages().len() - 1;
        let (pose, hints) = (reached.pose, &mut reached.hints);
        let weighting = self.config.robust.at(self.stages()[last].distance);
        let even = Weighting::Even;
        let points = self.sum_at(source, &pose, last, &PointSum { weighting: even }, hints);
        self.enough(source, last, points.count)?;
        // Without normals a pair pulls at its point.
        let surface = self.config.metric.surface().unwrap_or(Surface::Plane { point_share: 1.0 });
        let spread = self.sum_at(source, &pose, last, &SpreadSum { surface, weighting }, hints);
        let plane = SurfaceSum { surface: Surface::Plane { point_share: 0.0 }, weighting: even };
        let surfaces = self.sum_at(source, &pose, last, &plane, hints);
        let evidence = Evidence {
            points: &points,
            surfaces: &surfaces,
            spread: &spread,
            cost_scale: if self.config.metric == Metric::Gicp { 2.0 * f64::from(FLATNESS) } else { 1.0 },
        };
        Ok(evidence.report(self, source, &pose, reached.iterations, reached.stop))
    }
}
