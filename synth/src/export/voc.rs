//! Detection boxes as in Pascal VOC: pixels counted from 1, both corners inside the box.

use super::config::ExportConfig;
use crate::compose::Instance;
use crate::synthesizer::Sample;
use std::fmt::Write as _;

/// Less of an object than this within the picture is *truncated*, as the annotators of VOC 2011 were told
/// ("15-20% of the object lies outside the bounding box"; guidelines, section "truncated").
const TRUNCATED_BELOW: f64 = 0.85;

pub(super) fn annotation(sample: &Sample, image: &str, config: &ExportConfig) -> String {
    let (width, height) = sample.image.dimensions();
    let mut text = format!(
        "<annotation>\n  <folder>images</folder>\n  <filename>{}</filename>\n  <size>\n    <width>{width}</width>\n    \
         <height>{height}</height>\n    <depth>3</depth>\n  </size>\n  <segmented>0</segmented>\n",
        escaped(image)
    );
    for instance in sample.instances.iter().filter(|instance| instance.class > 0) {
        let [left, top, across, down] = instance.bbox;
        let name = escaped(&config.class_name(instance.class));
        let truncated = u8::from(is_truncated(instance, (width, height)));
        // Writing to a String does not fail.
        let _ = write!(
            text,
            "  <object>\n    <name>{name}</name>\n    <pose>Unspecified</pose>\n    <truncated>{truncated}</truncated>\n    \
             <difficult>0</difficult>\n    <bndbox>\n      <xmin>{}</xmin>\n      <ymin>{}</ymin>\n      \
             <xmax>{}</xmax>\n      <ymax>{}</ymax>\n    </bndbox>\n  </object>\n",
            left + 1,
            top + 1,
            left + across,
            top + down,
        );
    }
    text.push_str("</annotation>\n");
    text
}

/// At the border of the picture, and with a part missing: other objects may hide some of that part.
fn is_truncated(instance: &Instance, (width, height): (u32, u32)) -> bool {
    let [left, top, across, down] = instance.bbox;
    let at_border = left == 0 || top == 0 || left + across == width || top + down == height;
    at_border && instance.visible_fraction < TRUNCATED_BELOW
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
