use super::config::{Chroma, ExportConfig, Images};
use super::lock::{FolderLock, one_at_a_time};
use super::part::Part;
use super::part_file::Disks;
use super::shard::Shard;
use super::{coco, part_file, yolo};
use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::synthesizer::{Sample, Synthesizer};
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// What an export did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Written {
    /// Samples written.
    pub written: u64,
    /// Samples of this shard that were already complete.
    pub skipped: u64,
    /// Whether all samples are complete, those of other shards included; only then is `annotations.json` written.
    pub complete: bool,
}

/// Writes samples as `images/00000000.png` and `labels/00000000.png` (pixel = class index) below `folder`.
///
/// This is [`write_folder_with`] and the default settings.
///
/// # Errors
///
/// As [`write_folder_with`].
pub fn write_folder(synthesizer: &Synthesizer, indices: Range<u64>, folder: impl AsRef<Path>) -> Result<Written> {
    write_folder_with(synthesizer, indices, folder, &ExportConfig::default())
}

/// Writes the samples `indices` below `folder` as `config` asks; the [module](crate::export) tells the layout.
///
/// A second call continues: samples with all their files are skipped, and a format asked for later is added to the
/// samples that lack it. `annotations.json` lists all complete samples of the folder, also those of earlier calls.
///
/// # Errors
///
/// * [`Error::OtherSamples`] if the folder was begun with another [`Synthesizer::digest`], image format or names of
///   classes, or holds pictures but no `digest.txt`.
/// * [`Error::Busy`] while another export writes to the folder, other shards than this excepted.
/// * [`Error::InvalidConfig`] for settings out of range.
/// * [`Error::Io`] and [`Error::Image`] with the path: batches written before stay, and a later call continues.
/// * The errors of [`Synthesizer::sample`].
///
/// ```
/// use synth::export::{ExportConfig, Images, Shard, write_folder_with};
/// # use synth::{Backgrounds, SynthConfig, Synthesizer};
/// # let config = SynthConfig { objects: (0, 0), ..SynthConfig::default() };
/// # let synthesizer = Synthesizer::new(vec![], vec![], Backgrounds::procedural(0, 2)?, config)?;
/// # let folder = tempfile::tempdir().map_err(|source| synth::Error::Io { path: "".into(), source })?;
/// # let folder = folder.path();
/// let config = ExportConfig { images: Images::JPEG, coco: true, ..ExportConfig::default() };
/// for index in 0..2 {
///     // These could be two processes.
///     let half = ExportConfig { shard: Shard::new(index, 2)?, ..config.clone() };
///     let done = write_folder_with(&synthesizer, 0..6, folder, &half)?;
///     assert_eq!((done.written, done.complete), (3, index == 1));
/// }
/// assert!(folder.join("annotations.json").is_file());
/// # Ok::<(), synth::Error>(())
/// ```
pub fn write_folder_with(
    synthesizer: &Synthesizer,
    indices: Range<u64>,
    folder: impl AsRef<Path>,
    config: &ExportConfig,
) -> Result<Written> {
    let folder = folder.as_ref();
    let classes = synthesizer.classes();
    config.validate(&classes)?;
    create(folder)?;
    let _lock = FolderLock::take(folder, config.shard)?;
    one_at_a_time(folder, || claim(folder, &mark(synthesizer, config), config.shard))?;
    let parts = Part::wanted(config);
    for part in &parts {
        create(&folder.join(part.folder()))?;
    }
    remove_leftovers(folder, config.shard)?;
    let run = Run { synthesizer, folder, config, parts };
    let mut done = run.write_all(indices.clone()).inspect_err(|_| {
        // The first failure is the one to report; what stays is removed by the next run.
        let _ = remove_leftovers(folder, config.shard);
    })?;
    if config.yolo {
        part_file::write(&folder.join("data.yaml"), config.shard, yolo::data(&classes, config).as_bytes())?;
    }
    done.complete = config.shard == Shard::WHOLE || indices.into_iter().all(|index| run.missing(index).is_empty());
    // The last shard to end sees all records; two that end together write the same bytes.
    if config.coco && done.complete {
        coco::gather(folder, &classes, config)?;
    }
    Ok(done)
}

struct Run<'a> {
    synthesizer: &'a Synthesizer,
    folder: &'a Path,
    config: &'a ExportConfig,
    parts: Vec<Part>,
}

