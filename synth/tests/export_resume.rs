//! Exports that are killed, run into each other, or run out of disk.
//!
//! Each child process is this test binary again, in [`export_as_child`].
#![cfg(unix)]
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test fails loudly and says what it skips")]

mod folders;
mod strategies;

use folders::{all_formats, contents, differences, small_config};
use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use strategies::synthesizer;
use synth::export::{ExportConfig, Shard, Written, write_folder_with};
use synth::{Error, Result};

const COUNT: u64 = 120;
const FOLDER: &str = "SYNTH_TEST_EXPORT_FOLDER";
const SHARD: &str = "SYNTH_TEST_EXPORT_SHARD";
/// Number of samples, if not [`COUNT`].
const SAMPLES: &str = "SYNTH_TEST_EXPORT_SAMPLES";

fn export(folder: &Path, shard: Shard) -> Result<Written> {
    export_to(COUNT, folder, shard)
}

fn export_to(count: u64, folder: &Path, shard: Shard) -> Result<Written> {
    let config = ExportConfig { shard, ..all_formats() };
    write_folder_with(&synthesizer(small_config()), 0..count, folder, &config)
}

/// Not a test of its own: what the child processes of the others do.
#[test]
#[ignore = "started by the other tests as a process of its own"]
fn export_as_child() {
    let (Some(folder), Ok(shard)) = (std::env::var_os(FOLDER), std::env::var(SHARD)) else { return };
    let (index, count) = shard.split_once('/').unwrap();
    let shard = Shard::new(index.parse().unwrap(), count.parse().unwrap()).unwrap();
    let count = std::env::var(SAMPLES).map_or(COUNT, |count| count.parse().unwrap());
    if let Err(error) = export_to(count, &PathBuf::from(folder), shard) {
        eprintln!("failed: {error}");
        std::process::exit(3);
    }
}

/// The command line of a child, to be started by `program` or by itself.
fn child_of(program: Option<&[&str]>, folder: &Path, shard: &str) -> Command {
    let test = std::env::current_exe().unwrap();
    let mut command = match program {
        Some([program, arguments @ ..]) => {
            let mut command = Command::new(program);
            command.args(arguments).arg(test);
            command
        }
        _ => Command::new(test),
    };
    command.args(["--exact", "export_as_child", "--ignored", "--nocapture", "--test-threads=1"]);
    command.env(FOLDER, folder).env(SHARD, shard).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn start(folder: &Path, shard: &str) -> Child {
    child_of(None, folder, shard).spawn().unwrap()
}

/// What an unbroken run in this process writes.
fn unbroken() -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    export(folder.path(), Shard::WHOLE).unwrap();
    contents(folder.path())
}

fn number_of_records(folder: &Path) -> usize {
    std::fs::read_dir(folder.join("coco")).map_or(0, |entries| {
        entries.filter(|entry| !entry.as_ref().unwrap().file_name().to_string_lossy().starts_with('.')).count()
    })
}

fn wait_for_records(folder: &Path, number: usize, child: &mut Child) {
    while number_of_records(folder) < number && child.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_micros(200));
    }
}

/// Starts an export, kills it when `records` samples are done and a moment later; whether it was still running.
fn kill_at(folder: &Path, records: usize, moment: Duration) -> bool {
    let mut child = start(folder, "0/1");
    wait_for_records(folder, records, &mut child);
    std::thread::sleep(moment);
    child.kill().unwrap();
    child.wait().unwrap().signal() == Some(9)
}

#[test]
fn twenty_kills_at_varied_moments_leave_no_trace() {
    let whole = unbroken();
    let (mut kills, mut leftovers, mut round) = (0, 0, 0_u32);
    while kills < 20 {
        let folder = tempfile::tempdir().unwrap();
        for step in 0..5 {
            round += 1;
            let moment = Duration::from_micros(u64::from(round * 317 % 2500));
            // Steps 0 to 4: before the first sample, on the way, and while the annotations are gathered.
            let records = [0, 20, 50, 90, COUNT as usize][step];
            kills += u32::from(kill_at(folder.path(), records, moment));
            leftovers += contents(folder.path()).keys().filter(|name| name.contains(".part")).count();
        }
        export(folder.path(), Shard::WHOLE).unwrap();
        assert_eq!(differences(&whole, &contents(folder.path())), Vec::<String>::new(), "after {kills} kills");
        assert!(round < 100, "only {kills} of {round} processes were still running when they were to be killed");
    }
    eprintln!("{kills} kills left {leftovers} temporary files, all of which are gone");
}

