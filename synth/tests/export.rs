//! Exported folders: what is in them, and that it does not depend on how they were written.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test fails loudly and says what it skips")]

mod folders;
mod strategies;

use folders::{all_formats, contents, differences, small_config};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use strategies::{busy_config, synthesizer};
use synth::export::{Chroma, ExportConfig, Images, Shard, write_folder, write_folder_with};
use synth::{Error, Sample, SynthConfig, Synthesizer};

const COUNT: u64 = 24;

fn exported(config: &ExportConfig) -> (tempfile::TempDir, Synthesizer) {
    let (folder, ours) = (tempfile::tempdir().unwrap(), synthesizer(small_config()));
    let done = write_folder_with(&ours, 0..COUNT, folder.path(), config).unwrap();
    assert_eq!((done.written, done.skipped, done.complete), (COUNT, 0, true));
    (folder, ours)
}

/// The counts of a compressed run-length encoding, from the description in `maskApi.c`.
fn decode(text: &str) -> Vec<i64> {
    let mut counts: Vec<i64> = Vec::new();
    let mut bytes = text.bytes();
    while let Some(first) = bytes.next() {
        let (mut value, mut shift, mut byte) = (0_i64, 0, first - 48);
        loop {
            value |= i64::from(byte & 0x1f) << shift;
            shift += 5;
            if byte & 0x20 == 0 {
                break;
            }
            byte = bytes.next().unwrap() - 48;
        }
        if byte & 0x10 != 0 {
            value -= 1 << shift;
        }
        let before = if counts.len() > 2 { counts[counts.len() - 2] } else { 0 };
        counts.push(value + before);
    }
    counts
}

/// Column-major mask of an annotation.
fn mask_of(annotation: &Value) -> Vec<bool> {
    let counts = decode(annotation["segmentation"]["counts"].as_str().unwrap());
    counts.iter().enumerate().flat_map(|(k, &n)| vec![k % 2 == 1; usize::try_from(n).unwrap()]).collect()
}

#[test]
fn coco_masks_boxes_and_areas_are_those_of_the_samples() {
    let (folder, ours) = exported(&all_formats());
    let text = std::fs::read_to_string(folder.path().join("annotations.json")).unwrap();
    let coco: Value = serde_json::from_str(&text).unwrap();
    let names: Vec<_> = coco["categories"].as_array().unwrap().iter().map(|c| (&c["id"], &c["name"])).collect();
    assert_eq!(
        format!("{names:?}"),
        r#"[(Number(1), String("mug")), (Number(2), String("box & lid")), (Number(5), String("clamp \"XL\""))]"#
    );
    let mut annotations = coco["annotations"].as_array().unwrap().iter();
    let mut id = 0;
    for index in 0..COUNT {
        let sample = ours.sample(index).unwrap();
        let image = &coco["images"][index as usize];
        assert_eq!((image["id"].as_u64(), image["height"].as_u64()), (Some(index), Some(64)));
        assert_eq!(image["file_name"], format!("{index:08}.png"));
        for (owner, instance) in (1..).zip(&sample.instances).filter(|(_, instance)| instance.class > 0) {
            let told = annotations.next().unwrap();
            id += 1;
            assert_eq!((told["id"].as_u64(), told["image_id"].as_u64()), (Some(id), Some(index)));
            assert_eq!(told["category_id"], instance.class);
            assert_eq!((&told["iscrowd"], &told["area"]), (&Value::from(0), &Value::from(instance.visible_px)));
            assert_eq!(told["bbox"], Value::from(instance.bbox.to_vec()));
            let columns = (0..96).flat_map(|x| (0..64).map(move |y| (x, y)));
            let mask: Vec<bool> = columns.map(|(x, y)| sample.owners.get_pixel(x, y)[0] == owner).collect();
            assert!(mask_of(told) == mask, "sample {index}, instance {owner}");
        }
    }
    assert!(annotations.next().is_none() && id > 20, "{id} annotations");
}

#[test]
fn owners_are_the_instances_and_the_labels() {
    let hiding = SynthConfig { objects: (30, 30), max_occlusion: 1.0, scale: (0.3, 6.0), ..small_config() };
    let ours = synthesizer(hiding);
    let mut hidden = 0;
    for index in 0..60 {
        let sample = ours.sample(index).unwrap();
        let mut seen = vec![0; sample.instances.len() + 1];
        for (owner, label) in sample.owners.iter().zip(sample.label.iter()) {
            seen[usize::from(*owner)] += 1;
            assert_eq!(*label, usize::from(*owner).checked_sub(1).map_or(0, |index| sample.instances[index].class));
        }
        assert!(sample.instances.iter().zip(&seen[1..]).all(|(instance, &seen)| instance.visible_px == seen));
        hidden += usize::from(!sample.instances.is_empty() && sample.instances.len() < 30);
    }
    assert!(hidden > 30, "objects must be hidden entirely for the owners to be renumbered, {hidden} samples");
}