impl Run<'_> {
    fn write_all(&self, indices: Range<u64>) -> Result<Written> {
        let (first, number) = self.config.shard.progression(indices);
        let write = |buffers: &mut Buffers, step| self.begin_missing(first + step * self.config.shard.count(), buffers);
        let disks = Disks::of(self.parts.iter().map(|part| self.folder.join(part.folder())));
        let (mut done, mut batch, mut written) = (0, SMALLEST_BATCH, 0);
        while done < number {
            let end = done.saturating_add(batch).min(number);
            let begun = collect_all(done..end, write)?;
            written += begun.iter().filter(|files| !files.is_empty()).count() as u64;
            let begun = begun.concat();
            if !begun.is_empty() {
                part_file::complete(&begun, &disks, self.config.shard)?;
            }
            (done, batch) = (end, (2 * batch).min(LARGEST_BATCH));
        }
        Ok(Written { written, skipped: number - written, complete: false })
    }

    fn missing(&self, index: u64) -> Vec<Part> {
        let is_missing = |part: &Part| !part.path(self.folder, index, self.config.images).is_file();
        self.parts.iter().copied().filter(is_missing).collect()
    }

    /// Writes the files that a sample lacks beside their names, and tells the names.
    fn begin_missing(&self, index: u64, buffers: &mut Buffers) -> Result<Vec<PathBuf>> {
        let missing = self.missing(index);
        if missing.is_empty() {
            return Ok(Vec::new());
        }
        let Buffers { sample, bytes } = buffers;
        self.synthesizer.sample_into(index, sample)?;
        let mut begun = Vec::with_capacity(missing.len());
        for part in missing {
            let path = part.path(self.folder, index, self.config.images);
            if let Err(source) = part.encode(sample, index, self.config, bytes) {
                return Err(Error::Image { path, source });
            }
            part_file::begin(&path, self.config.shard, bytes)?;
            begun.push(path);
        }
        Ok(begun)
    }
}

/// Samples whose files are brought to the disk together, at first: a run that is cut off early has something to show.
const SMALLEST_BATCH: u64 = 8;

/// The same in the end, by doubling: so much work is lost to a kill.
const LARGEST_BATCH: u64 = 256;

/// What one thread writes in.
#[derive(Default)]
struct Buffers {
    sample: Sample,
    bytes: Vec<u8>,
}

type Begun = Result<Vec<PathBuf>>;

#[cfg(feature = "parallel")]
fn collect_all(
    steps: Range<u64>,
    write: impl Fn(&mut Buffers, u64) -> Begun + Sync + Send,
) -> Result<Vec<Vec<PathBuf>>> {
    use rayon::prelude::*;
    steps.into_par_iter().map_init(Buffers::default, write).collect()
}

#[cfg(not(feature = "parallel"))]
fn collect_all(steps: Range<u64>, write: impl Fn(&mut Buffers, u64) -> Begun) -> Result<Vec<Vec<PathBuf>>> {
    let mut buffers = Buffers::default();
    steps.map(|step| write(&mut buffers, step)).collect()
}

/// Removes the temporary files of killed and failed runs.
fn remove_leftovers(folder: &Path, shard: Shard) -> Result<()> {
    let mut below = ["", "images", "labels", "voc", coco::RECORDS].into_iter();
    below.try_for_each(|below| part_file::remove_leftovers(&folder.join(below), shard))
}

fn create(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).map_err(|source| Error::Io { path: folder.to_path_buf(), source })
}

/// What all files of a folder have in common: `0123456789abcdef png`, and a number for names of classes.
fn mark(synthesizer: &Synthesizer, config: &ExportConfig) -> String {
    let images = match config.images {
        Images::Png => "png".to_owned(),
        Images::Jpeg { quality, chroma: Chroma::Full } => format!("jpeg{quality} 4:4:4"),
        Images::Jpeg { quality, chroma: Chroma::Halved } => format!("jpeg{quality} 4:2:0"),
    };
    let mut mark = format!("{:016x} {images}", synthesizer.digest());
    if !config.class_names.is_empty() {
        let mut names = Digest::new("class names");
        config.class_names.iter().for_each(|name| names.bytes(name.as_bytes()));
        mark = format!("{mark} names {:016x}", names.finish());
    }
    mark
}

/// Marks the folder as belonging to one set of samples, or checks that it does.
fn claim(folder: &Path, needed: &str, shard: Shard) -> Result<()> {
    let path = folder.join("digest.txt");
    let other = |found: &str| Error::OtherSamples {
        folder: folder.to_path_buf(),
        found: found.to_owned(),
        needed: needed.to_owned(),
    };
    match fs::read_to_string(&path) {
        Ok(found) if found.trim() == needed => Ok(()),
        Ok(found) => Err(other(found.trim())),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            // Pictures of unknown origin would pass for samples that are done.
            if fs::read_dir(folder.join("images")).is_ok_and(|mut entries| entries.next().is_some()) {
                return Err(other("unknown (no digest.txt)"));
            }
            part_file::write(&path, shard, format!("{needed}\n").as_bytes())
        }
        Err(source) => Err(Error::Io { path, source }),
    }
}
