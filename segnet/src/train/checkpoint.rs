//! One file with all that a training needs to go on.

use std::path::{Path, PathBuf};
use std::time::Duration;

use burn::module::Module;
use burn::optim::{ModuleOptimizer, OptimizerRecord};
use burn::tensor::{Bytes, Device};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::TrainConfig;
use super::digest::Fnv1a;
use super::validation::Record;
use crate::weights::{Renaming, TensorFile, encode, write};
use crate::{BiSeNet, BiSeNetConfig, Error, Kernels, Result};

/// Name of the file in the checkpoint folder.
const FILE: &str = "checkpoint.safetensors";
/// Name of Adam's state among the tensors.
const OPTIMIZER: &str = "optimizer";
/// Raised when the content changes its meaning.
const VERSION: u32 = 2;

/// A number that is stored by its bits: decimal places, as `serde_json` reads them, may be off in the last bit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "u64", into = "u64")]
pub(super) struct Exact(pub(super) f64);

impl From<u64> for Exact {
    fn from(bits: u64) -> Self {
        Self(f64::from_bits(bits))
    }
}

impl From<Exact> for u64 {
    fn from(Exact(value): Exact) -> Self {
        value.to_bits()
    }
}

/// Where a training stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Standing {
    version: u32,
    pub(super) net: BiSeNetConfig,
    /// Width and batch-norm epsilon of `net`.
    net_numbers: [Exact; 2],
    kernels: Kernels,
    config: TrainConfig,
    class_weights: Vec<Exact>,
    /// Steps done.
    pub(super) step: u64,
    /// Samples learned from.
    pub(super) samples: u64,
    /// Fingerprint of these samples, in their order.
    pub(super) samples_digest: u64,
    pub(super) spent: Duration,
    /// Sum of the losses of the epoch's steps so far.
    epoch_loss: Exact,
    pub(super) validated: Option<Record>,
}

impl Standing {
    pub(super) fn new(net: &BiSeNet, config: &TrainConfig, class_weights: &[f64]) -> Self {
        Self {
            version: VERSION,
            net: net.config().clone(),
            net_numbers: [net.config().width, net.config().batch_norm_epsilon].map(Exact),
            kernels: net.kernels(),
            config: without_folder(config),
            class_weights: class_weights.iter().copied().map(Exact).collect(),
            step: 0,
            samples: 0,
            samples_digest: Fnv1a::new().value(),
            spent: Duration::ZERO,
            epoch_loss: Exact(0.0),
            validated: None,
        }
    }

    /// The network's settings with their numbers as they were.
    fn exact_net(&self) -> BiSeNetConfig {
        let [width, batch_norm_epsilon] = self.net_numbers.map(|number| number.0);
        BiSeNetConfig { width, batch_norm_epsilon, ..self.net.clone() }
    }

    /// What no training under `config` could have left.
    fn impossible(&self, config: &TrainConfig) -> Option<String> {
        if self.step > config.steps() || Some(self.samples) != self.step.checked_mul(config.batch as u64) {
            return Some(format!("it counts {} samples in {} steps", self.samples, self.step));
        }
        let weights: Vec<f64> = self.class_weights().collect();
        let positive = weights.iter().all(|weight| weight.is_finite() && *weight > 0.0);
        (weights.len() != self.net.classes || !positive)
            .then(|| format!("its class weights are {weights:?} for {} classes", self.net.classes))
    }

    /// Counts a step that learned from samples of these fingerprints.
    pub(super) fn count_step(&mut self, loss: f32, samples: &[u64]) {
        self.step += 1;
        self.samples += samples.len() as u64;
        let chain = |digest: Fnv1a, sample: &u64| digest.and(&sample.to_le_bytes());
        self.samples_digest = samples.iter().fold(Fnv1a::from_state(self.samples_digest), chain).value();
        self.epoch_loss.0 += f64::from(loss);
    }

    /// Mean loss of the epoch that has just ended; the next one starts.
    pub(super) fn take_mean_loss(&mut self) -> f32 {
        let sum = std::mem::replace(&mut self.epoch_loss, Exact(0.0));
        (sum.0 / self.config.steps_per_epoch() as f64) as f32
    }

    /// Fingerprint of all settings.
    pub(super) fn config_digest(&self) -> Fnv1a {
        Fnv1a::new().and_json(&self.net).and_json(&self.config)
    }

    pub(super) fn class_weights(&self) -> impl Iterator<Item = f64> {
        self.class_weights.iter().map(|weight| weight.0)
    }
}

/// The networks of a checkpoint, on a plain device.
#[derive(Module, Debug)]
pub(super) struct Networks {
    pub(super) last: BiSeNet,
    /// The one that validated best.
    pub(super) best: Option<BiSeNet>,
}

pub(super) fn path_in(folder: &Path) -> PathBuf {
    folder.join(FILE)
}

fn without_folder(config: &TrainConfig) -> TrainConfig {
    TrainConfig { checkpoint_dir: None, ..config.clone() }
}

