//! Tests images with gaps: missing traces, null values, NaN and outliers neither hide features nor
//! create any.

use atomesh::feature::{DetectionOptions, FeatureKind, Features, detect};
use atomesh::image::synth::{self, Options, SyntheticKind};
use atomesh::image::{Geometry, Image};

use crate::common::{expect_refusal, run_args};

const DIMS: [usize; 3] = [72, 64, 60];

/// An image of faulted layers, with the distance of each sample from the nearest fault.
struct Survey {
    image: Image<3>,
    fault_distance: Vec<f32>,
}

/// Returns a survey whose traces run along the axis `vertical`.
fn survey(seed: u64, vertical: usize) -> Survey {
    let options = Options {
        dims: DIMS,
        count: Some(2),
        seed,
        ..Options::default()
    };
    let synthetic = synth::make(SyntheticKind::Amplitude, &options).unwrap();
    let transposed = |samples: &[f32]| -> Vec<f32> {
        let [nx, ny, nz] = DIMS;
        match vertical {
            2 => samples.to_vec(),
            // The first axis runs along the former last axis.
            _ => (0..nx * ny * nz)
                .map(|i| samples[i / nz % nx + nx * (i / nz / nx + ny * (i % nz))])
                .collect(),
        }
    };
    let (dims, geometry) = match vertical {
        2 => (DIMS, Geometry::default()),
        _ => {
            let geometry = Geometry {
                axes: [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                ..Geometry::default()
            };
            ([DIMS[2], DIMS[0], DIMS[1]], geometry)
        }
    };
    let fault_distance = &synthetic.truth.distance[..DIMS.iter().product()];
    Survey {
        image: Image::new(dims, transposed(synthetic.image.as_slice()), geometry),
        fault_distance: transposed(fault_distance),
    }
}

impl Survey {
    /// Returns the image with `value` in all samples of the traces that `dead` selects by their map
    /// indices, and a flag for each live sample.
    fn with_dead_traces(
        &self,
        vertical: usize,
        value: f32,
        dead: impl Fn([usize; 2]) -> bool,
    ) -> (Image<3>, Vec<bool>) {
        let dims = self.image.dims();
        let mut samples = self.image.as_slice().to_vec();
        let mut live = vec![true; samples.len()];
        for (i, (sample, live)) in samples.iter_mut().zip(&mut live).enumerate() {
            let index = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
            if dead([index[(vertical + 1) % 3], index[(vertical + 2) % 3]]) {
                (*sample, *live) = (value, false);
            }
        }
        let image = Image::new(dims, samples, self.image.geometry.clone());
        (image, live)
    }

    /// Returns the recall (share of the fault samples among live samples that are within two
    /// samples of a point) and the precision (share of the points that are within two samples of a
    /// fault).
    fn score(&self, live: &[bool], found: &Features<3>) -> [f64; 2] {
        let dims = self.image.dims();
        let mut covered_samples = vec![false; live.len()];
        let mut correct = 0;
        for point in &found.points {
            let centre = point.position.map(|c| c.round() as i64);
            let index = |centre: [i64; 3]| {
                let inside = (0..3).all(|k| centre[k] >= 0 && (centre[k] as usize) < dims[k]);
                let [x, y, z] = centre.map(|c| c as usize);
                inside.then(|| x + dims[0] * (y + dims[1] * z))
            };
            correct +=
                usize::from(index(centre).is_some_and(|i| self.fault_distance[i].abs() < 2.0));
            for n in 0..125i64 {
                let offset = [n % 5 - 2, n / 5 % 5 - 2, n / 25 - 2];
                if offset.iter().map(|c| c * c).sum::<i64>() <= 4
                    && let Some(i) = index(std::array::from_fn(|k| centre[k] + offset[k]))
                {
                    covered_samples[i] = true;
                }
            }
        }
        let fault_samples =
            (0..live.len()).filter(|&i| live[i] && self.fault_distance[i].abs() < 0.5);
        let fault_samples: Vec<usize> = fault_samples.collect();
        let covered = fault_samples
            .iter()
            .filter(|&&i| covered_samples[i])
            .count();
        [
            covered as f64 / fault_samples.len() as f64,
            correct as f64 / found.points.len().max(1) as f64,
        ]
    }
}

/// Returns a pseudo-random number in [0, 1) that depends on the position only.
fn chance([a, b]: [usize; 2]) -> f64 {
    let mixed = (a as u64 * 1_000_003 + b as u64 + 7).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ mixed >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 40) as f64 / (1u64 << 24) as f64
}

