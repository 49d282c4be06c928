//! Samples as files, for training in any framework.
//!
//! ```text
//! folder/images/00000000.png   the picture (or .jpg)
//! folder/labels/00000000.png   class of each pixel, 0 = background
//! folder/labels/00000000.txt   YOLO: detection boxes, where YOLO looks for them
//! folder/data.yaml             YOLO: names of the classes
//! folder/voc/00000000.xml      Pascal VOC: detection boxes
//! folder/coco/00000000.json    COCO: what annotations.json holds of this sample
//! folder/annotations.json      COCO: instances with their visible masks, written at the end
//! folder/digest.txt            what the files were made from
//! ```
//!
//! Every file is a pure function of the samples and of [`ExportConfig`]: the same bytes on any number of threads, in
//! [shards](Shard), and after any number of interruptions. A file under its final name is whole: it is written beside
//! it, brought to the disk and renamed. This happens in batches of 8 samples at first and 256 in the end, since a disk
//! takes many files at once much faster than one by one. A run that was cut off, even by `kill -9` or a power failure,
//! is continued by the next one: it skips samples with all their files and removes leftover temporary files; what is
//! lost is one batch. Locks of the operating system, which end with their process, keep two runs apart; their empty
//! files `.export*.lock` stay.
//!
//! COCO needs all samples in one file. Each sample therefore leaves a record, gathered at the end: making the skipped
//! samples again to learn their masks would cost a resumed run as much as starting over.

mod coco;
mod config;
mod folder;
mod jpeg;
mod lock;
mod part;
mod part_file;
mod rle;
mod shard;
mod voc;
mod yolo;

pub use config::{Chroma, ExportConfig, Images};
pub use folder::{Written, write_folder, write_folder_with};
pub use shard::Shard;
