//! What lies in an exported folder.
#![allow(dead_code, reason = "each test file uses its own part")]
#![allow(clippy::unwrap_used, reason = "a broken fixture is a failed test")]

use std::collections::BTreeMap;
use std::path::Path;
use synth::SynthConfig;
use synth::export::ExportConfig;

/// Small samples of all kinds: background only, several objects, distractors.
pub(crate) fn small_config() -> SynthConfig {
    SynthConfig { width: 96, height: 64, background_only: 0.2, ..super::strategies::busy_config() }
}

/// Every format at once.
pub(crate) fn all_formats() -> ExportConfig {
    let class_names = ["mug", "box & lid", "c", "d", "clamp \"XL\""].map(String::from).to_vec();
    ExportConfig { coco: true, yolo: true, voc: true, class_names, ..ExportConfig::default() }
}

/// Bytes of every file below `folder`, lock files excepted; leftover temporary files are listed like any other.
pub(crate) fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(below) = folders.pop() {
        for entry in std::fs::read_dir(below).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                folders.push(path);
            } else if !(name.starts_with(".export.") && name.ends_with("lock")) {
                found.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// Names of the files that differ or that only one folder has.
pub(crate) fn differences(one: &BTreeMap<String, Vec<u8>>, other: &BTreeMap<String, Vec<u8>>) -> Vec<String> {
    let names: std::collections::BTreeSet<&String> = one.keys().chain(other.keys()).collect();
    names.into_iter().filter(|name| one.get(*name) != other.get(*name)).cloned().collect()
}
