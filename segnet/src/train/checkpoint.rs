//! One file with all that a training needs to go on.

use std::path::{Path, PathBuf};
use std::time::Duration;

use burn::module::Module;
use burn::optim::{ModuleOptimizer, OptimizerRecord};
use burn::tensor::{Bytes, Device};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::TrainConfig;
use crate::weights::{Renaming, TensorFile, encode, write};
use crate::{BiSeNet, BiSeNetConfig, Error, Result};

/// Name of the file in the checkpoint folder.
const FILE: &str = "checkpoint.safetensors";
/// Name of Adam's state among the tensors.
const OPTIMIZER: &str = "optimizer";
/// Raised when the content changes its meaning.
const VERSION: u32 = 1;

/// Where a training stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Standing {
    pub(super) version: u32,
    pub(super) net: BiSeNetConfig,
    pub(super) config: TrainConfig,
    pub(super) class_weights: Vec<f64>,
    /// Steps done.
    pub(super) step: u64,
    pub(super) spent: Duration,
}

impl Standing {
    pub(super) fn new(net: BiSeNetConfig, config: &TrainConfig, class_weights: Vec<f64>) -> Self {
        let config = TrainConfig { checkpoint_dir: None, ..config.clone() };
        Self { version: VERSION, net, config, class_weights, step: 0, spent: Duration::ZERO }
    }
}

pub(super) fn path_in(folder: &Path) -> PathBuf {
    folder.join(FILE)
}

/// Writes the checkpoint over the previous one, which stands until the new one is complete.
pub(super) fn save(path: &Path, net: &BiSeNet, optimizer: &ModuleOptimizer, standing: &Standing) -> Result<()> {
    let description = serde_json::to_string(standing).map_err(|error| Error::Burn(error.to_string()))?;
    let state = optimizer.into_bytes().map_err(|error| Error::Burn(error.to_string()))?;
    write(path, &encode(&net.valid(), &Renaming::own(), &[(OPTIMIZER, &state)], description)?)
}

/// Reads a checkpoint that was written under the same configuration.
pub(super) fn load(
    path: &Path,
    config: &TrainConfig,
    optimizer: ModuleOptimizer,
    device: &Device,
) -> Result<(BiSeNet, ModuleOptimizer, Standing)> {
    let file = TensorFile::read(path)?;
    let standing: Standing = serde_json::from_str(&file.description()?)
        .map_err(|error| file.wrong(format!("its description is no checkpoint's: {error}")))?;
    if standing.version != VERSION {
        return Err(file.wrong(format!("its version is {}, this program reads {VERSION}", standing.version)));
    }
    let differences = differences(&standing.config, &TrainConfig { checkpoint_dir: None, ..config.clone() });
    if !differences.is_empty() {
        return Err(Error::ConfigChanged { path: path.to_owned(), differences });
    }
    let mut net = standing.net.init(device)?;
    file.check(&net, &Renaming::own(), |name| name == OPTIMIZER)?;
    let record = OptimizerRecord::from_bytes(Bytes::from_bytes_vec(file.blob(OPTIMIZER)?));
    let record = record.map_err(|error| file.wrong(format!("its optimizer state: {error}")))?;
    file.load_into(&mut net, &Renaming::own())?;
    Ok((net, optimizer.load_record(record), standing))
}

/// One line per field that differs.
fn differences(stored: &TrainConfig, given: &TrainConfig) -> Vec<String> {
    let fields = |config: &TrainConfig| match serde_json::to_value(config) {
        Ok(Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    let (stored, given) = (fields(stored), fields(given));
    let differs = |(name, value): (&String, &Value)| {
        let other = given.get(name).unwrap_or(&Value::Null);
        (value != other).then(|| format!("{name} was {value}, is now {other}"))
    };
    stored.iter().filter_map(differs).collect()
}
