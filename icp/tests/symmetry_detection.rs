//! The symmetry of sampled solids, noisy and turned anyhow, is found; that of bodies without one is not made up.

use std::path::PathBuf;

use icp::strategies::{Solid, moved, pose, solid};
use icp::{CloudRole, DetectedSymmetry, Error, Symmetry, SymmetryClass, SymmetryConfig, detect_symmetry, hypotheses};
use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;

/// A solid, the family of its turns, and how many there are (of an axial one: listed).
type Case = (&'static str, Solid, SymmetryClass, usize);

fn shifted(solid: Solid, x: f64, y: f64, z: f64) -> Solid {
    solid.shifted(Vector3::new(x, y, z))
}

/// A ball with a smaller one in each direction.
fn knobbed(directions: &[Vector3<f64>]) -> Solid {
    let knob = |direction: &Vector3<f64>| Solid::ball(0.035).shifted(direction * 0.12);
    directions.iter().map(knob).fold(Solid::ball(0.1), Solid::with)
}

fn cases() -> Vec<Case> {
    use SymmetryClass::{
        Axial, AxialBothWays, Cyclic, Dihedral, Icosahedral, None, Octahedral, Spherical, Tetrahedral,
    };
    let handle = shifted(Solid::cuboid([0.20, 0.06, 0.05]), 0.0, 0.25, 0.15);
    let bottle = [[0.0, 0.0], [0.04, 0.0], [0.04, 0.15], [0.015, 0.2], [0.015, 0.25]];
    let blob = Solid::ball(0.1)
        .with(shifted(Solid::ball(0.05), 0.09, 0.03, 0.0))
        .with(shifted(Solid::ball(0.06), -0.02, 0.08, 0.04))
        .with(shifted(Solid::ball(0.04), -0.05, -0.02, 0.10));
    let tetrahedron = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    let tetrahedron = tetrahedron.map(|corner| Vector3::from(corner).normalize());
    let icosahedron: Vec<_> = hypotheses::icosphere(0).iter().map(|corner| corner.into_inner()).collect();
    vec![
        ("tapered bin", Solid::bin([0.17; 2], [0.20; 2], 0.75), Cyclic, 4),
        // Its moments along y and z are equal: inertia leaves the axis open.
        ("open box", Solid::bin([0.39, 0.22], [0.39, 0.22], 0.56), Cyclic, 2),
        ("box", Solid::cuboid([0.39, 0.22, 0.56]), Dihedral, 4),
        ("box with a handle", Solid::cuboid([0.39, 0.44, 0.56]).with(handle), None, 1),
        ("cylinder", Solid::cylinder(0.04, 0.2), AxialBothWays, 72),
        ("pipe as long as wide", Solid::lathe(&[[0.1, -0.1], [0.1, 0.1]]), AxialBothWays, 72),
        ("bottle", Solid::lathe(&bottle), Axial, 72),
        ("cone frustum", Solid::lathe(&[[0.0, 0.0], [0.1, 0.0], [0.07, 0.2], [0.0, 0.2]]), Axial, 72),
        ("triangular prism", Solid::prism(3, 0.1, 0.3), Dihedral, 6),
        ("hexagonal prism", Solid::prism(6, 0.1, 0.3), Dihedral, 12),
        ("octagonal plate", Solid::prism(8, 0.1, 0.05), Dihedral, 16),
        ("cube", Solid::cuboid([0.2; 3]), Octahedral, 24),
        ("tetrapod", knobbed(&tetrahedron), Tetrahedral, 12),
        ("mine", knobbed(&icosahedron), Icosahedral, 60),
        ("ball", Solid::ball(0.1), Spherical, 72),
        ("blob", blob, None, 1),
    ]
}

fn detect(points: &[Point3<f32>]) -> DetectedSymmetry {
    detect_symmetry(points, &SymmetryConfig::default()).expect("a sampled solid is valid input")
}

#[test]
fn solids_have_their_symmetry_with_and_without_noise() {
    for (name, solid, class, order) in cases() {
        for (count, noise) in [(30_000, 0.0), (30_000, 0.001), (8000, 0.001)] {
            let found = detect(&solid.sample(count, noise, 5));
            let listed = found.symmetry.elements().len();
            assert_eq!((found.class, listed), (class, order), "{name}, {count} points, noise {noise}: {found:#?}");
            assert!(found.fit.rms <= found.tolerance && found.floor.rms < found.tolerance, "{name}");
        }
    }
}

#[test]
fn an_axis_near_one_of_the_frame_is_put_onto_it() {
    let bin = Solid::bin([0.17; 2], [0.20; 2], 0.75).sample(20_000, 0.001, 3);
    let measured = SymmetryConfig { snap_angle: 0.0, ..SymmetryConfig::default() };
    let tilt_of = |config: &SymmetryConfig| match detect_symmetry(&bin, config).unwrap().symmetry {
        Symmetry::Cyclic { axis, .. } => (1.0 - axis.z) * 1e12,
        other => panic!("{other:?}"),
    };
    assert!(tilt_of(&SymmetryConfig::default()) < 1e-2);
    assert!(tilt_of(&measured) > 1.0, "an axis measured from noise is not exact");
}

/// An oblong bin stands a half turn and nothing else, unless the difference of its sides is tolerated.
#[test]
fn candidates_say_how_close_a_call_it_was() {
    let bin = Solid::bin([0.25, 0.22], [0.27, 0.24], 0.4).sample(20_000, 0.001, 3);
    let departure = |tolerance, fold| {
        let found = detect_symmetry(&bin, &SymmetryConfig { tolerance, ..SymmetryConfig::default() }).unwrap();
        assert!(found.candidates.is_sorted_by(|a, b| a.departure <= b.departure));
        let upright = |c: &&icp::SymmetryCandidate| c.fold == fold && c.axis.z > 0.99;
        found.candidates.iter().find(upright).map(|candidate| candidate.departure).unwrap()
    };
    assert!(departure(0.0, Some(2)) < 0.9 && departure(0.0, Some(4)) > 3.0 && departure(0.0, None) > 3.0);
    assert!(departure(0.03, Some(4)) < 0.9);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    /// Moving the cloud moves its symmetry: each motion found for it is one of those found for the upright solid.
    #[test]
    fn symmetry_moves_with_the_cloud(index in 0..cases().len(), place in pose(5.0), seed in any::<u64>()) {
        let (name, solid, class, order) = cases().swap_remove(index);
        let upright = detect(&solid.sample(20_000, 0.0005, 1));
        let found = detect(&moved(&solid.sample(20_000, 0.0005, seed), &place));
        prop_assert_eq!(found.class, class, "{}: {:#?}", name, found);
        let elements = found.symmetry.elements();
        prop_assert_eq!(elements.len(), order);
        // A ball's turns are all right, and only some of them are listed.
        let checked = if class == SymmetryClass::Spherical { &[] } else { &elements[..] };
        for element in checked {
            let back = place.inverse() * element * place;
            let (angle, shift) = upright.symmetry.fold_error(&back, &Isometry3::identity());
            prop_assert!(angle < 0.02 && shift < 0.004, "{name}: {angle} rad, {shift} m");
        }
    }

    /// The list of a finite symmetry is closed, or folding would depend on the order of its arguments.
    #[test]
    fn finite_groups_are_closed(index in 0..cases().len(), place in pose(1.0)) {
        let (_, solid, ..) = cases().swap_remove(index);
        let found = detect(&moved(&solid.sample(6000, 0.0003, 2), &place)).symmetry;
        let elements = found.elements();
        let finite = if matches!(found, Symmetry::Finite(_)) { &elements[..] } else { &[] };
        for a in finite {
            for b in finite {
                let same = |c: &&Isometry3<f64>| ((a * b).inverse() * *c).rotation.angle() < 1e-6;
                let product = finite.iter().find(same);
                prop_assert!(product.is_some());
                prop_assert!(product.is_some_and(|c| (a * b).translation.vector.metric_distance(&c.translation.vector) < 1e-6));
            }
        }
    }

    /// Holes are dropped and counted, and change nothing else.
    #[test]
    fn non_finite_points_are_dropped(holes in 1_usize..300, seed in any::<u64>()) {
        let points = Solid::bin([0.17; 2], [0.20; 2], 0.75).sample(3000, 0.001, seed);
        let mut holed = points.clone();
        for index in 0..holes {
            holed.insert(index * 7 % points.len(), Point3::new(0.0, [f32::NAN, f32::INFINITY][index % 2], 0.0));
        }
        let (plain, found) = (detect(&points), detect(&holed));
        prop_assert_eq!(found.dropped_points, holes);
        prop_assert_eq!(DetectedSymmetry { dropped_points: 0, ..found }, plain);
    }
}

#[test]
fn clouds_without_a_surface_are_refused() {
    let config = SymmetryConfig::default();
    let target = CloudRole::Target;
    assert_eq!(detect_symmetry(&[], &config), Err(Error::EmptyCloud { cloud: target, dropped: 0 }));
    let few = detect_symmetry(&solid(1, 99), &config);
    assert_eq!(few, Err(Error::TooFewPoints { cloud: target, found: 99, needed: 100 }));
    let one = detect_symmetry(&[Point3::new(1.0, 2.0, 3.0); 500], &config);
    assert!(matches!(one, Err(Error::ExtentOutOfRange { .. })));
    let four: Vec<_> = (0..500).map(|i| Point3::new((i % 2) as f32, (i / 2 % 2) as f32, 0.0)).collect();
    assert!(matches!(detect_symmetry(&four, &config), Err(Error::LeafTooLarge { found: 4, .. })));
    let line: Vec<_> = (0..500).map(|i| Point3::from(Vector3::new(0.3, -0.2, 0.7) * (i as f32))).collect();
    assert!(matches!(detect_symmetry(&line, &config), Err(Error::Collinear { .. })));
}

#[test]
fn a_flat_plate_has_a_symmetry_too() {
    let disc = Solid::lathe(&[[0.0, 0.1], [0.2, 0.1]]).sample(8000, 0.0, 4);
    assert_eq!(detect(&disc).class, SymmetryClass::AxialBothWays);
}

#[test]
fn settings_outside_their_range_are_refused() {
    let base = SymmetryConfig::default;
    let bad = [
        SymmetryConfig { max_fold: 1, ..base() },
        SymmetryConfig { max_fold: 25, ..base() },
        SymmetryConfig { tolerance: -1.0, ..base() },
        SymmetryConfig { tolerance: f64::NAN, ..base() },
        SymmetryConfig { max_mismatch: 0.0, ..base() },
        SymmetryConfig { max_mismatch: 1.0, ..base() },
        SymmetryConfig { points: 100, ..base() },
        SymmetryConfig { snap_angle: f64::INFINITY, ..base() },
    ];
    for config in bad {
        assert!(matches!(detect_symmetry(&solid(1, 500), &config), Err(Error::BadSetting { .. })), "{config:?}");
    }
}

#[cfg(feature = "parallel")]
#[test]
fn threads_do_not_change_a_bit() {
    let cube = Solid::cuboid([0.2; 3]).sample(6000, 0.001, 8);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| detect(&cube))
    };
    assert_eq!(with(1), with(3));
}