/// Writes the checkpoint over the previous one, which stands until the new one is complete.
pub(super) fn save(path: &Path, networks: &Networks, optimizer: &ModuleOptimizer, standing: &Standing) -> Result<()> {
    let description = serde_json::to_string(standing).map_err(|error| Error::Burn(error.to_string()))?;
    let state = optimizer.into_bytes().map_err(|error| Error::Burn(error.to_string()))?;
    // Under the names of the module tree: nobody but this program reads them.
    write(path, &encode(networks, &Renaming::none(), &[(OPTIMIZER, &state)], description)?)
}

/// Reads a checkpoint that was written under the same configuration.
pub(super) fn load(
    path: &Path,
    config: &TrainConfig,
    optimizer: ModuleOptimizer,
    device: &Device,
) -> Result<(Networks, ModuleOptimizer, Standing)> {
    let file = TensorFile::read(path)?;
    let description: Value = serde_json::from_str(&file.description()?)
        .map_err(|error| file.wrong(format!("its description is no JSON: {error}")))?;
    if let Some(version) = description.get("version").filter(|version| **version != VERSION) {
        return Err(file.wrong(format!("its version is {version}, this program reads {VERSION}")));
    }
    let standing: Standing = serde_json::from_value(description)
        .map_err(|error| file.wrong(format!("its description is no checkpoint's: {error}")))?;
    let differences = differences(&standing.config, config)?;
    if !differences.is_empty() {
        return Err(Error::ConfigChanged { path: path.to_owned(), differences });
    }
    if let Some(reason) = standing.impossible(config) {
        return Err(file.wrong(reason));
    }
    let net = standing.exact_net();
    let fresh = || Ok::<_, Error>(net.init(device)?.with_kernels(standing.kernels));
    // Two networks from the start: copies of a module share their running statistics.
    let best = standing.validated.map(|_| fresh()).transpose()?;
    let mut networks = Networks { last: fresh()?, best };
    file.check(&networks, &Renaming::none(), |name| name == OPTIMIZER)?;
    let record = OptimizerRecord::from_bytes(Bytes::from_bytes_vec(file.blob(OPTIMIZER)?));
    let record = record.map_err(|error| file.wrong(format!("its optimizer state: {error}")))?;
    file.load_into(&mut networks, &Renaming::none())?;
    // Rounded once when it was written, the stored configuration would be rounded again with the next checkpoint.
    let standing = Standing { config: without_folder(config), net, ..standing };
    Ok((networks, optimizer.load_record(record), standing))
}

/// One line per field that differs.
fn differences(stored: &TrainConfig, given: &TrainConfig) -> Result<Vec<String>> {
    let wrong = |error: serde_json::Error| Error::Burn(error.to_string());
    // Through the same text as the stored one.
    let given = serde_json::to_string(&without_folder(given)).map_err(wrong)?;
    let given: TrainConfig = serde_json::from_str(&given).map_err(wrong)?;
    let [stored, given] = [stored, &given].map(|config| match serde_json::to_value(config) {
        Ok(Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    });
    let differs = |(name, value): (&String, &Value)| {
        let other = given.get(name).unwrap_or(&Value::Null);
        (value != other).then(|| format!("{name} was {value}, is now {other}"))
    };
    Ok(stored.iter().filter_map(differs).collect())
}

/// The checkpoint that `path`, a file or a folder, means.
pub(super) fn find(path: &Path) -> Result<PathBuf> {
    let file = if path.is_dir() { path_in(path) } else { path.to_owned() };
    if file.exists() {
        return Ok(file);
    }
    // What of the path does exist; an empty path means the working folder.
    let ancestors = path.ancestors().map(|folder| if folder.as_os_str().is_empty() { Path::new(".") } else { folder });
    let nearest = ancestors.into_iter().find(|folder| folder.is_dir());
    Err(Error::NoCheckpoint { path: file, nearby: nearest.map(checkpoints_in).unwrap_or_default() })
}

/// Checkpoints in a folder and in the folders in it, by name.
fn checkpoints_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> = entries.map(|entry| path_in(&entry.path())).collect();
    found.push(path_in(folder));
    found.retain(|path| path.is_file());
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A third of a number is where decimal places go wrong first; the bits never do.
    #[test]
    fn numbers_survive_a_checkpoint_to_the_last_bit() {
        for value in (1..2000).map(|i| 1.0 / f64::from(i)).chain([f64::MIN_POSITIVE, -0.0, 1e300]) {
            let text = serde_json::to_string(&Exact(value)).unwrap();
            let back: Exact = serde_json::from_str(&text).unwrap();
            assert_eq!(back.0.to_bits(), value.to_bits());
        }
    }

    /// Rates that a text does not hold exactly are no change of the configuration.
    #[test]
    fn a_configuration_does_not_differ_from_itself() {
        for i in 1..2000 {
            let config = TrainConfig { learning_rate: 1.0 / f64::from(i), ..TrainConfig::default() };
            let stored: TrainConfig = serde_json::from_str(&serde_json::to_string(&config).unwrap()).unwrap();
            assert!(differences(&stored, &config).unwrap().is_empty(), "1/{i}");
        }
    }
}
