//! Making one training sample, per blend.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use synth::{BlendWeights, SynthConfig};

fn compose(criterion: &mut Criterion) {
    let nothing = BlendWeights { none: 0.0, gaussian: 0.0, poisson: 0.0, ..BlendWeights::default() };
    let cases = [
        ("none", BlendWeights { none: 1.0, ..nothing }),
        ("gaussian", BlendWeights { gaussian: 1.0, ..nothing }),
        ("poisson", BlendWeights { poisson: 1.0, ..nothing }),
    ];
    let mut group = criterion.benchmark_group("sample_288x160");
    for (name, blend_weights) in cases {
        let config = SynthConfig { objects: (1, 2), blend_weights, ..SynthConfig::default() };
        let synthesizer = benches::synthesizer(config).expect("the drawn crops are valid");
        let mut index = 0;
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                index += 1;
                black_box(synthesizer.sample(index))
            });
        });
    }
    group.finish();
}

criterion_group!(benches, compose);
criterion_main!(benches);
