//! A training's numbers in files.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::TrainEvent;
use super::curves::Curves;
use crate::weights::write;
use crate::{Error, Result};

/// Name of the file of numbers.
const LINES: &str = "metrics.jsonl";
/// Name of the drawing.
const DRAWING: &str = "curves.svg";

/// Writes the numbers of a training into a folder as it goes on: `metrics.jsonl`, a line of JSON per step and per
/// validation, each written out at once, and `curves.svg`, drawn again with each checkpoint and each epoch.
///
/// A resumed training goes on with its log: lines of steps after the checkpoint are cut off, so that the log is that of
/// an unbroken training but for the times. A fresh training starts the log anew.
///
/// ```no_run
/// # use std::{ops::ControlFlow, path::Path};
/// # fn train(on_event: impl FnMut(&segnet::TrainEvent) -> ControlFlow<()>) {}
/// let mut log = segnet::MetricsLog::new(Path::new("run"))?;
/// let mut failed = None;
/// train(|event| match log.record(event) {
///     Ok(()) => ControlFlow::Continue(()),
///     Err(error) => {
///         failed = Some(error);
///         ControlFlow::Break(())
///     }
/// });
/// # Ok::<(), segnet::Error>(())
/// ```
#[derive(Debug)]
pub struct MetricsLog {
    folder: PathBuf,
    /// Open after the first event.
    file: Option<File>,
    curves: Curves,
}

/// A line of the file. `step` counts from 0 over all epochs; a validation stands with the step that it follows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Line {
    Step { step: u64, epoch: u64, loss: f32, learning_rate: f64, gradient_norm: f64, seconds: f64 },
    Validated { step: u64, epoch: u64, iou: f64, mean_image_iou: Option<f64>, is_best: bool, seconds: f64 },
}

impl Line {
    fn of(event: &TrainEvent) -> Option<Self> {
        match *event {
            TrainEvent::Step { step, epoch, loss, learning_rate, gradient_norm, spent } => {
                Some(Self::Step { step, epoch, loss, learning_rate, gradient_norm, seconds: spent.as_secs_f64() })
            }
            TrainEvent::Validated { step, epoch, iou, mean_image_iou, is_best, spent, .. } => {
                Some(Self::Validated { step, epoch, iou, mean_image_iou, is_best, seconds: spent.as_secs_f64() })
            }
            _ => None,
        }
    }

    fn step(&self) -> u64 {
        match self {
            Self::Step { step, .. } | Self::Validated { step, .. } => *step,
        }
    }

    fn draw(&self, curves: &mut Curves) {
        match *self {
            Self::Step { step, loss, learning_rate, .. } => curves.add_step(step, f64::from(loss), learning_rate),
            Self::Validated { step, iou, .. } => curves.add_validation(step, iou),
        }
    }
}

impl MetricsLog {
    /// A log in an existing folder.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if there is no such folder.
    pub fn new(folder: &Path) -> Result<Self> {
        std::fs::read_dir(folder).map_err(|source| Error::Io { path: folder.to_owned(), source })?;
        Ok(Self { folder: folder.to_owned(), file: None, curves: Curves::default() })
    }

    /// Takes an event of [`train`](crate::train) or [`resume`](crate::resume). Give it all of them, from the first.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if a file cannot be read or written; [`Error::Format`] if the log of a resumed training holds a
    /// line that is no line of a log.
    pub fn record(&mut self, event: &TrainEvent) -> Result<()> {
        match event {
            TrainEvent::Started { first_step, .. } => self.start(*first_step),
            TrainEvent::Checkpoint { .. } | TrainEvent::Epoch { .. } => self.draw(),
            _ => Line::of(event).map_or(Ok(()), |line| self.add(&line)),
        }
    }

    fn path(&self) -> PathBuf {
        self.folder.join(LINES)
    }

    fn io(&self) -> impl Fn(std::io::Error) -> Error + use<> {
        let path = self.path();
        move |source| Error::Io { path: path.clone(), source }
    }

    /// Keeps the lines of the steps before `first_step` and opens the file behind them.
    fn start(&mut self, first_step: u64) -> Result<()> {
        self.curves = Curves::default();
        let kept = if first_step == 0 { String::new() } else { self.kept(first_step)? };
        write(&self.path(), kept.as_bytes())?;
        self.file = Some(OpenOptions::new().append(true).open(self.path()).map_err(self.io())?);
        Ok(())
    }

