//! Registering one view of a bin: the model's preparation, one alignment, twelve starts.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use icp::{HypothesisConfig, IcpConfig, Target, hypotheses};
use nalgebra::{Isometry3, Translation3, Vector3};

fn register(criterion: &mut Criterion) {
    let model = benches::bin_model();
    let (view, truth) = benches::bin_view();
    let guess = Translation3::new(0.03, -0.02, 0.04) * truth;
    let mut group = criterion.benchmark_group("register");
    group.sample_size(10);
    for (name, config) in [("default", IcpConfig::default()), ("paper", IcpConfig::paper(0.08))] {
        group.bench_function(format!("{name}/prepare"), |bencher| {
            bencher.iter(|| Target::new(black_box(&model), &config));
        });
        let target = Target::new(&model, &config).expect("the bin suits both configurations");
        group.bench_function(format!("{name}/align"), |bencher| {
            bencher.iter(|| target.align(black_box(&view), &guess));
        });
        let guesses: Vec<Isometry3<f64>> = hypotheses::yaw_about(&Vector3::z_axis(), &target.centroid(), 12)
            .into_iter()
            .map(|turn| turn * guess)
            .collect();
        group.bench_function(format!("{name}/twelve_starts"), |bencher| {
            bencher.iter(|| target.align_from_many(black_box(&view), &guesses, &HypothesisConfig::default()));
        });
    }
    group.finish();
}

criterion_group!(benches, register);
criterion_main!(benches);
