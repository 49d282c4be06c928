//! What surfaces leave open, decided by what the camera looks through.

use nalgebra::Isometry3;

use crate::alignment::Alignment;
use crate::cloud::Source;
use crate::pose_score::{PoseEvidence, pose_score};
use crate::sight::{DepthView, SightModel, Sighting};
use crate::target::Target;
use crate::{HypothesisConfig, Result};

/// A depth image and what is compared with it. The source's frame must be the camera's.
#[derive(Clone, Copy, Debug)]
pub struct Sight<'a> {
    /// The depth image.
    pub view: &'a DepthView<'a>,
    /// Points of the target, in its frame.
    pub model: &'a SightModel,
    /// A surface measured this far behind a point of the model, in metres, is looked at through it.
    pub tolerance: f64,
}

/// An alignment and what the camera says of it.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SeenAlignment {
    /// The pose, and what the surfaces say of it.
    pub alignment: Alignment,
    /// What the camera sees, and sees through.
    pub sighting: Sighting,
    /// Both in one number, 0 to 1: [`pose_score`].
    pub score: f64,
}

/// First step along a weak direction, and the last one, as shares of the model's extent.
const FIRST: f64 = 1.0 / 16.0;
const LAST: f64 = 1.0 / 512.0;

impl Target {
    /// As [`Target::align_from_many`], with the depth image as a witness: answers are moved along their weak directions
    /// to where the camera looks through least of the model, and ordered by [`SeenAlignment::score`].
    ///
    /// A box of which one face and the lid are seen may slide along both; its surfaces do not tell where it ends, but the
    /// camera sees what is beside it.
    ///
    /// # Errors
    ///
    /// As [`Target::align_prepared_from_many`] and [`DepthView::look`].
    pub fn align_in_view(
        &self,
        source: &Source,
        guesses: &[Isometry3<f64>],
        config: &HypothesisConfig,
        sight: &Sight<'_>,
    ) -> Result<Vec<SeenAlignment>> {
        let found = self.align_prepared_from_many(source, guesses, config)?;
        let mut seen: Vec<SeenAlignment> =
            found.iter().map(|alignment| self.settle(source, alignment, sight)).collect::<Result<_>>()?;
        seen.sort_by(|a, b| b.score.total_cmp(&a.score));
        // Two answers may have slid to one.
        Ok(self.distinct(source, seen, config, usize::MAX, |seen| seen.alignment.target_from_source))
    }

    /// Moves a pose along its weak directions to where surfaces and camera together bear it out best.
    ///
    /// A pattern search: each direction in turn, both ways, by steps that halve from a sixteenth of the extent. A pose
    /// without weak directions stays as it is.
    ///
    /// # Errors
    ///
    /// As [`DepthView::look`].
    pub fn settle(&self, source: &Source, found: &Alignment, sight: &Sight<'_>) -> Result<SeenAlignment> {
        self.suits(source)?;
        let mut best = self.witness(source, found.target_from_source, sight)?;
        let directions = &found.weak_directions;
        let mut step = FIRST * self.extent();
        while !directions.is_empty() && step > LAST * self.extent() {
            let mut moved = false;
            for motion in directions.iter().flat_map(|direction| [direction.by(step), direction.by(-step)]) {
                let other = self.witness(source, motion * best.pose, sight)?;
                if other.score > best.score {
                    best = other;
                    moved = true;
                }
            }
            if !moved {
                step /= 2.0;
            }
        }
        let alignment = if best.pose == found.target_from_source {
            found.clone()
        } else {
            self.describe(source, &best.pose, found.iterations, found.stop)?
        };
        Ok(SeenAlignment { alignment, sighting: best.sighting, score: best.score })
    }

    fn witness(&self, source: &Source, pose: Isometry3<f64>, sight: &Sight<'_>) -> Result<Witness> {
        let last = self.stages().len() - 1;
        let sums = self.distances_at(source, &self.to_local(source, &pose), last);
        let sighting = sight.view.look(sight.model, &pose.inverse(), sight.tolerance)?;
        let evidence = PoseEvidence {
            inlier_share: sums.count as f64 / source.levels[last].count as f64,
            rms: (sums.cost / sums.count.max(1) as f64).sqrt(),
            distance: self.stages()[last].distance,
            seen_through_share: sighting.seen_through_share(),
        };
        // Too few matches to say anything of a pose say nothing for it.
        let enough = sums.count >= self.config.min_correspondences;
        Ok(Witness { pose, sighting, score: if enough { pose_score(&evidence) } else { 0.0 } })
    }
}

struct Witness {
    pose: Isometry3<f64>,
    sighting: Sighting,
    score: f64,
}
