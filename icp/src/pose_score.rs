//! One number to compare poses by.

/// What speaks for and against a pose, see [`pose_score`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PoseEvidence {
    /// Share of the scene's points that have a point of the model within `distance`, 0 to 1
    /// ([`Alignment::inlier_share`](crate::Alignment)).
    pub inlier_share: f64,
    /// Root mean square distance of those points to the model, metres ([`Alignment::rms`](crate::Alignment)).
    pub rms: f64,
    /// Distance up to which a point counts as matched, metres.
    pub distance: f64,
    /// Share of the model's judged points that the camera looks through, 0 to 1
    /// ([`Sighting::seen_through_share`](crate::Sighting)).
    pub seen_through_share: f64,
}

/// How well a pose is borne out, 0 to 1, higher is better: how much of the scene the model explains, times how much of the
/// model the scene bears out.
///
/// `inlier_share · (1 - rms² / distance²) · (1 - seen_through_share)`. The first two factors are
/// [`Alignment::score`](crate::Alignment), the truncated quadratic of MSAC (Torr and Zisserman 2000, equation 17). It
/// cannot see a model that covers all points and sticks out where there are none; the last factor can. Each is a share
/// that is 1 for a perfect pose, so that the product falls at least as far as the worst of them. Evidence outside its
/// range is taken for the nearest value in it, and NaN for the worst.
///
/// ```
/// use icp::{PoseEvidence, pose_score};
///
/// let upright = PoseEvidence { inlier_share: 0.95, rms: 0.002, distance: 0.01, seen_through_share: 0.01 };
/// let on_its_head = PoseEvidence { inlier_share: 0.97, seen_through_share: 0.3, ..upright };
/// assert!(pose_score(&upright) > 0.9 && pose_score(&on_its_head) < 0.7);
/// ```
pub fn pose_score(evidence: &PoseEvidence) -> f64 {
    let PoseEvidence { inlier_share, rms, distance, seen_through_share } = *evidence;
    let spread = if rms == 0.0 && distance >= 0.0 { 0.0 } else { share_or(rms.abs() / distance, 1.0) };
    share_or(inlier_share, 0.0) * (1.0 - spread * spread) * (1.0 - share_or(seen_through_share, 1.0))
}

/// The value between 0 and 1 nearest to `value`, or `worst` for NaN.
fn share_or(value: f64, worst: f64) -> f64 {
    if value.is_nan() { worst } else { value.clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    use proptest::prelude::*;

    fn any_evidence() -> impl Strategy<Value = PoseEvidence> {
        let number = || prop_oneof![Just(f64::NAN), Just(f64::INFINITY), -2.0..2.0_f64, 0.0..1.0_f64];
        [number(), number(), number(), number()].prop_map(|[inlier_share, rms, distance, seen_through_share]| {
            PoseEvidence { inlier_share, rms, distance, seen_through_share }
        })
    }

    fn sound_evidence() -> impl Strategy<Value = PoseEvidence> {
        (0.0..=1.0, 0.0..=1.0, 0.01..1.0, 0.0..=1.0).prop_map(|(inlier_share, part, distance, seen_through_share)| {
            PoseEvidence { inlier_share, rms: part * distance, distance, seen_through_share }
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn scores_are_shares(evidence in any_evidence()) {
            prop_assert!((0.0..=1.0).contains(&pose_score(&evidence)));
        }

        #[test]
        fn better_evidence_never_scores_less(evidence in sound_evidence(), gain in 0.0..0.5_f64) {
            let score = pose_score(&evidence);
            let better = [
                PoseEvidence { inlier_share: evidence.inlier_share + gain, ..evidence },
                PoseEvidence { rms: evidence.rms * (1.0 - gain), ..evidence },
                PoseEvidence { seen_through_share: evidence.seen_through_share - gain, ..evidence },
            ];
            for better in better {
                prop_assert!(pose_score(&better) >= score);
            }
            prop_assert!(score <= evidence.inlier_share.min(1.0 - evidence.seen_through_share));
        }
    }

    #[test]
    fn perfect_and_hopeless_poses_have_the_ends_of_the_scale() {
        let perfect = PoseEvidence { inlier_share: 1.0, rms: 0.0, distance: 0.01, seen_through_share: 0.0 };
        assert_eq!(pose_score(&perfect), 1.0);
        assert_eq!(pose_score(&PoseEvidence { seen_through_share: 1.0, ..perfect }), 0.0);
        assert_eq!(pose_score(&PoseEvidence { rms: 0.01, ..perfect }), 0.0);
        assert_eq!(pose_score(&PoseEvidence { inlier_share: f64::NAN, ..perfect }), 0.0);
    }
}