fn faults(image: &Image<3>) -> Features<3> {
    detect(
        image,
        &DetectionOptions::with_kind(FeatureKind::Faults, 8.0),
    )
    .unwrap()
}

/// The value of dead samples, and the selection of dead traces by their map indices.
type Gap<'a> = (f32, &'a dyn Fn([usize; 2]) -> bool);

/// Asserts that faults of a survey with gaps are those of the complete survey. On live samples the
/// recall may be 0.03 lower, and the precision 0.06.
fn assert_same_faults_with_gaps(seed: u64, vertical: usize, gaps: &[Gap<'_>]) {
    let survey = survey(seed, vertical);
    let complete = faults(&survey.image);
    assert!(!complete.notes.iter().any(|note| note.contains("missing")));
    for (value, dead) in gaps {
        let (image, live) = survey.with_dead_traces(vertical, *value, dead);
        let features = faults(&image);
        let [recall, precision] = survey.score(&live, &features);
        let [clean_recall, clean_precision] = survey.score(&live, &complete);
        let context = format!(
            "{seed} {vertical} {value}: {recall:.3} of {clean_recall:.3}, {precision:.3} of {clean_precision:.3}"
        );
        println!("{context}");
        assert!(recall > clean_recall - 0.03, "{context}");
        assert!(precision > clean_precision - 0.06, "{context}");
        let has_note = |word: &str| features.notes.iter().any(|note| note.contains(word));
        assert!(
            has_note("hold no data") && has_note("count as missing"),
            "{:?}",
            features.notes
        );
    }
}

/// Selects one trace in fifty.
fn scattered(trace: [usize; 2]) -> bool {
    chance(trace) < 0.02
}

/// Selects the traces outside an outline, a strip of three traces, and single traces.
fn ragged([a, b]: [usize; 2]) -> bool {
    let distance = (a as f64 / 64.0 - 0.5).powi(2) + (b as f64 / 60.0 - 0.47).powi(2);
    distance > 0.53f64.powi(2) || (30..33).contains(&a) || chance([a, b]) < 0.01
}

#[test]
fn faults_are_found_between_missing_traces() {
    assert_same_faults_with_gaps(1, 2, &[(f32::NAN, &scattered), (0.0, &ragged)]);
}

#[test]
fn faults_are_found_next_to_null_values() {
    assert_same_faults_with_gaps(2, 0, &[(-999.25, &ragged), (1e30, &scattered)]);
}

#[test]
fn horizons_with_gaps_are_those_of_the_complete_survey() {
    let survey = survey(1, 2);
    let find = |image: &Image<3>| {
        detect(
            image,
            &DetectionOptions::with_kind(FeatureKind::Horizons, 8.0),
        )
        .unwrap()
    };
    let complete = find(&survey.image);
    for (value, dead) in [
        (0.0, &scattered as &dyn Fn([usize; 2]) -> bool),
        (-9999.0, &ragged),
    ] {
        let (image, live) = survey.with_dead_traces(2, value, dead);
        let features = find(&image);
        // The threshold follows the rms of the live samples, so that other parallel horizons, and
        // more of them, may be chosen. All points are crests or troughs of the complete survey.
        let samples = survey.image.as_slice();
        let is_crest = |p: &[f32; 3]| {
            let [x, y, z] = p.map(|c| c.round() as usize);
            let sample_at = |z: usize| samples[x + DIMS[0] * (y + DIMS[1] * z.min(DIMS[2] - 1))];
            let highest = (z.saturating_sub(1)..z + 2)
                .map(|z| sample_at(z).abs())
                .fold(0.0, f32::max);
            highest > sample_at(z.saturating_sub(3)).abs() && highest > sample_at(z + 3).abs()
        };
        let is_live = |p: &[f32; 3]| {
            let [x, y, z] = p.map(|c| c.round() as usize);
            live[x + DIMS[0] * (y + DIMS[1] * z)]
        };
        let counts = [&complete, &features].map(|features| {
            let points = features.points.iter().map(|p| p.position);
            let live_points: Vec<[f32; 3]> = points.filter(is_live).collect();
            [
                live_points.len(),
                live_points.iter().filter(|p| is_crest(p)).count(),
            ]
            .map(|n| n as f64)
        });
        let [[complete_points, complete_crests], [points, crests]] = counts;
        let context = format!(
            "{value}: {points} points for {complete_points}, {crests} crests for {complete_crests}"
        );
        println!("{context}");
        assert!(points > 0.9 * complete_points, "{context}");
        assert!(
            crests / points > complete_crests / complete_points - 0.03,
            "{context}"
        );
    }
}

/// Returns an image of a ridge, in which `change` replaces a few samples.
fn ridge(dims: [usize; 3], change: impl Fn([usize; 3]) -> Option<f32>) -> Image<3> {
    let value = |i: usize| {
        let index = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
        let distance = index[0] as f32 - 20.0 - 0.3 * index[2] as f32;
        let noise = 0.05 * chance([i, 3]) as f32;
        change(index).unwrap_or((-0.5 * (distance / 1.5).powi(2)).exp() + noise)
    };
    let samples = (0..dims.iter().product()).map(value).collect();
    Image::new(dims, samples, Geometry::default())
}

#[test]
fn outliers_do_not_hide_a_ridge() {
    let dims = [48, 40, 36];
    for kind in [FeatureKind::Ridges, FeatureKind::Auto] {
        let find =
            |image: &Image<3>| detect(image, &DetectionOptions::with_kind(kind, 6.0)).unwrap();
        let clean = find(&ridge(dims, |_| None));
        assert!(clean.points.len() > 1000, "{:?}", clean.notes);
        let changes: [&dyn Fn([usize; 3]) -> Option<f32>; 5] = [
            &|index| (index == [40, 12, 20]).then_some(1000.0),
            &|index| (index == [24, 12, 12]).then_some(-1e6),
            &|index| (index[0] == 40 && index[1] == 11).then_some(1e5),
            &|index| (index[2] < 5).then_some(-999.25),
            &|index| (index == [40, 12, 20]).then_some(f32::INFINITY),
        ];
        for (number, change) in changes.into_iter().enumerate() {
            let features = find(&ridge(dims, change));
            let min_share = if number == 3 { 0.8 } else { 0.98 };
            let share = features.points.len() as f64 / clean.points.len() as f64;
            assert!(
                (min_share..1.02).contains(&share),
                "{kind} {number}: {} of {}, {:?}",
                features.points.len(),
                clean.points.len(),
                features.notes
            );
        }
    }
}

#[test]
fn values_that_are_no_gaps_are_kept() {
    // A background of zeros, steps to a common value, and clipped amplitudes are no gaps.
    let dims = [40, 36, 32];
    let sparse = ridge(dims, |index| (index[1] > 30).then_some(0.0));
    assert!(sparse.mark_dead(true).unwrap().is_none());
    let clipped = |i: usize| (1500.0 * (0.4 * (i / 1440) as f32).sin()).clamp(-999.0, 999.0);
    let clipped = Image::new(
        dims,
        (0..40 * 36 * 32).map(clipped).collect(),
        Geometry::default(),
    );
    assert!(clipped.mark_dead(true).unwrap().is_none());
    let filled = ridge(dims, |index| (index[1] > 30).then_some(-9999.0));
    assert!(filled.mark_dead(false).unwrap().is_none());
    assert_eq!(filled.mark_dead(true).unwrap().unwrap().notes.len(), 1);
}

#[test]
fn null_values_are_options_of_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let index = folder.path();
    let image = ridge([48, 40, 36], |index| (index[1] > 33).then_some(7777.0));
    atomesh::image::formats::write(&index.join("r.npy"), &image).unwrap();
    let mesh = |null: &[&str]| {
        let job = [
            "mesh",
            "r.npy",
            "--feature",
            "ridges",
            "--distance",
            "6",
            "-o",
            "m.vtu",
        ];
        run_args(index, &[&job[..], null].concat())
    };
    let stdout = mesh(&["--null", "7777"]);
    assert!(stdout.contains("hold no data"), "{stdout}");
    assert!(!mesh(&["--null", "none"]).contains("hold no data"));
    let info = run_args(index, &["info", "r.npy", "--null", "7777,-1"]);
    assert!(info.to_lowercase().contains("nan"), "{info}");
    let error = expect_refusal(index, &["mesh", "r.npy", "--null", "seven"]);
    assert!(
        error.contains("null seven") && error.contains("is not a number"),
        "{error}"
    );
}
