//! Bars for people, a line now and then for log files.

use std::ops::ControlFlow;
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use posepipe::{TeachEvent, segnet::TrainEvent};

use super::say::complain;

/// A bar named `what` over `total` items; invisible when standard error is no terminal.
pub(crate) fn bar(what: &'static str, total: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix:>9} [{bar:40}] {pos}/{len} {msg} (eta {eta})")
        .map_or_else(|_| ProgressStyle::default_bar(), |style| style.progress_chars("=> "));
    ProgressBar::new(total).with_style(style).with_prefix(what)
}

/// Shows what a teaching does.
pub(crate) struct TeachProgress {
    bar: ProgressBar,
    stage: &'static str,
    start: Instant,
    steps: u64,
}

impl TeachProgress {
    /// For a training of `steps` steps.
    pub(crate) fn new(steps: u64) -> Self {
        Self { bar: ProgressBar::hidden(), stage: "", start: Instant::now(), steps }
    }

    pub(crate) fn show(&mut self, event: &TeachEvent<'_>) -> ControlFlow<()> {
        match event {
            TeachEvent::Cropped { done, total } => self.advance("crop", *done as u64, *total as u64),
            TeachEvent::Modelled { points } => self.line(&format!("model cloud: {points} points")),
            TeachEvent::Previewed { iou, seconds, .. } => {
                let iou = iou.map_or(String::new(), |iou| format!(", held-out IoU {iou:.3}"));
                self.line(&format!("preview fitted in {seconds:.1} s{iou}"));
            }
            TeachEvent::NotPreviewed { error } => self.line(&format!("no preview: {error}")),
            TeachEvent::Training(event) => self.training(event),
            _ => {}
        }
        ControlFlow::Continue(())
    }

    pub(crate) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn training(&mut self, event: &TrainEvent) {
        match event {
            TrainEvent::Step { step, loss, .. } => {
                self.advance("train", step + 1, self.steps);
                self.bar.set_message(format!("loss {loss:.3}"));
            }
            TrainEvent::Validated { step, iou, best, .. } => {
                self.line(&format!("step {}: held-out IoU {iou:.3}, best {:.3}", step + 1, best.iou));
            }
            TrainEvent::Epoch { epoch, mean_loss, .. } => {
                self.line(&format!("epoch {}: mean loss {mean_loss:.4}", epoch + 1));
            }
            _ => {}
        }
    }

    fn advance(&mut self, stage: &'static str, done: u64, total: u64) {
        if self.stage != stage {
            self.bar.finish_and_clear();
            self.bar = bar(stage, total);
            self.stage = stage;
        }
        self.bar.set_position(done);
    }

    fn line(&self, text: &str) {
        let text = format!("{:7.1} s  {text}", self.start.elapsed().as_secs_f64());
        self.bar.suspend(|| complain(&text));
    }
}
