//! Detection boxes as YOLO reads them: a line per object, `class x y width height`.

use super::config::ExportConfig;
use crate::synthesizer::Sample;
use std::fmt::Write as _;

/// Class from 0, middle of the box and its size as shares of the picture; no line for distractors.
pub(super) fn boxes(sample: &Sample) -> String {
    let (width, height) = (f64::from(sample.image.width()), f64::from(sample.image.height()));
    let mut text = String::new();
    for instance in sample.instances.iter().filter(|instance| instance.class > 0) {
        let [left, top, across, down] = instance.bbox.map(f64::from);
        let (x, y) = ((left + 0.5 * across) / width, (top + 0.5 * down) / height);
        let (across, down) = (across / width, down / height);
        // Writing to a String does not fail.
        let _ = writeln!(text, "{} {x:.6} {y:.6} {across:.6} {down:.6}", instance.class - 1);
    }
    text
}

/// `data.yaml`: without `path`, the trainer looks beside the file itself.
pub(super) fn data(classes: &[u8], config: &ExportConfig) -> String {
    let mut text =
        String::from("train: images\n# Put a folder of pictures that are not trained on here.\nval: images\nnames:\n");
    for class in 1..=classes.last().copied().unwrap_or(0) {
        // A JSON string is a YAML string.
        let _ = writeln!(text, "  {}: {}", class - 1, super::coco::quoted(&config.class_name(class)));
    }
    text
}
