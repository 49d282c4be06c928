//! Clusters of clouds without order, and what filters at edges keep.

use cloudcrop::{
    CropConfig, EdgeFilter, EuclideanConfig, OrganizedCloud, centroid, crop_to_object, edge_pixels, euclidean_clusters,
};
use nalgebra::Point3;
use proptest::prelude::*;

use crate::strategies::masked_view;

/// The clusters by their definition: every pair of points is looked at.
fn plainly(points: &[Point3<f32>], config: &EuclideanConfig) -> Vec<Vec<usize>> {
    let is_finite = |&index: &usize| points[index].iter().all(|coordinate| coordinate.is_finite());
    let tolerance = f64::from(config.tolerance);
    let mut open: Vec<usize> = (0..points.len()).filter(is_finite).collect();
    let mut clusters = Vec::new();
    while !open.is_empty() {
        let mut cluster = vec![open.remove(0)];
        let mut visited = 0;
        while let Some(&index) = cluster.get(visited) {
            visited += 1;
            let at = points[index].cast::<f64>();
            let is_near = |other: &usize| (points[*other].cast::<f64>() - at).norm_squared() <= tolerance * tolerance;
            cluster.extend(open.extract_if(.., |other| is_near(other)));
        }
        cluster.sort_unstable();
        clusters.push(cluster);
    }
    clusters.retain(|cluster| (config.min_points.max(1)..=config.max_points).contains(&cluster.len()));
    clusters.sort_by_key(|cluster| std::cmp::Reverse(cluster.len())); // stable: first points ascend
    clusters
}

/// Heaps of points of any density, some on a grid so that distances repeat, with repeated and broken points.
fn heaps() -> impl Strategy<Value = Vec<Point3<f32>>> {
    let anywhere = || -0.3..0.3_f32;
    let on_grid = || (-6..6_i8).prop_map(|step| f32::from(step) * 0.05);
    let dense = || (-6..6_i8, 0.0..0.004_f32).prop_map(|(step, noise)| f32::from(step) * 0.06 + noise);
    let point = prop_oneof![
        4 => [anywhere(), anywhere(), anywhere()],
        4 => [on_grid(), on_grid(), on_grid()],
        4 => [dense(), dense(), dense()],
        1 => anywhere().prop_map(|y| [0.1, y, f32::NAN]),
        1 => anywhere().prop_map(|y| [f32::NEG_INFINITY, y, 0.0]),
        1 => Just([0.1, -0.1, 0.2]),
    ];
    proptest::collection::vec(point.prop_map(Point3::from), 0..400)
}

proptest! {
    #[test]
    fn clusters_are_those_of_the_definition(
        points in heaps(), tolerance in prop_oneof![0.001..0.2_f32, Just(0.05_f32), Just(5.0_f32)],
        min_points in 0..5_usize, max_points in prop_oneof![3..50_usize, Just(usize::MAX)], scale in -30..30_i32,
    ) {
        // At any scale: what matters is the ratio of distances and tolerance.
        let scale = 2.0_f32.powi(scale);
        let points: Vec<Point3<f32>> = points.iter().map(|point| point * scale).collect();
        let config = EuclideanConfig { tolerance: tolerance * scale, min_points, max_points };
        prop_assert_eq!(euclidean_clusters(&points, &config).expect("valid"), plainly(&points, &config));
    }

    /// A filter takes readings and changes none; flying pixels are among those beside a jump, or alone.
    #[test]
    fn filters_only_take_away((cloud, _) in masked_view(), step in 0.001..1.0_f32) {
        let depth = cloud.depth();
        for filter in [EdgeFilter::Jumps { step }, EdgeFilter::FlyingPixels { step }] {
            let marked = edge_pixels(&depth, filter).expect("valid");
            let kept: OrganizedCloud = cloud.clone().without_edges(filter).expect("valid");
            for (pixel, (before, after)) in cloud.points().iter().zip(kept.points()).enumerate() {
                let is_marked = marked.as_raw()[pixel] != 0;
                prop_assert_eq!(after.z.is_nan(), before.z.is_nan() || is_marked);
                prop_assert!(after.z.is_nan() || after == before);
                prop_assert!(!(is_marked && before.z.is_nan()));
            }
        }
        // Without a jump in the image, the first filter drops nothing.
        let flat = EdgeFilter::Jumps { step: 20.0 };
        prop_assert!(edge_pixels(&depth, flat).expect("valid").iter().all(|&value| value == 0));
    }

    /// The paper's crop by its definition: all masked points within the margin of their mean.
    #[test]
    fn the_papers_crop_is_a_ball_around_the_mean((cloud, mask) in masked_view(), margin in 0.05..3.0_f32) {
        let pixels = cloud.points().iter().zip(mask.as_raw());
        let masked = pixels.filter(|&(point, &value)| value != 0 && !point.z.is_nan());
        let masked: Vec<Point3<f32>> = masked.map(|(point, _)| *point).collect();
        let center = centroid(&masked);
        let is_near = |point: &&Point3<f32>| (*point - center.expect("points")).norm_squared() <= margin * margin;
        let expected: Vec<Point3<f32>> = masked.iter().filter(is_near).copied().collect();
        match crop_to_object(&cloud, &mask, &CropConfig::paper(margin)) {
            Ok(object) => {
                prop_assert_eq!(object.points, expected);
                prop_assert_eq!(Some(object.ball_center), center);
            }
            Err(_) => prop_assert!(expected.is_empty()),
        }
    }
}
