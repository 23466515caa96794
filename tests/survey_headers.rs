//! Tests headers of SEG-Y as programs write them: dead traces, wild coordinates, long intervals, fields
//! that a revision does not have.

use std::path::Path;

use crate::common::{Survey, run, run_args, write_segy, write_segy_without};

const SURVEY: Survey = Survey {
    inlines: 9,
    crosslines: 8,
    samples: 12,
};

/// Length of a trace with its header.
const TRACE: usize = 240 + 4 * 12;

fn value([sample, crossline, inline]: [usize; 3]) -> f32 {
    ((3 * sample + 5 * crossline + 7 * inline) % 11) as f32 - 5.0
}

/// Returns `true` for some of the traces.
fn is_dead(trace: usize) -> bool {
    trace % 10 == 3
}

/// Writes a survey after `change` has changed its bytes.
fn write(path: &Path, change: impl Fn(&mut Vec<u8>)) {
    write_segy(path, &SURVEY, value);
    let mut bytes = std::fs::read(path).unwrap();
    change(&mut bytes);
    std::fs::write(path, bytes).unwrap();
}

/// Returns the description of a survey.
fn info(folder: &Path) -> serde_json::Value {
    serde_json::from_str(&run_args(folder, &["info", "s.sgy", "--json"])).unwrap()
}

#[test]
fn dead_traces_are_missing_whatever_their_samples_are() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let is_missing = |crossline: usize, inline: usize| is_dead(8 * inline + crossline);
    write_segy_without(&folder.join("gaps.sgy"), &SURVEY, is_missing, value);
    run(folder, "convert gaps.sgy gaps.npy --quiet");
    let expected = std::fs::read(folder.join("gaps.npy")).unwrap();
    for sample in [0.0f32, 1e33, -999.25, 7.0] {
        write(&folder.join("s.sgy"), |bytes| {
            let traces = bytes[3600..].chunks_mut(TRACE).enumerate();
            for (_, trace) in traces.filter(|(number, _)| is_dead(*number)) {
                trace[28..30].copy_from_slice(&2i16.to_be_bytes());
                for word in trace[240..].chunks_mut(4) {
                    word.copy_from_slice(&sample.to_be_bytes());
                }
            }
        });
        let info = info(folder);
        assert_eq!(info["survey"]["missing"], 7, "{sample}");
        run(folder, "convert s.sgy s.npy --quiet");
        let read = std::fs::read(folder.join("s.npy")).unwrap();
        assert!(read == expected, "{sample}");
    }
    // A program that gives all traces this code means nothing by it.
    write(&folder.join("s.sgy"), |bytes| {
        for trace in bytes[3600..].chunks_mut(TRACE) {
            trace[28..30].copy_from_slice(&2i16.to_be_bytes());
        }
    });
    let info = info(folder);
    assert_eq!(info["survey"]["missing"], 0);
    assert!(info["notes"].to_string().contains("the code is not used"));
}

#[test]
fn one_wild_coordinate_does_not_lose_the_position() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(&folder.join("s.sgy"), |_| {});
    let expected = info(folder)["image"].clone();
    for wild in [i32::MIN, i32::MAX, 1] {
        write(&folder.join("s.sgy"), |bytes| {
            let trace = &mut bytes[3600 + 20 * TRACE..];
            trace[180..184].copy_from_slice(&wild.to_be_bytes());
            trace[184..188].copy_from_slice(&wild.to_be_bytes());
        });
        let info = info(folder);
        for key in ["origin", "far_corner"] {
            let [read, right] = [&info["image"][key], &expected[key]].map(|values| {
                let values = values.as_array().unwrap().iter();
                values.map(|v| v.as_f64().unwrap()).collect::<Vec<f64>>()
            });
            let difference = read.iter().zip(&right).map(|(a, b)| (a - b).abs());
            assert!(difference.fold(0.0, f64::max) < 1e-3, "{wild}: {read:?}");
        }
        assert_eq!(info["survey"]["fit"]["outliers"], 1);
        let notes = info["notes"].to_string();
        assert!(notes.contains("1 traces have X, Y far off"), "{notes}");
    }
}

#[test]
fn intervals_need_no_sign() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for interval in [40_000u16, 65_535] {
        let bytes_of = interval.to_be_bytes();
        write(&folder.join("s.sgy"), |bytes| {
            bytes[3216..3218].copy_from_slice(&bytes_of);
            for trace in bytes[3600..].chunks_mut(TRACE) {
                trace[116..118].copy_from_slice(&bytes_of);
            }
        });
        let dt = info(folder)["survey"]["dt_ms"].as_f64();
        assert_eq!(dt, Some(f64::from(interval) / 1000.0));
    }
}

#[test]
fn fields_that_a_revision_does_not_have_do_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Blanks where later revisions have the number of extended textual headers.
    write(&folder.join("s.sgy"), |bytes| {
        bytes[3500..3502].fill(0);
        bytes[3504..3506].fill(b' ');
    });
    let described = info(folder);
    assert_eq!(described["survey"]["traces"], 72);
    assert_eq!(described["survey"]["problem"], serde_json::Value::Null);
}

#[test]
fn additional_trace_headers_count_although_the_length_fits_without_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // 60 samples of 4 bytes are as long as a header: twice as many traces would fit, too.
    let survey = Survey {
        samples: 60,
        ..SURVEY
    };
    let path = folder.join("s.sgy");
    write_segy(&path, &survey, value);
    let written = std::fs::read(&path).unwrap();
    let mut bytes = written[..3600].to_vec();
    bytes[3500..3502].copy_from_slice(&[2, 0]);
    bytes[3506..3510].copy_from_slice(&1u32.to_be_bytes());
    for trace in written[3600..].chunks(240 + 240) {
        bytes.extend(&trace[..240]);
        bytes.extend([0; 240]);
        bytes.extend(&trace[240..]);
    }
    std::fs::write(&path, &bytes).unwrap();
    let described = info(folder);
    assert_eq!(described["survey"]["traces"], 72);
    assert_eq!(
        described["image"]["numpy_shape"],
        serde_json::json!([9, 8, 60])
    );
}
