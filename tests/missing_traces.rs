//! Surveys that lack traces: where data end there is no feature but those that run on there.

use std::path::Path;

use crate::common::{Survey, write_segy_without, run_args};

const DIMS: [usize; 3] = [40, 72, 60];

/// What lacks a trace: a block inside, or what lies outside of an outline that is no box.
type Lacks = fn(usize, usize) -> bool;

const WHOLE: Lacks = |_, _| false;
const HOLE: Lacks = |crossline, inline| (10..26).contains(&crossline) && (18..40).contains(&inline);
const OUTLINE: Lacks = |crossline, inline| !(30..100).contains(&(crossline + inline));

/// The potential b(x) of a survey's features, and what was said about it.
fn potential(folder: &Path, kind: &str, lacks: Lacks) -> (Vec<f32>, String) {
    let survey = Survey {
        inlines: DIMS[2],
        crosslines: DIMS[1],
        samples: DIMS[0],
    };
    let mut state = 1u32;
    let value = move |[sample, crossline, inline]: [usize; 3]| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = 0.2 * ((state >> 8) as f32 / (1 << 24) as f32 - 0.5);
        let [s, c, i] = [sample, crossline, inline].map(|n| n as f32);
        let beyond = c > 50.0 + 0.1 * s;
        noise
            + match kind {
                // Layers that dip, thrown by a fault.
                "faults" => {
                    let depth = s + 0.2 * c + 0.1 * i + if beyond { 6.0 } else { 0.0 };
                    (0.57 * depth).sin() + 0.5 * (0.36 * depth).sin()
                }
                _ => 1.0 + if beyond { 2.0 } else { 0.0 },
            }
    };
    write_segy_without(&folder.join("survey.sgy"), &survey, lacks, value);
    let feature = format!("feature survey.sgy -o b.npy --feature {kind} --distance 6");
    let said = run_args(folder, &feature.split(' ').collect::<Vec<_>>());
    let bytes = std::fs::read(folder.join("b.npy")).unwrap();
    let samples = bytes[bytes.len() - 4 * DIMS.iter().product::<usize>()..].as_chunks();
    (
        samples.0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
        said,
    )
}

fn no_feature_where_data_end(kind: &str, lacks: Lacks, reach: usize) {
    let folder = tempfile::tempdir().unwrap();
    let (whole, said) = potential(folder.path(), kind, WHOLE);
    assert!(!said.contains("hold no data"), "{said}");
    let (found, said) = potential(folder.path(), kind, lacks);
    assert!(said.contains("hold no data"), "{said}");
    let (mut there, mut kept) = (0, 0);
    let (mut ends, mut elsewhere) = (0, 0);
    for (row, (whole, found)) in whole.chunks(DIMS[0]).zip(found.chunks(DIMS[0])).enumerate() {
        let (c, i) = (row % DIMS[1], row / DIMS[1]);
        let within = |reach: usize| {
            let near = |n: usize, most: usize| n.saturating_sub(reach)..(n + reach + 1).min(most);
            near(i, DIMS[2]).any(|i| near(c, DIMS[1]).any(|c| lacks(c, i)))
        };
        let deep = |b: &&f32| **b < -0.5;
        if within(2) {
            // The fault, or the step, itself may run on to where data end.
            let beside = |s: usize| (c as f32 - 50.0 - 0.1 * s as f32).abs() > 4.0;
            let found = found
                .iter()
                .enumerate()
                .filter(|(s, b)| beside(*s) && deep(b));
            ends += found.count();
        } else if !within(reach) {
            there += whole.iter().filter(deep).count();
            kept += (whole.iter().zip(found).filter(|(a, b)| deep(a) && deep(b))).count();
            elsewhere += (whole.iter().zip(found).filter(|(a, b)| !deep(a) && deep(b))).count();
        }
    }
    println!("{kind}: {ends} where data end; {kept} of {there} kept, {elsewhere} new");
    assert_eq!(ends, 0, "{kind}: features where data end");
    assert!(
        there > 1000 && kept * 100 >= there * 98,
        "{kind}: {kept} of {there}"
    );
    assert!(elsewhere * 100 <= there * 2, "{kind}: {elsewhere} new ones");
}

#[test]
fn steps_of_the_image_remain_and_those_to_missing_traces_do_not() {
    for kind in ["edges", "canny"] {
        no_feature_where_data_end(kind, HOLE, 10);
        no_feature_where_data_end(kind, OUTLINE, 10);
    }
}

#[test]
fn faults_remain_and_the_ends_of_layers_at_missing_traces_are_none() {
    no_feature_where_data_end("faults", HOLE, 20);
    no_feature_where_data_end("faults", OUTLINE, 20);
}