/// A file of the shared data, or `None` with the reason printed.
#[expect(clippy::print_stderr, reason = "a skipped test says why")]
fn shared(file: &str) -> Option<PathBuf> {
    let data = std::env::var_os("POSEPIPE_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let path = data.join(file);
    if path.is_file() {
        return Some(path);
    }
    eprintln!("skipped: no {}", path.display());
    None
}

#[test]
fn the_bunny_has_no_symmetry() {
    let Some(path) = shared("registration/stanford-bunny.obj") else { return };
    let text = std::fs::read_to_string(path).unwrap();
    let vertex = |line: &str| {
        let mut values = line.strip_prefix("v ")?.split_whitespace().map(|word| word.parse::<f32>().ok());
        Some(Point3::new(values.next()??, values.next()??, values.next()??))
    };
    let bunny: Vec<_> = text.lines().filter_map(vertex).collect();
    assert_eq!(bunny.len(), 35_947);
    let found = detect(&bunny);
    assert_eq!(found.symmetry, Symmetry::None);
    assert!(found.candidates[0].departure > 20.0, "{:?}", found.candidates[0]);
}

/// The model of a real cabinet, fused from depth images: open at the bottom, doors on both sides.
#[test]
fn the_cabinet_stands_a_half_turn_about_its_vertical() {
    let Some(path) = shared("rgbd/tum_fr3_cabinet/models/obj_000001.ply") else { return };
    let bytes = std::fs::read(path).unwrap();
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
    let metres = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]) / 1000.0;
    let vertex = |record: &[u8]| Point3::new(metres(record), metres(&record[4..]), metres(&record[8..]));
    let cabinet: Vec<_> = bytes[body..].chunks_exact(15).map(vertex).collect();
    let found = detect(&cabinet);
    match found.symmetry {
        Symmetry::Cyclic { axis, point, fold: 2 } => {
            assert!(axis.z > 0.9999 && point.x.hypot(point.y) < 0.005, "{axis:?} {point:?}");
        }
        other => panic!("{other:?}"),
    }
    assert!(found.candidates[1].departure > 10.0, "{:?}", found.candidates[1]);
}