#[test]
fn shards_in_processes_of_their_own_fill_one_folder() {
    let folder = tempfile::tempdir().unwrap();
    let children = ["0/3", "1/3", "2/3"].map(|shard| start(folder.path(), shard));
    for child in children {
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    assert_eq!(differences(&unbroken(), &contents(folder.path())), Vec::<String>::new());
}

#[test]
fn a_second_export_is_refused_until_the_first_is_gone() {
    let folder = tempfile::tempdir().unwrap();
    // More than it can write before it is killed.
    let mut child = child_of(None, folder.path(), "0/1").env(SAMPLES, "100000").spawn().unwrap();
    wait_for_records(folder.path(), 1, &mut child);
    let (whole, half) = (export(folder.path(), Shard::WHOLE), export(folder.path(), Shard::new(0, 2).unwrap()));
    child.kill().unwrap();
    assert_eq!(child.wait().unwrap().signal(), Some(9), "the export ended before it could be in the way");
    assert!(matches!(&whole, Err(Error::Busy { lock }) if lock.is_file()), "{whole:?}");
    assert!(matches!(half, Err(Error::Busy { .. })));
    // The lock file is still there; what the killed process held is not.
    assert!(export(folder.path(), Shard::WHOLE).unwrap().complete);
}

/// A limit on the size of files fails the large ones as a full disk does, and needs no rights.
#[test]
fn files_beyond_a_limit_are_named_and_made_by_the_next_run() {
    let (folder, whole) = (tempfile::tempdir().unwrap(), unbroken());
    // 8 blocks of 512 bytes or, for some shells, of 1024.
    let limited = ["sh", "-c", "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\""];
    let output = child_of(Some(&limited), folder.path(), "0/1").output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{told}");
    assert!(told.contains("images/0000") && told.contains(".png: File too large"), "{told}");
    assert_intact_and_resumable(folder.path(), &whole);
}

fn assert_intact_and_resumable(folder: &Path, whole: &BTreeMap<String, Vec<u8>>) {
    let partial = contents(folder);
    assert!(!partial.is_empty() && partial.len() < whole.len());
    assert!(partial.iter().all(|(name, bytes)| whole.get(name) == Some(bytes)), "what was written is whole");
    export(folder, Shard::WHOLE).unwrap();
    assert_eq!(differences(whole, &contents(folder)), Vec::<String>::new());
}

/// A disk in memory, gone with this value.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    /// `None`, and a line saying so, where mounting is not allowed.
    fn mount(options: &str) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", options, "tmpfs"]).arg(folder.path()).output();
        if mounted.is_ok_and(|output| output.status.success()) {
            return Some(Self(folder));
        }
        eprintln!("skipped: no right to mount a disk in memory");
        None
    }

    fn remount(&self, options: &str) {
        let options = format!("remount,{options}");
        assert!(Command::new("mount").args(["-o", &options]).arg(self.0.path()).status().unwrap().success());
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // The folder below is removed by its own guard, after this.
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

#[test]
fn a_full_disk_is_told_and_the_next_run_continues() {
    let Some(disk) = SmallDisk::mount("size=600k") else { return };
    let folder = disk.0.path().join("set");
    let failed = export(&folder, Shard::WHOLE);
    let Err(Error::Io { path, source }) = failed else { panic!("{failed:?}") };
    assert_eq!(source.kind(), std::io::ErrorKind::StorageFull);
    assert!(path.starts_with(&folder), "{}", path.display());
    disk.remount("size=60m");
    assert_intact_and_resumable(&folder, &unbroken());
}

#[test]
fn a_read_only_disk_is_told_and_left_alone() {
    let Some(disk) = SmallDisk::mount("size=60m") else { return };
    let folder = disk.0.path();
    let (first, ours) = (0..10, synthesizer(small_config()));
    write_folder_with(&ours, first, folder, &all_formats()).unwrap();
    let before = contents(folder);
    disk.remount("ro");
    let failed = export(folder, Shard::WHOLE);
    assert!(matches!(&failed, Err(Error::Io { path, .. }) if path.starts_with(folder)), "{failed:?}");
    assert_eq!(differences(&before, &contents(folder)), Vec::<String>::new());
    disk.remount("rw");
    assert_eq!(export(folder, Shard::WHOLE).unwrap().skipped, 10);
}