/// The text between `<tag>` and `</tag>`, each time it occurs.
fn between<'a>(xml: &'a str, tag: &str) -> Vec<&'a str> {
    let (open, close) = (format!("<{tag}>"), format!("</{tag}>"));
    xml.split(&open).skip(1).map(|rest| rest.split(&close).next().unwrap()).collect()
}

#[test]
fn yolo_and_voc_boxes_are_those_of_the_samples() {
    let (folder, ours) = exported(&all_formats());
    let read = |name: String| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let names = ["mug", "box &amp; lid", "c", "d", "clamp \"XL\""];
    for index in 0..COUNT {
        let sample = ours.sample(index).unwrap();
        let objects: Vec<_> = sample.instances.iter().filter(|instance| instance.class > 0).collect();
        let (yolo, xml) = (read(format!("labels/{index:08}.txt")), read(format!("voc/{index:08}.xml")));
        let (lines, boxes) = (yolo.lines().collect::<Vec<_>>(), between(&xml, "object"));
        assert_eq!((lines.len(), boxes.len()), (objects.len(), objects.len()));
        assert_eq!(
            (between(&xml, "width"), between(&xml, "filename")),
            (vec!["96"], vec![format!("{index:08}.png").as_str()])
        );
        for ((instance, line), xml) in objects.iter().zip(lines).zip(boxes) {
            let [left, top, width, height] = instance.bbox.map(f64::from);
            let numbers: Vec<f64> = line.split(' ').map(|number| number.parse().unwrap()).collect();
            let [class, x, y, across, down] = numbers[..] else { panic!("{line}") };
            assert_eq!(class, f64::from(instance.class) - 1.0);
            let found = [(x - across / 2.0) * 96.0, (y - down / 2.0) * 64.0, across * 96.0, down * 64.0];
            // Six digits of a share are 1e-4 pixels here.
            assert!(found.iter().zip([left, top, width, height]).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
            assert_eq!(between(xml, "name"), [names[usize::from(instance.class) - 1]]);
            let corner = |tag| between(xml, tag)[0].parse::<f64>().unwrap();
            assert_eq!([corner("xmin"), corner("ymin")], [left + 1.0, top + 1.0]);
            assert_eq!([corner("xmax"), corner("ymax")], [left + width, top + height]);
        }
    }
    assert!(read("data.yaml".into()).contains("  4: \"clamp \\\"XL\\\"\"\n"));
}

/// Reads the folder with the tools that others use.
#[test]
fn pycocotools_and_elementtree_read_the_same_objects() {
    let Some(python) = std::env::var_os("POSEPIPE_PYTHON") else {
        eprintln!("skipped: POSEPIPE_PYTHON is not set (a Python with pycocotools, numpy and pillow)");
        return;
    };
    let (folder, _) = exported(&all_formats());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_export.py");
    let output = Command::new(python).arg(script).arg(folder.path()).output().unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{told}{}", String::from_utf8_lossy(&output.stderr));
    eprintln!("{}", told.lines().last().unwrap_or_default());
}

#[test]
fn bytes_do_not_depend_on_threads_order_or_shards() {
    let (folder, ours) = exported(&all_formats());
    let whole = contents(folder.path());
    let compare = |what: &str, write: &dyn Fn(&Path)| {
        let other = tempfile::tempdir().unwrap();
        write(other.path());
        assert_eq!(differences(&whole, &contents(other.path())), Vec::<String>::new(), "{what}");
    };
    compare("one by one, backward", &|folder| {
        for index in (0..COUNT).rev() {
            write_folder_with(&ours, index..index + 1, folder, &all_formats()).unwrap();
        }
    });
    for count in [2, 5, 40] {
        compare(&format!("{count} shards"), &|folder| {
            for index in (0..count).rev() {
                let shard = Shard::new(index, count).unwrap();
                let config = ExportConfig { shard, ..all_formats() };
                let done = write_folder_with(&ours, 0..COUNT, folder, &config).unwrap();
                assert_eq!(done.written, shard.indices(0..COUNT).count() as u64);
                assert!(done.complete || index > 0);
            }
        });
    }
    #[cfg(feature = "parallel")]
    for threads in [1, 2, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        compare(&format!("{threads} threads"), &|folder| {
            pool.install(|| write_folder_with(&ours, 0..COUNT, folder, &all_formats())).unwrap();
        });
    }
}

#[test]
fn a_lost_file_and_a_format_asked_for_later_are_added() {
    let (folder, ours) = exported(&all_formats());
    let whole = contents(folder.path());
    std::fs::remove_file(folder.path().join("voc/00000003.xml")).unwrap();
    std::fs::remove_file(folder.path().join("coco/00000007.json")).unwrap();
    let again = write_folder_with(&ours, 0..COUNT, folder.path(), &all_formats()).unwrap();
    assert_eq!((again.written, again.skipped), (2, COUNT - 2));
    assert_eq!(differences(&whole, &contents(folder.path())), Vec::<String>::new());

    let later = tempfile::tempdir().unwrap();
    let plain = ExportConfig { class_names: all_formats().class_names, ..ExportConfig::default() };
    write_folder_with(&ours, 0..COUNT, later.path(), &plain).unwrap();
    assert_eq!(contents(later.path()).len(), 2 * COUNT as usize + 1);
    write_folder_with(&ours, 0..COUNT, later.path(), &all_formats()).unwrap();
    assert_eq!(differences(&whole, &contents(later.path())), Vec::<String>::new());
}

#[test]
fn jpeg_pictures_are_close_and_labels_exact() {
    let (folder, ours) = exported(&ExportConfig { images: Images::JPEG, ..ExportConfig::default() });
    let sample = ours.sample(5).unwrap();
    let picture = image::open(folder.path().join("images/00000005.jpg")).unwrap().into_rgb8();
    let error: u64 = picture.iter().zip(sample.image.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    let mean = error as f64 / picture.len() as f64;
    assert!(mean > 0.0 && mean < 4.0, "{mean} grey levels");
    assert_eq!(image::open(folder.path().join("labels/00000005.png")).unwrap().into_luma8(), sample.label);
}

#[test]
fn folders_of_other_samples_settings_and_origin_are_refused() {
    let (folder, ours) = exported(&ExportConfig::default());
    let before = contents(folder.path());
    let refused = |synthesizer: &Synthesizer, config: &ExportConfig| {
        matches!(write_folder_with(synthesizer, 0..30, folder.path(), config), Err(Error::OtherSamples { .. }))
    };
    assert!(refused(&synthesizer(SynthConfig { seed: 1, ..small_config() }), &ExportConfig::default()));
    assert!(refused(&ours, &ExportConfig { images: Images::JPEG, ..ExportConfig::default() }));
    assert!(refused(&ours, &all_formats()));
    std::fs::remove_file(folder.path().join("digest.txt")).unwrap();
    assert!(refused(&ours, &ExportConfig::default()));
    let after: BTreeMap<_, _> = before.into_iter().filter(|(name, _)| name != "digest.txt").collect();
    assert_eq!(differences(&after, &contents(folder.path())), Vec::<String>::new());
}

#[test]
fn settings_out_of_range_are_errors() {
    let (folder, ours) = (tempfile::tempdir().unwrap(), synthesizer(small_config()));
    let short = ExportConfig { class_names: vec!["mug".into()], ..ExportConfig::default() };
    let control = ExportConfig { class_names: vec!["a\nb".into(); 5], ..ExportConfig::default() };
    let quality = ExportConfig { images: Images::Jpeg { quality: 0, chroma: Chroma::Full }, ..ExportConfig::default() };
    for config in [short, control, quality] {
        let refused = write_folder_with(&ours, 0..1, folder.path(), &config);
        assert!(matches!(refused, Err(Error::InvalidConfig { .. })), "{config:?}");
    }
    assert!(contents(folder.path()).is_empty());
}

#[test]
fn what_stands_in_the_way_is_named() {
    let (folder, ours) = (tempfile::tempdir().unwrap(), synthesizer(small_config()));
    std::fs::write(folder.path().join("labels"), b"a file").unwrap();
    let Err(Error::Io { path, .. }) = write_folder(&ours, 0..1, folder.path()) else { panic!("must fail") };
    assert_eq!(path, folder.path().join("labels"));
}

#[test]
fn a_broken_record_is_named() {
    let (folder, ours) = exported(&all_formats());
    let record = folder.path().join("coco/00000002.json");
    std::fs::write(&record, b"{\"id\":2").unwrap();
    let failed = write_folder_with(&ours, 0..COUNT, folder.path(), &all_formats());
    assert!(matches!(failed, Err(Error::Io { path, .. }) if path == record));
}

#[test]
fn buffers_of_the_caller_are_reused_whatever_they_held() {
    let (small, large) = (synthesizer(small_config()), synthesizer(busy_config()));
    let mut sample = Sample::default();
    large.sample_into(3, &mut sample).unwrap();
    let places = |sample: &Sample| (sample.image.as_ptr(), sample.label.as_ptr(), sample.owners.as_ptr());
    let before = places(&sample);
    for index in 0..8 {
        for ours in [&small, &large] {
            ours.sample_into(index, &mut sample).unwrap();
            assert_eq!(sample, ours.sample(index).unwrap());
            assert_eq!(places(&sample), before);
        }
    }
}
