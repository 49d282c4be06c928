use proptest::prelude::*;

use super::*;
use crate::kernels::bf16;
use crate::kernels::cases::{assert_close, available, values};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Of a sum with a residual, the activation is that of the whole sum.
    #[test]
    fn the_activation_follows_the_residual(
        [height, width] in [1_usize..24, 1_usize..24], (ins, outs) in (1_usize..20, 1_usize..40), seed: u64,
        activation in prop::sample::select(vec![Activation::Linear, Activation::Relu, Activation::Relu6]),
    ) {
        let pixels = height * width;
        let [input, filter, bias] = [pixels * ins, outs * ins, outs].map(|len| values(seed, len));
        let residual: Vec<f32> = values(seed ^ 1, pixels * outs).iter().map(|x| x * 8.0).collect();
        let [low, high] = activation.bounds();
        let value = |i: usize| {
            let (pixel, out) = (i / outs, i % outs);
            let product: f32 = (0..ins).map(|k| input[pixel * ins + k] * filter[out * ins + k]).sum();
            (bias[out] + product + residual[i]).clamp(low, high)
        };
        let truth: Vec<f32> = (0..pixels * outs).map(value).collect();
        let sweep = Sweep::pointwise([height, width]);
        for isa in available() {
            let mut output = vec![f32::NAN; pixels * outs];
            let source = |data: &[f32], pixel: usize| Source {
                data: data.as_ptr(), height, width, row: width * pixel, pixel,
            };
            let job = Gather {
                isa,
                source: source(&input, ins),
                sweep: &sweep,
                weights: &Packed::of_taps(isa, &filter, [outs, ins, 1], Some(&bias)),
                sink: Sink { data: output.as_mut_ptr(), row: width * outs, pixel: outs, bf16: false },
                residual: Some(source(&residual, outs)),
                activation,
                zeros: &vec![0.0; ins],
            };
            (0..job.chunks()).for_each(|chunk| job.run(chunk));
            assert_close(&output, &truth, 1e-5);
        }
    }
}

/// Two steps a pair give the bits of the instruction, where the processor has it.
#[test]
fn products_of_bfloat16_are_those_of_the_instruction() {
    if !Isa::Avx512Bf16.available() {
        println!("skipped: no AVX-512 BF16");
        return;
    }
    let [positions, ins, outs] = [50, 34, 70];
    let input: Vec<f32> = values(1, positions * ins).chunks_exact(2).map(|two| bf16::pair(two[0], two[1])).collect();
    let [filter, bias] = [(2, ins * outs), (3, outs)].map(|(seed, len)| values(seed, len));
    let sweep = Sweep::pointwise([1, positions]);
    let product = |isa| {
        let mut output = vec![f32::NAN; positions * outs];
        let pixel = ins / 2;
        let job = Gather {
            isa,
            source: Source { data: input.as_ptr(), height: 1, width: positions, row: positions * pixel, pixel },
            sweep: &sweep,
            weights: &Packed::bf16_of_taps(isa, &filter, [outs, ins, 1], Some(&bias)),
            sink: Sink { data: output.as_mut_ptr(), row: positions * outs, pixel: outs, bf16: false },
            residual: None,
            activation: Activation::Linear,
            zeros: &vec![0.0; pixel],
        };
        (0..job.chunks()).for_each(|chunk| job.run(chunk));
        output
    };
    assert_eq!(product(Isa::Avx512), product(Isa::Avx512Bf16));
}
