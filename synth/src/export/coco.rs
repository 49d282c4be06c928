//! COCO instances: a record per sample, gathered into `annotations.json`.

use super::config::ExportConfig;
use super::{part_file, rle};
use crate::error::{Error, Result};
use crate::synthesizer::Sample;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// The folder of the records.
pub(super) const RECORDS: &str = "coco";

/// What `annotations.json` holds of a sample, a JSON object a line: the image, then its annotations without their ids,
/// which are counted over all samples.
pub(super) fn record(sample: &Sample, index: u64, image: &str) -> String {
    let (width, height) = sample.image.dimensions();
    let name = quoted(image);
    let mut text = format!("{{\"id\":{index},\"width\":{width},\"height\":{height},\"file_name\":{name}}}\n");
    for (instance, owner) in sample.instances.iter().zip(1..).filter(|(instance, _)| instance.class > 0) {
        let counts = quoted(&rle::compressed(&rle::runs(&sample.owners, owner, instance.bbox)));
        let [left, top, across, down] = instance.bbox;
        // Writing to a String does not fail.
        let _ = writeln!(
            text,
            "{{\"image_id\":{index},\"category_id\":{},\"bbox\":[{left},{top},{across},{down}],\"area\":{},\
             \"iscrowd\":0,\"segmentation\":{{\"size\":[{height},{width}],\"counts\":{counts}}}}}",
            instance.class, instance.visible_px,
        );
    }
    text
}

/// Writes `annotations.json` from the records of the folder, in the order of the samples.
pub(super) fn gather(folder: &Path, classes: &[u8], config: &ExportConfig) -> Result<()> {
    let records = list(&folder.join(RECORDS))?;
    let mut broken = None;
    let path = folder.join("annotations.json");
    let gathered = part_file::write_with(&path, config.shard, |file| {
        write!(file, "{{\"info\":{{\"description\":\"synth\"}},\n\"licenses\":[],\n\"categories\":[")?;
        for (index, &class) in classes.iter().enumerate() {
            let comma = if index > 0 { "," } else { "" };
            let name = quoted(&config.class_name(class));
            write!(file, "{comma}\n{{\"id\":{class},\"name\":{name},\"supercategory\":\"object\"}}")?;
        }
        let mut failed = |path: &Path, error| {
            broken = Some(path.to_path_buf());
            error
        };
        write!(file, "],\n\"images\":[")?;
        for (index, record) in records.iter().enumerate() {
            let lines = read(record).map_err(|error| failed(record, error))?;
            write!(file, "{}\n{}", if index > 0 { "," } else { "" }, lines.lines().next().unwrap_or_default())?;
        }
        write!(file, "],\n\"annotations\":[")?;
        // COCO's own evaluation takes id 0 for no match.
        let mut id = 1_u64;
        for record in &records {
            let lines = read(record).map_err(|error| failed(record, error))?;
            for line in lines.lines().skip(1) {
                write!(file, "{}\n{{\"id\":{id},{}", if id > 1 { "," } else { "" }, &line[1..])?;
                id += 1;
            }
        }
        writeln!(file, "]}}")
    });
    // A record that cannot be read is the reason, not the file that is written from it.
    match (gathered, broken) {
        (Err(Error::Io { source, .. }), Some(path)) => Err(Error::Io { path, source }),
        (gathered, _) => gathered,
    }
}

/// The records of complete samples, by index.
fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let at = |source| Error::Io { path: folder.to_path_buf(), source };
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(at)? {
        let path = entry.map_err(at)?.path();
        let stem = path.extension().filter(|extension| *extension == "json").and(path.file_stem());
        if let Some(index) = stem.and_then(|stem| stem.to_str()?.parse::<u64>().ok()) {
            found.push((index, path));
        }
    }
    found.sort();
    Ok(found.into_iter().map(|(_, path)| path).collect())
}

/// A record, each line a JSON object of at least `{}`.
fn read(path: &Path) -> io::Result<String> {
    let lines = fs::read_to_string(path)?;
    let whole = |line: &str| serde_json::from_str::<serde_json::Map<String, serde_json::Value>>(line).is_ok();
    if lines.is_empty() || !lines.lines().all(whole) {
        return Err(io::Error::new(
            io::ErrorKind::InvalidData,
            "not a record of this crate, remove it to make it again",
        ));
    }
    Ok(lines)
}

/// `text` as a JSON string.
pub(super) fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
