//! What a network is taught from, which network, and how.

use std::collections::BTreeMap;
use std::path::Path;

use segnet::{BiSeNetConfig, ClassBalance, TrainConfig};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use synth::SynthConfig;

use crate::object_folder::write_text;
use crate::{Error, Result};

/// What makes a taught network what it is, beside captures and backgrounds: composition of the samples, network and
/// training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Composition of the training samples. The sizes of camera and network and the range of scales are filled in from
    /// the captures and the training.
    pub synth: SynthConfig,
    /// The network. Padding and epsilon are filled in from the pretrained weights.
    pub network: BiSeNetConfig,
    /// Its training. The normalization is filled in from the pretrained weights.
    pub train: TrainConfig,
    /// Decoys made from the object's crops, see [`synth::decoys`]; as many distractors as `synth.distractors` says are
    /// drawn from them for each sample. 0 = none.
    pub decoys: usize,
    /// Share of the samples that are cut-outs of the captures themselves, labelled by the masks that depth has given.
    pub capture_share: f64,
    /// Probability, against the background, above which a pixel is the object's: see
    /// [`Segmenter::with_threshold`](segnet::Segmenter::with_threshold). It is put into the trained network; what a training
    /// measures on held-out frames is without it.
    pub threshold: f64,
    /// Probability, behind the threshold, that a part of the mask must reach somewhere or be left out: see
    /// [`Segmenter::with_peak`](segnet::Segmenter::with_peak). 0 = all parts stay, as they do if the network
    /// reaches it in fewer than nine of ten fresh samples with the object. Held-out images are measured without it, too.
    pub peak: f64,
    /// Training samples that a [`Preview`](segnet::Preview) is fitted to before the training, if there are pretrained
    /// weights; 0 = no preview.
    pub preview_samples: u64,
}

impl Default for Recipe {
    fn default() -> Self {
        Self::five_minutes()
    }
}

impl Recipe {
    /// About five minutes on two cores with MobileNetV2 at 288x160: 5,600 samples.
    ///
    /// Beyond the paper's composition, a fifth of the samples are the captures themselves, decoys made from the crops are
    /// scattered, more of them than objects, and brightness and contrast vary as lights do. The loss weighs the object less
    /// than by inverse frequency, the network must be surer of it than of the background, and every part of its mask must
    /// be all but certain somewhere: what it takes in wrongly are parts of things that resemble the object.
    #[must_use]
    pub fn five_minutes() -> Self {
        let full = Self::full();
        Self { train: TrainConfig { samples_per_epoch: 560, ..full.train }, ..full }
    }

    /// The same with as many samples as the paper's training: 50,000.
    #[must_use]
    pub fn full() -> Self {
        let paper = Self::paper();
        Self {
            synth: SynthConfig {
                brightness: (-0.1, 0.1),
                contrast: (-0.2, 0.2),
                objects: (0, 2),
                distractors: (0, 3),
                ..paper.synth
            },
            decoys: 200,
            capture_share: 0.2,
            threshold: 0.6,
            peak: 0.97,
            train: TrainConfig { class_balance: ClassBalance::InverseSquareRoot, ..TrainConfig::default() },
            ..paper
        }
    }

