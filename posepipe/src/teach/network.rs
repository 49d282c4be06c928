//! The network's part of teaching: preview, training, log.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use segnet::{
    BestValidation, BiSeNet, BiSeNetConfig, ClassBalance, Device, MetricsLog, PreviewConfig, Segmenter, Stop,
    TrainConfig, TrainEvent, ValidationConfig, train_preview,
};
use serde_json::json;
use sha2::{Digest as _, Sha256};
use synth::Synthesizer;

use super::held_out::HeldOutFrames;
use super::{Pretrained, TeachConfig, TeachEvent, stop_if};
use crate::{Error, Result};

/// Fresh samples with the object by which a trained network is judged.
const JUDGED: usize = 64;
/// Share of these in which it must reach the peak.
const SURE: f64 = 0.9;

/// How a training went.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingRun {
    /// Samples learned from.
    pub samples: u64,
    /// Fingerprint of settings, samples and network: the same one, the same training to the last bit.
    pub digest: String,
    /// The validation that chose the network, if frames were held out.
    pub best: Option<BestValidation>,
    /// Why it ended.
    pub stop: Stop,
    /// Where its checkpoint, `metrics.jsonl` and `curves.svg` are, if a folder was given.
    pub folder: Option<PathBuf>,
}

/// Everything that a training starts from.
struct Start {
    net: BiSeNet,
    train: TrainConfig,
    held_out: Option<HeldOutFrames>,
}

/// Calls back with every event.
type OnEvent<'a> = &'a mut dyn FnMut(&TeachEvent<'_>) -> ControlFlow<()>;

/// Shows a preview and trains.
pub(super) fn train_network(
    synthesizer: &Synthesizer,
    config: &TeachConfig,
    on_event: OnEvent<'_>,
) -> Result<(Segmenter, TrainingRun)> {
    let start = start(synthesizer, config)?;
    show_preview(&start, synthesizer, config, on_event)?;
    let folder = start.train.checkpoint_dir.clone();
    let mut log = folder.as_deref().map(MetricsLog::new).transpose()?;
    let mut record = |event: &TrainEvent| -> Result<()> {
        // Once the checkpoint that may be there has turned out to be of the same training.
        if let (TrainEvent::Started { .. }, Some(folder)) = (event, &folder) {
            config.recipe.write(&folder.join("recipe.json"))?;
        }
        Ok(log.as_mut().map_or(Ok(()), |log| log.record(event))?)
    };
    let mut failure = None;
    let trained = train(start, synthesizer, &mut |event| match record(event) {
        Ok(()) => on_event(&TeachEvent::Training(event)),
        Err(error) => {
            failure = Some(error);
            ControlFlow::Break(())
        }
    })?;
    if let Some(error) = failure {
        return Err(error);
    }
    if trained.stop == Stop::Asked {
        return Err(Error::Stopped);
    }
    let run = TrainingRun {
        samples: trained.samples,
        digest: trained.digest.clone(),
        best: trained.best,
        stop: trained.stop,
        folder,
    };
    let segmenter = trained.into_segmenter()?.with_threshold(config.recipe.threshold)?;
    let peak = if reaches(&segmenter, synthesizer, &run, config.recipe.peak)? { config.recipe.peak } else { 0.0 };
    Ok((segmenter.with_peak(peak)?, run))
}

/// Whether the network is sure enough of its object for a peak: of samples that it has not learned from, those after its
/// last one, nearly all have a pixel of the object that reaches it. One that has learned for a short time is sure of
/// nothing, and would find nothing.
fn reaches(segmenter: &Segmenter, synthesizer: &Synthesizer, run: &TrainingRun, peak: f64) -> Result<bool> {
    if peak == 0.0 {
        return Ok(true);
    }
    let mut highest = Vec::with_capacity(JUDGED);
    // Few samples show no object; far more than there ought to be are an end as well.
    for index in run.samples..run.samples + 10 * JUDGED as u64 {
        let (image, label) = sample(synthesizer, index)?;
        let found = segmenter.segment(&image)?;
        let on_object = found.foreground.iter().zip(label.iter()).filter(|(_, class)| **class > 0);
        highest.extend(on_object.map(|(probability, _)| *probability).reduce(f32::max));
        if highest.len() == JUDGED {
            break;
        }
    }
    let sure = highest.iter().filter(|probability| f64::from(**probability) >= peak).count();
    Ok(!highest.is_empty() && sure as f64 >= SURE * highest.len() as f64)
}

fn start(synthesizer: &Synthesizer, config: &TeachConfig) -> Result<Start> {
    let mut network = config.recipe.network.clone();
    let mut train = config.recipe.train.clone();
    if let Some(Pretrained { description, .. }) = &config.pretrained {
        // The weights only mean something under the conditions they were trained in.
        network.padding = description.padding;
        network.batch_norm_epsilon = description.batch_norm_epsilon;
        train.normalization = description.normalization;
    }
    let held_out = config.held_out.as_ref().map(HeldOutFrames::list).transpose()?;
    match (&mut train.validation, &held_out) {
        (Some(validation), Some(frames)) => validation.images = validation.images.min(frames.len()),
        (none, Some(frames)) => *none = Some(ValidationConfig { images: frames.len(), ..ValidationConfig::default() }),
        (Some(_), None) => {
            return Err(Error::Invalid("the recipe asks for validation, but no frames are held out".into()));
        }
        (None, None) => {}
    }
    if let Some(folder) = &config.recipe.train.checkpoint_dir {
        let own = run_folder(folder, synthesizer, &network, config, held_out.as_ref())?;
        train.checkpoint_dir = Some(own);
    }
    Ok(Start { net: initial_network(&network, config.pretrained.as_ref())?, train, held_out })
}

/// The network before its training: random, or with the backbone it is given.
fn initial_network(config: &BiSeNetConfig, pretrained: Option<&Pretrained>) -> Result<BiSeNet> {
    let mut network = config.init(&Device::flex())?;
    if let Some(Pretrained { path, description }) = pretrained {
        segnet::load_backbone(&mut network, path, description)?;
    }
    Ok(network)
}

/// A folder of its own for what trains this network on these samples: a checkpoint of others must not be gone on from.
/// The training's own settings are the checkpoint's to compare.
fn run_folder(
    folder: &Path,
    synthesizer: &Synthesizer,
    network: &BiSeNetConfig,
    config: &TeachConfig,
    held_out: Option<&HeldOutFrames>,
) -> Result<PathBuf> {
    let pretrained = config.pretrained.as_ref().map(|pretrained| weights_digest(&pretrained.path)).transpose()?;
    let held_out = held_out.map(HeldOutFrames::digest).transpose()?;
    let what = json!([format!("{:016x}", synthesizer.digest()), network, pretrained, held_out]);
    let own = folder.join(digest(what.to_string().as_bytes()));
    std::fs::create_dir_all(&own).map_err(Error::io(&own))?;
    Ok(own)
}

fn weights_digest(path: &Path) -> Result<String> {
    Ok(digest(&std::fs::read(path).map_err(Error::io(path))?))
}

/// The first 16 hexadecimal digits of the SHA-256.
fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().take(8).fold(String::new(), |digits, byte| digits + &format!("{byte:02x}"))
}

