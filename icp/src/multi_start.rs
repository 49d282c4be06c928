//! Alignment from many start poses: all through the first stage, ever fewer through the rest.

use nalgebra::{Isometry3, Point3};

use crate::alignment::{Alignment, score};
use crate::cloud::Source;
use crate::config::require_positive;
use crate::hypotheses::turned;
use crate::symmetry::Symmetry;
use crate::target::{Target, checked_guess};
use crate::{Error, Result, threads};

/// How start poses are thinned and answers told apart.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct HypothesisConfig {
    /// How many poses go on after the first stage; at least 1. From stage to stage the better half of them goes on,
    /// but never fewer than two.
    pub keep: usize,
    /// Poses that differ by an element of this symmetry are one.
    pub symmetry: Symmetry,
    /// Answers within this angle of each other, in radians, are one (if they are also within `same_distance`).
    pub same_angle: f64,
    /// Answers that put the source's centroid within this share of the model's extent of each other are one (if they
    /// are also within `same_angle`).
    pub same_distance: f64,
    /// Whether the best answer is tried again turned by each of the 23 other rotations of a cube about the source's
    /// centroid, as far as [`IcpConfig::motion`](crate::IcpConfig::motion) admits them.
    ///
    /// For guesses that are to cover all orientations: a wrong answer often lies a quarter or half turn from the right
    /// one. Takes about half as long again with 50 guesses. Default false, since guesses may be chosen so as to leave
    /// orientations out.
    pub turned: bool,
}

impl Default for HypothesisConfig {
    fn default() -> Self {
        Self { keep: 5, symmetry: Symmetry::None, same_angle: 10_f64.to_radians(), same_distance: 0.05, turned: false }
    }
}

/// Poses that reach the last stage at least, so that a second answer is seen where there is one.
const FINALISTS: usize = 2;

/// A local pose after a stage.
struct Candidate {
    pose: Isometry3<f64>,
    iterations: u32,
    score: f64,
}

impl Target {
    /// Aligns `source` from every guess (each a `target_from_source`) and returns the distinct answers, best first.
    ///
    /// Each guess passes the first stage, in parallel with the feature `parallel`; the best distinct
    /// [`HypothesisConfig::keep`] of them go on, half of them from each further stage. The order is by [`Alignment::score`] and does not depend on the
    /// number of threads. Guesses from which no correspondence is found are left out, so the list may be empty.
    ///
    /// ```
    /// # use icp::{HypothesisConfig, IcpConfig, Target, hypotheses};
    /// # use nalgebra::{Isometry3, Point3, Vector3};
    /// # let model: Vec<Point3<f32>> = (0..3000)
    /// #     .map(|i| ((i / 3 % 31) as f32 / 75.0, (i / 93) as f32 / 53.0, i % 3))
    /// #     .map(|(u, v, wall)| match wall {
    /// #         0 => Point3::new(u, v, 0.0),
    /// #         1 => Point3::new(0.0, u, v),
    /// #         _ => Point3::new(v, 0.0, 0.8 * u),
    /// #     })
    /// #     .collect();
    /// # let truth = Isometry3::new(Vector3::new(0.3, -0.2, 0.9), Vector3::new(0.5, 2.1, -0.8));
    /// # let scene: Vec<Point3<f32>> = model.iter().map(|p| truth.inverse().cast::<f32>() * p).collect();
    /// let target = Target::new(&model, &IcpConfig::default())?;
    /// let centroid = icp::centroid(&scene).ok_or("empty scene")?;
    /// let guesses: Vec<_> = hypotheses::uniform_rotations(60)
    ///     .iter()
    ///     .map(|rotation| hypotheses::at_centroid(&target.centroid(), &centroid, rotation))
    ///     .collect();
    /// let found = target.align_from_many(&scene, &guesses, &HypothesisConfig::default())?;
    /// assert!((found[0].target_from_source.inverse() * truth).rotation.angle() < 0.02);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    ///
    /// As [`Target::prepare`]; [`Error::NoGuesses`] for an empty list, [`Error::BadGuess`] if any guess is not a finite
    /// rigid motion, [`Error::BadSetting`] for a bad `config`.
    pub fn align_from_many(
        &self,
        source: &[Point3<f32>],
        guesses: &[Isometry3<f64>],
        config: &HypothesisConfig,
    ) -> Result<Vec<Alignment>> {
        self.align_prepared_from_many(&self.prepare(source)?, guesses, config)
    }