    /// What Haarslev et al. 2020 state: Gaussian and Poisson blending, ten epochs of 5,000 samples, Adam at 1e-3.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            synth: SynthConfig::default(),
            network: BiSeNetConfig::default(),
            train: TrainConfig::paper(),
            decoys: 0,
            capture_share: 0.0,
            threshold: 0.5,
            peak: 0.0,
            preview_samples: 64,
        }
    }

    /// The recipe of this name: `five-minutes`, `full` or `paper`.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "five-minutes" => Some(Self::five_minutes()),
            "full" => Some(Self::full()),
            "paper" => Some(Self::paper()),
            _ => None,
        }
    }

    /// Refuses distractors that no sample shows, and samples with distractors where there are none: neither decoys nor,
    /// by the caller's word, photographed ones. Everything else is checked where it is used.
    pub(crate) fn validate(&self, photographed: bool) -> Result<()> {
        if !(self.threshold > 0.0 && self.threshold < 1.0) {
            return Err(Error::Invalid(format!("threshold {}: must be above 0 and below 1", self.threshold)));
        }
        if !(0.0..1.0).contains(&(self.peak as f32)) {
            return Err(Error::Invalid(format!("peak {}: must be from 0 to below 1", self.peak)));
        }
        if (self.decoys > 0 || photographed) == (self.synth.distractors.1 > 0) {
            return Ok(());
        }
        let photographed = if photographed { "photographed distractors" } else { "no photographed distractors" };
        Err(Error::Invalid(format!(
            "{photographed} and {} decoys, but {:?} distractors in a sample: `synth.distractors` must be (0, 0) without \
             them and more with them",
            self.decoys, self.synth.distractors
        )))
    }

    /// Reads a recipe from JSON. Fields that are left out, also of `synth`, `network` and `train`, are as in
    /// [`Recipe::five_minutes`].
    ///
    /// # Errors
    ///
    /// [`Error::Io`] or [`Error::Json`] with the file; the latter for a field that no recipe has, too.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
        let parsed = || {
            let given: BTreeMap<String, Value> = serde_json::from_str(&text)?;
            let mut recipe = serde_json::to_value(Self::default())?;
            for (name, value) in given {
                match (recipe.get_mut(&name), value) {
                    (Some(Value::Object(fields)), Value::Object(given)) => fields.extend(given),
                    (_, value) => recipe[name] = value,
                }
            }
            serde_json::from_value(recipe)
        };
        parsed().map_err(Error::json(path))
    }

    /// Writes the recipe as JSON, with every field but the folder for checkpoints, which belongs to one training.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let train = TrainConfig { checkpoint_dir: None, ..self.train.clone() };
        let portable = Self { train, ..self.clone() };
        let mut text = serde_json::to_string_pretty(&portable).map_err(Error::json(path))?;
        text.push('\n');
        write_text(path, &text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recipes_have_names() {
        assert_eq!(Recipe::named("five-minutes"), Some(Recipe::default()));
        let samples = |name| Recipe::named(name).map(|recipe| recipe.train.epochs * recipe.train.samples_per_epoch);
        assert_eq!(
            ["five-minutes", "full", "paper", "Paper"].map(samples),
            [Some(5600), Some(50_000), Some(50_000), None]
        );
    }

    #[test]
    fn a_recipe_is_read_as_it_was_written_and_misspelt_fields_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recipe.json");
        Recipe::paper().write(&path).unwrap();
        assert_eq!(Recipe::read(&path).unwrap(), Recipe::paper());
        write_text(&path, r#"{"train": {"epochs": 3}}"#).unwrap();
        let default = Recipe::default();
        let expected = Recipe { train: TrainConfig { epochs: 3, ..default.train.clone() }, ..default };
        assert_eq!(Recipe::read(&path).unwrap(), expected);
        write_text(&path, r#"{"train": {"epoch": 3}}"#).unwrap();
        let error = Recipe::read(&path).unwrap_err().to_string();
        assert!(error.contains("recipe.json") && error.contains("epoch"), "{error}");
        write_text(&path, r#"{"trian": {}}"#).unwrap();
        assert!(Recipe::read(&path).unwrap_err().to_string().contains("trian"));
        let without = Recipe { decoys: 0, ..Recipe::default() };
        assert!(without.validate(false).is_err() && without.validate(true).is_ok());
        assert!(Recipe { threshold: 1.0, ..Recipe::default() }.validate(false).is_err());
        assert!(Recipe { threshold: f64::NAN, ..Recipe::default() }.validate(false).is_err());
        assert!(Recipe { peak: 1.0, ..Recipe::default() }.validate(false).is_err());
        // Is 1 in single precision.
        assert!(Recipe { peak: 1.0 - 1e-12, ..Recipe::default() }.validate(false).is_err());
        assert!(Recipe { peak: f64::NAN, ..Recipe::default() }.validate(false).is_err());
        assert!(Recipe { decoys: 9, ..Recipe::paper() }.validate(false).is_err());
        assert!(Recipe::paper().validate(false).is_ok() && Recipe::paper().validate(true).is_err());
        assert!(Recipe::default().validate(false).is_ok() && Recipe::default().validate(true).is_ok());
        write_text(&path, "[]").unwrap();
        assert!(Recipe::read(&path).is_err());
    }
}
