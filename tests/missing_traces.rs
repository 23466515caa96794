//! Tests surveys without some of their traces: the margin of the data is no feature, and features
//! that run up to it remain.

use std::path::Path;

use crate::common::{Survey, run_args, write_segy_without};

const DIMS: [usize; 3] = [40, 72, 60];

/// Selects missing traces by crossline and inline: a block inside, or the outside of an outline
/// that is no rectangle.
type IsMissing = fn(usize, usize) -> bool;

const COMPLETE: IsMissing = |_, _| false;
const HOLE: IsMissing =
    |crossline, inline| (10..26).contains(&crossline) && (18..40).contains(&inline);
const OUTLINE: IsMissing = |crossline, inline| !(30..100).contains(&(crossline + inline));

/// Returns the potential b(x) of a survey's features, and the standard output.
fn potential(folder: &Path, kind: &str, is_missing: IsMissing) -> (Vec<f32>, String) {
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
        let is_beyond_step = c > 50.0 + 0.1 * s;
        noise
            + match kind {
                // Dipping layers that a fault displaces.
                "faults" => {
                    let depth = s + 0.2 * c + 0.1 * i + if is_beyond_step { 6.0 } else { 0.0 };
                    (0.57 * depth).sin() + 0.5 * (0.36 * depth).sin()
                }
                _ => 1.0 + if is_beyond_step { 2.0 } else { 0.0 },
            }
    };
    write_segy_without(&folder.join("survey.sgy"), &survey, is_missing, value);
    let feature = format!("feature survey.sgy -o b.npy --feature {kind} --distance 6");
    let stdout = run_args(folder, &feature.split(' ').collect::<Vec<_>>());
    let bytes = std::fs::read(folder.join("b.npy")).unwrap();
    let samples = bytes[bytes.len() - 4 * DIMS.iter().product::<usize>()..].as_chunks();
    (
        samples.0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
        stdout,
    )
}

fn assert_no_feature_at_margin(kind: &str, is_missing: IsMissing, reach: usize) {
    let folder = tempfile::tempdir().unwrap();
    let (complete, stdout) = potential(folder.path(), kind, COMPLETE);
    assert!(!stdout.contains("hold no data"), "{stdout}");
    let (with_gaps, stdout) = potential(folder.path(), kind, is_missing);
    assert!(stdout.contains("hold no data"), "{stdout}");
    let (mut in_complete, mut in_both) = (0, 0);
    let (mut at_margin, mut elsewhere) = (0, 0);
    for (row, (complete, with_gaps)) in complete
        .chunks(DIMS[0])
        .zip(with_gaps.chunks(DIMS[0]))
        .enumerate()
    {
        let (c, i) = (row % DIMS[1], row / DIMS[1]);
        let is_near_missing = |reach: usize| {
            let range = |n: usize, max: usize| n.saturating_sub(reach)..(n + reach + 1).min(max);
            range(i, DIMS[2]).any(|i| range(c, DIMS[1]).any(|c| is_missing(c, i)))
        };
        let deep = |b: &&f32| **b < -0.5;
        if is_near_missing(2) {
            // The fault or the step itself may continue up to the margin.
            let is_off_feature = |s: usize| (c as f32 - 50.0 - 0.1 * s as f32).abs() > 4.0;
            let with_gaps = with_gaps
                .iter()
                .enumerate()
                .filter(|(s, b)| is_off_feature(*s) && deep(b));
            at_margin += with_gaps.count();
        } else if !is_near_missing(reach) {
            in_complete += complete.iter().filter(deep).count();
            in_both += (complete
                .iter()
                .zip(with_gaps)
                .filter(|(a, b)| deep(a) && deep(b)))
            .count();
            elsewhere += (complete
                .iter()
                .zip(with_gaps)
                .filter(|(a, b)| !deep(a) && deep(b)))
            .count();
        }
    }
    println!("{kind}: {at_margin} at the margin; {in_both} of {in_complete} kept, {elsewhere} new");
    assert_eq!(at_margin, 0, "{kind}: features at the margin of the data");
    assert!(
        in_complete > 1000 && in_both * 100 >= in_complete * 98,
        "{kind}: {in_both} of {in_complete}"
    );
    assert!(
        elsewhere * 100 <= in_complete * 2,
        "{kind}: {elsewhere} new ones"
    );
}

#[test]
fn steps_of_the_image_remain_and_the_margin_of_the_data_is_none() {
    for kind in ["edges", "canny"] {
        assert_no_feature_at_margin(kind, HOLE, 10);
        assert_no_feature_at_margin(kind, OUTLINE, 10);
    }
}

#[test]
fn faults_remain_and_the_margin_of_the_data_is_none() {
    assert_no_feature_at_margin("faults", HOLE, 20);
    assert_no_feature_at_margin("faults", OUTLINE, 20);
}