/// Fits the preview and shows it, if the features are worth one. Two of three samples are photos as they are, if there are
/// any: a fit in closed form has no time to learn what tells compositions from them.
fn show_preview(start: &Start, synthesizer: &Synthesizer, config: &TeachConfig, on_event: OnEvent<'_>) -> Result<()> {
    let samples = config.recipe.preview_samples;
    if samples == 0 || config.pretrained.is_none() {
        return Ok(());
    }
    let begin = Instant::now();
    let Start { net, train, held_out } = start;
    let settings = PreviewConfig {
        width: train.width,
        height: train.height,
        samples,
        // A line fitted to weighted classes takes in whatever lies around an object.
        class_balance: ClassBalance::Fixed(vec![1.0; net.config().classes]),
        ignore_label: train.ignore_label,
        normalization: train.normalization,
        ..PreviewConfig::default()
    };
    let photos = synthesizer.photos();
    let mixed = |index: u64| match previewed_photo(index, samples, photos.len() as u64) {
        Some(photo) => Ok((photos[photo as usize].image.clone(), photos[photo as usize].label.clone())),
        None => sample(synthesizer, index),
    };
    let preview = match train_preview(net, &settings, mixed) {
        Ok(preview) => preview,
        Err(error) => return stop_if(on_event(&TeachEvent::NotPreviewed { error: &error.into() })),
    };
    let seconds = begin.elapsed().as_secs_f64();
    let iou = held_out.as_ref().map(|frames| frames.iou(&preview)).transpose()?.flatten();
    stop_if(on_event(&TeachEvent::Previewed { preview: &preview, iou, seconds }))
}

/// Which of `photos` photos, evenly spread, is sample `index` of `samples`; every third sample is composed.
fn previewed_photo(index: u64, samples: u64, photos: u64) -> Option<u64> {
    let shown = |samples: u64| samples - samples / 3;
    if index % 3 == 2 || photos == 0 {
        return None;
    }
    Some(if photos > shown(samples) { shown(index) * photos / shown(samples) } else { shown(index) % photos })
}

fn sample(synthesizer: &Synthesizer, index: u64) -> synth::Result<(image::RgbImage, image::GrayImage)> {
    synthesizer.sample(index).map(|sample| (sample.image, sample.label))
}

/// Trains, or goes on from the checkpoint that an earlier teaching has left.
fn train(
    start: Start,
    synthesizer: &Synthesizer,
    on_event: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
) -> segnet::Result<segnet::Trained> {
    let Start { net, train, held_out } = start;
    let sample = |index| sample(synthesizer, index);
    let fresh = match &held_out {
        Some(frames) => segnet::train_validated(net, &train, sample, |index| frames.load(index), &mut *on_event),
        None => segnet::train(net, &train, sample, &mut *on_event),
    };
    let Err(segnet::Error::CheckpointExists { path }) = fresh else { return fresh };
    let device = Device::flex();
    match &held_out {
        Some(frames) => segnet::resume_validated(&path, &train, &device, sample, |index| frames.load(index), on_event),
        None => segnet::resume(&path, &train, &device, sample, on_event),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn previews_see_photos_from_the_first_to_the_last() {
        let shown = |samples, photos| -> Vec<Option<u64>> {
            (0..samples).map(|index| previewed_photo(index, samples, photos)).collect()
        };
        assert_eq!(shown(7, 3), [Some(0), Some(1), None, Some(2), Some(0), None, Some(1)]);
        assert_eq!(shown(6, 400), [Some(0), Some(100), None, Some(200), Some(300), None]);
        assert_eq!(shown(2, 0), [None, None]);
        let distinct: std::collections::BTreeSet<u64> = shown(64, 60).into_iter().flatten().collect();
        assert_eq!((distinct.len(), distinct.last()), (43, Some(&58)));
    }
}