    /// As [`Target::align_from_many`], for a source that was prepared by this target.
    ///
    /// # Errors
    ///
    /// As [`Target::align_from_many`].
    pub fn align_prepared_from_many(
        &self,
        source: &Source,
        guesses: &[Isometry3<f64>],
        config: &HypothesisConfig,
    ) -> Result<Vec<Alignment>> {
        config.check()?;
        self.suits(source)?;
        if guesses.is_empty() {
            return Err(Error::NoGuesses);
        }
        let checked = guesses.iter().enumerate().map(|(index, guess)| checked_guess(guess, index));
        let guesses: Vec<Isometry3<f64>> = checked.collect::<Result<_>>()?;
        let mut answers = self.search(source, &guesses, config)?;
        if let Some(best) = answers.first().filter(|_| config.turned) {
            let turned = turned(&best.target_from_source, &source.centroid(), &self.config.motion);
            answers.extend(self.search(source, &turned, config)?);
            answers.sort_by(|a, b| b.score.total_cmp(&a.score));
        }
        Ok(self.distinct(source, answers, config, usize::MAX, |answer| answer.target_from_source))
    }

    /// Takes guesses through all stages, ever fewer of them; what is left is sorted best first.
    fn search(&self, source: &Source, guesses: &[Isometry3<f64>], config: &HypothesisConfig) -> Result<Vec<Alignment>> {
        let start = |guess: &Isometry3<f64>| self.advance(source, &self.to_local(source, guess), 0, 0);
        let mut candidates = found(threads::map_coarse(guesses, start))?;
        let last = self.stages().len() - 1;
        let mut keep = config.keep;
        for stage in 1..last {
            candidates = self.best(source, candidates, config, keep);
            let next = |candidate: &Candidate| self.advance(source, &candidate.pose, stage, candidate.iterations);
            candidates = found(threads::map_coarse(&candidates, next))?;
            keep = keep.div_ceil(2).max(FINALISTS.min(keep));
        }
        candidates = self.best(source, candidates, config, keep);
        let finish = |candidate: &Candidate| self.finish(source, &candidate.pose, last, candidate.iterations);
        let mut answers = found(threads::map_coarse(&candidates, finish))?;
        answers.sort_by(|a, b| b.score.total_cmp(&a.score));
        Ok(answers)
    }

    /// Takes a local pose through one stage and scores it there.
    fn advance(&self, source: &Source, local: &Isometry3<f64>, stage: usize, before: u32) -> Result<Candidate> {
        let reached = self.run_stage(source, local, stage)?;
        let sums = self.distances_at(source, &reached.pose, stage);
        Ok(Candidate {
            pose: reached.pose,
            iterations: before + reached.iterations,
            score: score(&sums, source.levels[stage].count, self.stages()[stage].distance),
        })
    }

    /// The best distinct candidates, best first.
    fn best(
        &self,
        source: &Source,
        mut candidates: Vec<Candidate>,
        config: &HypothesisConfig,
        keep: usize,
    ) -> Vec<Candidate> {
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
        self.distinct(source, candidates, config, keep, |candidate| self.to_given(source, &candidate.pose))
    }

    /// The first `most` items of a list sorted best first, without those that repeat an earlier one.
    pub(crate) fn distinct<T>(
        &self,
        source: &Source,
        sorted: Vec<T>,
        config: &HypothesisConfig,
        most: usize,
        pose_of: impl Fn(&T) -> Isometry3<f64>,
    ) -> Vec<T> {
        let centroid = source.centroid();
        let same = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
            let folded = config.symmetry.fold(a, b);
            let angle = folded.rotation.angle_to(&b.rotation);
            let shift = (folded * centroid - b * centroid).norm();
            angle <= config.same_angle && shift <= config.same_distance * self.extent()
        };
        let mut kept: Vec<(Isometry3<f64>, T)> = Vec::new();
        for item in sorted {
            if kept.len() == most {
                break;
            }
            let pose = pose_of(&item);
            if !kept.iter().any(|(other, _)| same(&pose, other)) {
                kept.push((pose, item));
            }
        }
        kept.into_iter().map(|(_, item)| item).collect()
    }
}

impl HypothesisConfig {
    fn check(&self) -> Result<()> {
        require_positive("HypothesisConfig::keep", self.keep as f64)?;
        require_positive("HypothesisConfig::same_angle", self.same_angle)?;
        require_positive("HypothesisConfig::same_distance", self.same_distance)
    }
}

/// The results of those guesses that led anywhere; a lost guess is an ordinary outcome, other errors are not.
fn found<T>(results: Vec<Result<T>>) -> Result<Vec<T>> {
    let led_nowhere =
        |result: &Result<T>| matches!(result, Err(Error::NoCorrespondences { .. } | Error::Degenerate { .. }));
    results.into_iter().filter(|result| !led_nowhere(result)).collect()
}
