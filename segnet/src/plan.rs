//! Inference: a network compiled for one image size.
//!
//! Batch norms are folded into convolutions, weights packed for the processor's vectors, and the memory of all feature
//! maps is laid out beforehand; a call allocates its result at most. The steps run on the threads of rayon's pool; the
//! result is the same bit for bit on any number of them.

pub(crate) mod affine;
mod backbone;
mod buffers;
mod build;
pub(crate) mod folded;
mod image;
mod inverted;
mod keras;
mod pooling;
mod precision;
mod spatial;
mod step;
mod strips;
mod winograd;

use std::time::{Duration, Instant};

use buffers::{Block, Piece};
use image::{Input, Output, ROWS, SharedOutput};
pub use precision::Precision;
use step::{Map, Step};

use crate::kernels::crew::{self, Program, Progress};
use crate::kernels::{Isa, Tap};

/// A network ready to run on images of one size; see [`BiSeNet::compile`](crate::BiSeNet::compile).
#[derive(Debug)]
pub struct Plan {
    isa: Isa,
    block: Block,
    steps: Vec<Step>,
    /// What each step is, for profiles.
    names: Vec<String>,
    progress: Vec<Progress>,
    /// The image, inside its padding.
    image: Map,
    /// Logits at an eighth of the image's size.
    logits: Map,
    /// Which of their columns each column of the image lies between.
    columns: Vec<Tap>,
    /// Memory for a row of logits, for each chunk of the result.
    lines: Vec<Piece>,
}

/// How long a step of a plan takes.
#[derive(Clone, Debug, PartialEq)]
pub struct StepTime {
    /// What it computes, by the names of the network's parts.
    pub name: String,
    /// Multiplications.
    pub multiplications: usize,
    /// Shortest time.
    pub time: Duration,
}

/// A run on an image: it is copied behind its padding, then come the steps, then the logits are stretched.
struct Running<'a> {
    plan: &'a Plan,
    input: Input<'a>,
    output: SharedOutput,
}

impl Program for Running<'_> {
    fn chunks(&self, step: usize) -> usize {
        match step.checked_sub(1) {
            Some(step) if step < self.plan.steps.len() => self.plan.chunks(step),
            _ => self.plan.image.height.div_ceil(ROWS),
        }
    }
    fn run(&self, step: usize, chunk: usize) {
        match step.checked_sub(1) {
            None => self.plan.take_rows(&self.input, chunk),
            Some(step) if step < self.plan.steps.len() => self.plan.run_step(step, chunk),
            Some(_) => self.plan.give_rows(self.output, chunk),
        }
    }
}

impl Plan {
    /// Height and width of the images it takes, in pixels.
    pub fn size(&self) -> [usize; 2] {
        self.image.size()
    }

    /// Number of classes.
    pub fn classes(&self) -> usize {
        self.logits.channels
    }

    /// Bytes of its feature maps; weights come on top.
    pub fn memory(&self) -> usize {
        self.block.len() * size_of::<f32>()
    }

    fn chunks(&self, step: usize) -> usize {
        self.steps[step].chunks(self.isa, &self.block)
    }

    fn run_step(&self, step: usize, chunk: usize) {
        self.steps[step].run(self.isa, &self.block, chunk);
    }

    /// Both of the plan's size.
    fn run(&mut self, input: Input<'_>, mut output: Output<'_>) {
        let mut progress = std::mem::take(&mut self.progress);
        progress.resize_with(self.steps.len() + 2, Progress::default); // taken and lost if a run before panicked
        crew::run_program(&Running { plan: self, input, output: SharedOutput::of(&mut output) }, &mut progress);
        self.progress = progress;
    }

    /// The shortest time of each step in `rounds` runs on the last image, on all threads.
    pub fn profile(&mut self, rounds: usize) -> Vec<StepTime> {
        struct One<'a>(&'a Plan, usize);
        impl Program for One<'_> {
            fn chunks(&self, _: usize) -> usize {
                self.0.chunks(self.1)
            }
            fn run(&self, _: usize, chunk: usize) {
                self.0.run_step(self.1, chunk);
            }
        }
        let mut progress = [Progress::default()];
        let mut best = vec![Duration::MAX; self.steps.len()];
        for _ in 0..rounds {
            for (step, best) in best.iter_mut().enumerate() {
                let start = Instant::now();
                crew::run_program(&One(self, step), &mut progress);
                *best = start.elapsed().min(*best);
            }
        }
        let steps = self.names.iter().zip(&self.steps).zip(best);
        let time = |((name, step), time): ((&String, &Step), Duration)| StepTime {
            name: name.clone(),
            multiplications: step.operations(),
            time,
        };
        steps.map(time).collect()
    }
}

#[cfg(test)]
mod tests;
