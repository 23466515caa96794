//! Runs the checks of the fuzz targets on their corpus and on random changes of it.
//!
//! The changes and their number are the same in each run. `ATOMESH_FUZZ_SEED` chooses other
//! changes, and `ATOMESH_FUZZ_TIMES` multiplies their number. `make fuzz` continues from there,
//! guided by code coverage.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on has failed"
)]

#[path = "../fuzz/src/lib.rs"]
mod fuzz_targets;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Prevents that verbs of this process run at the same time.
static VERB_LOCK: Mutex<()> = Mutex::new(());

/// Random numbers by SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n.max(1) as u64) as usize
    }

    fn choose<'a, T>(&mut self, items: &'a [T]) -> &'a T {
        &items[self.below(items.len())]
    }

    /// Returns a random range within `length` that is shorter than `max_length`.
    fn range(&mut self, length: usize, max_length: usize) -> std::ops::Range<usize> {
        let start = self.below(length + 1);
        start..(start + self.below(max_length)).min(length)
    }
}

/// Returns a file of the corpus with a few random changes.
fn mutated(corpus: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
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
    let mut bytes = random.choose(corpus).clone();
    for _ in 0..1 + random.below(5) {
        let length = bytes.len();
        match random.below(8) {
            0..=2 if length > 0 => bytes[random.below(length)] ^= 1 << random.below(8),
            3 if length > 0 => {
                bytes[random.below(length)] = *random.choose(&[0, 1, 127, 128, 255, b' ', b'9'])
            }
            4 => drop(bytes.drain(random.range(length, 40))),
            5 => {
                let other = random.choose(corpus);
                let part = other[random.range(other.len(), 60)].to_vec();
                let target = random.range(length, 60);
                bytes.splice(target, part);
            }
            _ => {
                // Replace one of the numbers in a text file.
                let start = random.below(length);
                let digit = |b: &u8| b.is_ascii_digit();
                if let Some(first) = bytes[start..].iter().position(digit) {
                    let first = start + first;
                    let digits = bytes[first..].iter().take_while(|b| digit(b)).count();
                    bytes.splice(first..first + digits, random.choose(&NUMBERS).bytes());
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

/// Runs `check` on each file of the corpus, with every verb that a first byte can name, and then on
/// `changes` changed files.
fn replay_and_mutate(name: &str, verbs: usize, changes: u64, check: fn(&Path, &[u8])) {
    let _guard = VERB_LOCK.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = fuzz_targets::folder();
    let corpus = corpus(name);
    let failure_folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("found");
    let mut failures = Vec::new();
    let mut run_check = |bytes: &[u8]| {
        if catch_unwind(AssertUnwindSafe(|| check(&folder, bytes))).is_err() {
            fs::create_dir_all(&failure_folder).unwrap();
            let path = failure_folder.join(format!("{name}-{}", failures.len()));
            fs::write(&path, bytes).unwrap();
            failures.push(path);
        }
    };
    for bytes in &corpus {
        run_check(bytes);
        let mut bytes = bytes.clone();
        for verb in 1..verbs {
            bytes[0] = verb as u8;
            run_check(&bytes);
        }
    }
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap())
    };
    let random = &mut Random(number("ATOMESH_FUZZ_SEED", 1));
    let changes = changes * number("ATOMESH_FUZZ_TIMES", 1);
    for _ in 0..changes {
        let mut bytes = mutated(&corpus, random);
        if verbs > 1 && !bytes.is_empty() {
            bytes[0] = random.below(verbs) as u8;
        }
        run_check(&bytes);
    }
    println!("{name}: {} files, {changes} changed", corpus.len());
    assert!(
        failures.is_empty(),
        "{} failed: {failures:?}",
        failures.len()
    );
}

#[test]
fn any_image_is_refused_in_one_line_or_survives_a_round_trip() {
    replay_and_mutate("images", 1, 20_000, fuzz_targets::images::check_image);
}

#[test]
fn any_mesh_is_refused_in_one_line_or_accepted_by_every_verb() {
    replay_and_mutate(
        "meshes",
        fuzz_targets::meshes::LINES.len(),
        5_000,
        fuzz_targets::meshes::check_mesh,
    );
}

#[test]
fn any_job_is_refused_in_one_line_or_gives_a_valid_mesh() {
    replay_and_mutate("jobs", 1, 200, fuzz_targets::jobs::check_job);
}
