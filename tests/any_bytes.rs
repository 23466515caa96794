//! Any file, any small job: the corpus of the fuzz targets, and random changes of it. The changes and their
//! number are the same in each run; `ATOMESH_FUZZ_SEED` and `ATOMESH_FUZZ_TIMES` (as many times more) try
//! others. `make fuzz` goes on from there, led by what code is reached.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on has failed"
)]

#[path = "../fuzz/src/lib.rs"]
mod any;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Verbs of one process are not to overlap.
static ALONE: Mutex<()> = Mutex::new(());

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n.max(1) as u64) as usize
    }

    fn of<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }

    /// A place and a length there, at most so long.
    fn range(&mut self, length: usize, most: usize) -> std::ops::Range<usize> {
        let start = self.below(length + 1);
        start..(start + self.below(most)).min(length)
    }
}

/// A file of the corpus with a few changes.
fn changed(corpus: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
    const NUMBERS: [&str; 12] = [
        "-1",
        "0",
        "1",
        "2",
        "1e308",
        "nan",
        "99999999999",
        "4294967295",
        "-inf",
        "0.5",
        "3",
        "1e-300",
    ];
    let mut bytes = random.of(corpus).clone();
    for _ in 0..1 + random.below(5) {
        let length = bytes.len();
        match random.below(8) {
            0..=2 if length > 0 => bytes[random.below(length)] ^= 1 << random.below(8),
            3 if length > 0 => {
                bytes[random.below(length)] = *random.of(&[0, 1, 127, 128, 255, b' ', b'9'])
            }
            4 => drop(bytes.drain(random.range(length, 40))),
            5 => {
                let other = random.of(corpus);
                let part = other[random.range(other.len(), 60)].to_vec();
                let to = random.range(length, 60);
                bytes.splice(to, part);
            }
            _ => {
                // One of the numbers in a text.
                let start = random.below(length);
                let digit = |b: &u8| b.is_ascii_digit();
                if let Some(first) = bytes[start..].iter().position(digit) {
                    let first = start + first;
                    let more = bytes[first..].iter().take_while(|b| digit(b)).count();
                    bytes.splice(first..first + more, random.of(&NUMBERS).bytes());
                }
            }
        }
    }
    bytes
}

fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fuzz/corpus")
        .join(name);
    let entries = fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut paths: Vec<PathBuf> = entries.collect();
    paths.sort();
    assert!(!paths.is_empty(), "{}", folder.display());
    paths.iter().map(|path| fs::read(path).unwrap()).collect()
}

/// Replays the corpus, with every verb that a first byte can name, and then `changes` of its files.
fn kept_and_changed(name: &str, verbs: usize, changes: u64, promise: fn(&Path, &[u8])) {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = any::folder();
    let corpus = corpus(name);
    let found = Path::new(env!("CARGO_TARGET_TMPDIR")).join("found");
    let mut faults = Vec::new();
    let mut hold = |bytes: &[u8]| {
        if catch_unwind(AssertUnwindSafe(|| promise(&folder, bytes))).is_err() {
            fs::create_dir_all(&found).unwrap();
            let path = found.join(format!("{name}-{}", faults.len()));
            fs::write(&path, bytes).unwrap();
            faults.push(path);
        }
    };
    for bytes in &corpus {
        hold(bytes);
        let mut bytes = bytes.clone();
        for verb in 1..verbs {
            bytes[0] = verb as u8;
            hold(&bytes);
        }
    }
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap())
    };
    let random = &mut Random(number("ATOMESH_FUZZ_SEED", 1));
    let changes = changes * number("ATOMESH_FUZZ_TIMES", 1);
    for _ in 0..changes {
        let mut bytes = changed(&corpus, random);
        if verbs > 1 && !bytes.is_empty() {
            bytes[0] = random.below(verbs) as u8;
        }
        hold(&bytes);
    }
    println!("{name}: {} kept, {changes} changed", corpus.len());
    assert!(
        faults.is_empty(),
        "{} broke a promise: {faults:?}",
        faults.len()
    );
}

#[test]
fn any_image_is_refused_in_a_line_or_read_and_written_back() {
    kept_and_changed("images", 1, 20_000, any::images::any_image);
}

#[test]
fn any_mesh_is_refused_in_a_line_or_good_for_every_verb() {
    kept_and_changed(
        "meshes",
        any::meshes::LINES.len(),
        5_000,
        any::meshes::any_mesh,
    );
}

#[test]
fn any_job_is_refused_in_a_line_or_gives_a_valid_mesh() {
    kept_and_changed("jobs", 1, 200, any::jobs::any_job);
}