    /// The text of these lines, which also go into the drawing. What follows the last line break is of a line that was
    /// being written when the training was killed.
    fn kept(&mut self, first_step: u64) -> Result<String> {
        let path = self.path();
        if !path.exists() {
            return Ok(String::new());
        }
        let mut text = std::fs::read_to_string(&path).map_err(self.io())?;
        text.truncate(text.rfind('\n').map_or(0, |end| end + 1));
        let mut kept = String::new();
        for (number, row) in text.lines().enumerate() {
            let wrong = |error| Error::Format { path: path.clone(), reason: format!("line {}: {error}", number + 1) };
            let line: Line = serde_json::from_str(row).map_err(wrong)?;
            if line.step() < first_step {
                line.draw(&mut self.curves);
                kept.push_str(row);
                kept.push('\n');
            }
        }
        Ok(kept)
    }

    /// In one write, so that a line is there as a whole or as the torn last one.
    fn add(&mut self, line: &Line) -> Result<()> {
        line.draw(&mut self.curves);
        let mut text = serde_json::to_string(line).map_err(|error| Error::Burn(error.to_string()))?;
        text.push('\n');
        let io = self.io();
        match &mut self.file {
            Some(file) => file.write_all(text.as_bytes()).map_err(io),
            None => Err(io(std::io::Error::other("the first event must be the training's first"))),
        }
    }

    fn draw(&self) -> Result<()> {
        write(&self.folder.join(DRAWING), self.curves.svg().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn started(first_step: u64) -> TrainEvent {
        let (class_weights, config_digest) = (vec![1.0, 2.0], String::new());
        TrainEvent::Started { class_weights, steps_per_epoch: 4, first_step, config_digest }
    }

    fn step(step: u64) -> TrainEvent {
        let spent = Duration::from_millis(10 * step);
        TrainEvent::Step { step, epoch: step / 4, loss: 1.5, learning_rate: 1e-3, gradient_norm: 0.25, spent }
    }

    fn lines(folder: &Path) -> Vec<Line> {
        let text = std::fs::read_to_string(folder.join(LINES)).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    fn steps(folder: &Path) -> Vec<u64> {
        lines(folder).iter().map(Line::step).collect()
    }

    #[test]
    fn a_resumed_log_goes_on_where_the_checkpoint_stands() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = MetricsLog::new(folder.path()).unwrap();
        for event in [started(0), step(0), step(1), step(2)] {
            log.record(&event).unwrap();
        }
        assert_eq!(steps(folder.path()), [0, 1, 2]);
        let torn = r#"{"event":"step","step":3,"epo"#;
        OpenOptions::new().append(true).open(log.path()).unwrap().write_all(torn.as_bytes()).unwrap();
        let mut log = MetricsLog::new(folder.path()).unwrap();
        for event in [started(2), step(2), step(3)] {
            log.record(&event).unwrap();
        }
        assert_eq!(steps(folder.path()), [0, 1, 2, 3]);
        log.record(&TrainEvent::Checkpoint { steps: 4, path: PathBuf::new() }).unwrap();
        assert!(folder.path().join(DRAWING).exists());
        MetricsLog::new(folder.path()).unwrap().record(&started(0)).unwrap();
        assert!(steps(folder.path()).is_empty(), "a fresh training starts anew");
    }

    #[test]
    fn lines_hold_what_the_event_told() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = MetricsLog::new(folder.path()).unwrap();
        log.record(&started(0)).unwrap();
        log.record(&step(5)).unwrap();
        let text = std::fs::read_to_string(folder.path().join(LINES)).unwrap();
        let expected = r#"{"event":"step","step":5,"epoch":1,"loss":1.5,"learning_rate":0.001,"gradient_norm":0.25,"seconds":0.05}"#;
        assert_eq!(text, format!("{expected}\n"));
    }

    #[test]
    fn wrong_folders_files_and_orders_are_refused() {
        assert!(matches!(MetricsLog::new(Path::new("no/such")), Err(Error::Io { .. })));
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(LINES), "hello\n").unwrap();
        let mut log = MetricsLog::new(folder.path()).unwrap();
        assert!(log.record(&step(0)).is_err(), "a step before the start");
        let error = log.record(&started(7)).unwrap_err();
        assert!(matches!(error, Error::Format { .. }) && error.to_string().contains("line 1"), "{error}");
    }
}
