//! Images with gaps: missing traces, null values, NaN and outliers neither hide features nor make any.

use atomesh::feature::{DetectionOptions, FeatureKind, Features, detect};
use atomesh::image::synth::{self, Options, SyntheticKind};
use atomesh::image::{Geometry, Image};

use crate::common::{expect_refusal, run_args};

const DIMS: [usize; 3] = [72, 64, 60];

/// Layers with faults, and how far each sample is from the nearest fault.
struct Survey {
    image: Image<3>,
    off: Vec<f32>,
}

/// A survey whose traces run along the axis `vertical`.
fn survey(seed: u64, vertical: usize) -> Survey {
    let options = Options {
        dims: DIMS,
        count: Some(2),
        seed,
        ..Options::default()
    };
    let made = synth::make(SyntheticKind::Amplitude, &options).unwrap();
    let turned = |samples: &[f32]| -> Vec<f32> {
        let [nx, ny, nz] = DIMS;
        match vertical {
            2 => samples.to_vec(),
            // The first axis runs along what was the last.
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
    let off = &made.truth.distance[..DIMS.iter().product()];
    Survey {
        image: Image::new(dims, turned(made.image.as_slice()), geometry),
        off: turned(off),
    }
}

impl Survey {
    /// The survey with a value in all samples of traces that `dead` names by their places in the map.
    fn with(
        &self,
        vertical: usize,
        value: f32,
        dead: impl Fn([usize; 2]) -> bool,
    ) -> (Image<3>, Vec<bool>) {
        let dims = self.image.dims();
        let mut samples = self.image.as_slice().to_vec();
        let mut live = vec![true; samples.len()];
        for (i, (sample, live)) in samples.iter_mut().zip(&mut live).enumerate() {
            let at = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
            if dead([at[(vertical + 1) % 3], at[(vertical + 2) % 3]]) {
                (*sample, *live) = (value, false);
            }
        }
        let image = Image::new(dims, samples, self.image.geometry.clone());
        (image, live)
    }

    /// Shares of the faults on live ground within two samples of a point, and of the points within two samples
    /// of a fault.
    fn score(&self, live: &[bool], found: &Features<3>) -> [f64; 2] {
        let dims = self.image.dims();
        let mut near = vec![false; live.len()];
        let mut good = 0;
        for point in &found.points {
            let at = point.position.map(|c| c.round() as i64);
            let index = |at: [i64; 3]| {
                let inside = (0..3).all(|k| at[k] >= 0 && (at[k] as usize) < dims[k]);
                let [x, y, z] = at.map(|c| c as usize);
                inside.then(|| x + dims[0] * (y + dims[1] * z))
            };
            good += usize::from(index(at).is_some_and(|i| self.off[i].abs() < 2.0));
            for n in 0..125i64 {
                let by = [n % 5 - 2, n / 5 % 5 - 2, n / 25 - 2];
                if by.iter().map(|c| c * c).sum::<i64>() <= 4
                    && let Some(i) = index(std::array::from_fn(|k| at[k] + by[k]))
                {
                    near[i] = true;
                }
            }
        }
        let on = (0..live.len()).filter(|&i| live[i] && self.off[i].abs() < 0.5);
        let on: Vec<usize> = on.collect();
        let covered = on.iter().filter(|&&i| near[i]).count();
        [
            covered as f64 / on.len() as f64,
            good as f64 / found.points.len().max(1) as f64,
        ]
    }
}

/// A number in [0, 1) of a place.
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

/// The value of dead samples, and which traces are dead by their places in the map.
type Gap<'a> = (f32, &'a dyn Fn([usize; 2]) -> bool);

/// Faults of a survey with gaps are those of the whole one on live ground, to 3 % of their area and 6 % of points
/// that are on none.
fn as_without_gaps(seed: u64, vertical: usize, gaps: &[Gap<'_>]) {
    let survey = survey(seed, vertical);
    let whole = faults(&survey.image);
    assert!(!whole.notes.iter().any(|note| note.contains("missing")));
    for (value, dead) in gaps {
        let (image, live) = survey.with(vertical, *value, dead);
        let found = faults(&image);
        let [recall, precision] = survey.score(&live, &found);
        let [clean_recall, clean_precision] = survey.score(&live, &whole);
        let shown = format!(
            "{seed} {vertical} {value}: {recall:.3} of {clean_recall:.3}, {precision:.3} of {clean_precision:.3}"
        );
        println!("{shown}");
        assert!(recall > clean_recall - 0.03, "{shown}");
        assert!(precision > clean_precision - 0.06, "{shown}");
        let says = |word: &str| found.notes.iter().any(|note| note.contains(word));
        assert!(
            says("hold no data") && says("count as missing"),
            "{:?}",
            found.notes
        );
    }
}

/// One trace in fifty is missing.
fn scattered(at: [usize; 2]) -> bool {
    chance(at) < 0.02
}

/// What lies outside of an outline is missing, a strip of three traces, and single traces.
fn ragged([a, b]: [usize; 2]) -> bool {
    let off = (a as f64 / 64.0 - 0.5).powi(2) + (b as f64 / 60.0 - 0.47).powi(2);
    off > 0.53f64.powi(2) || (30..33).contains(&a) || chance([a, b]) < 0.01
}

#[test]
fn faults_are_found_between_missing_traces() {
    as_without_gaps(1, 2, &[(f32::NAN, &scattered), (0.0, &ragged)]);
}

#[test]
fn faults_are_found_beside_null_values() {
    as_without_gaps(2, 0, &[(-999.25, &ragged), (1e30, &scattered)]);
}

#[test]
fn horizons_are_those_of_the_whole_survey() {
    let survey = survey(1, 2);
    let find = |image: &Image<3>| {
        detect(
            image,
            &DetectionOptions::with_kind(FeatureKind::Horizons, 8.0),
        )
        .unwrap()
    };
    let whole = find(&survey.image);
    for (value, dead) in [
        (0.0, &scattered as &dyn Fn([usize; 2]) -> bool),
        (-9999.0, &ragged),
    ] {
        let (image, live) = survey.with(2, value, dead);
        let found = find(&image);
        // The threshold follows the rms of live ground, so that others of parallel horizons may be chosen, and
        // more; all are crests or troughs of the whole survey.
        let samples = survey.image.as_slice();
        let is_crest = |p: &[f32; 3]| {
            let [x, y, z] = p.map(|c| c.round() as usize);
            let at = |z: usize| samples[x + DIMS[0] * (y + DIMS[1] * z.min(DIMS[2] - 1))];
            let highest = (z.saturating_sub(1)..z + 2)
                .map(|z| at(z).abs())
                .fold(0.0, f32::max);
            highest > at(z.saturating_sub(3)).abs() && highest > at(z + 3).abs()
        };
        let is_live = |p: &[f32; 3]| {
            let [x, y, z] = p.map(|c| c.round() as usize);
            live[x + DIMS[0] * (y + DIMS[1] * z)]
        };
        let counts = [&whole, &found].map(|found| {
            let points = found.points.iter().map(|p| p.position);
            let there: Vec<[f32; 3]> = points.filter(is_live).collect();
            [there.len(), there.iter().filter(|p| is_crest(p)).count()].map(|n| n as f64)
        });
        let [[there, crests], [points, good]] = counts;
        let shown = format!("{value}: {points} points for {there}, {good} crests for {crests}");
        println!("{shown}");
        assert!(points > 0.9 * there, "{shown}");
        assert!(good / points > crests / there - 0.03, "{shown}");
    }
}

/// A ridge with a few samples of other values.
fn ridge(dims: [usize; 3], change: impl Fn([usize; 3]) -> Option<f32>) -> Image<3> {
    let value = |i: usize| {
        let at = [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
        let off = at[0] as f32 - 20.0 - 0.3 * at[2] as f32;
        let noise = 0.05 * chance([i, 3]) as f32;
        change(at).unwrap_or((-0.5 * (off / 1.5).powi(2)).exp() + noise)
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
            &|at| (at == [40, 12, 20]).then_some(1000.0),
            &|at| (at == [24, 12, 12]).then_some(-1e6),
            &|at| (at[0] == 40 && at[1] == 11).then_some(1e5),
            &|at| (at[2] < 5).then_some(-999.25),
            &|at| (at == [40, 12, 20]).then_some(f32::INFINITY),
        ];
        for (number, change) in changes.into_iter().enumerate() {
            let found = find(&ridge(dims, change));
            let missing = if number == 3 { 0.8 } else { 0.98 };
            let share = found.points.len() as f64 / clean.points.len() as f64;
            assert!(
                (missing..1.02).contains(&share),
                "{kind} {number}: {} of {}, {:?}",
                found.points.len(),
                clean.points.len(),
                found.notes
            );
        }
    }
}

#[test]
fn values_that_are_no_gaps_stay() {
    // A background of zeros, steps to a common value, and clipped amplitudes.
    let dims = [40, 36, 32];
    let sparse = ridge(dims, |at| (at[1] > 30).then_some(0.0));
    assert!(sparse.mark_dead(true).unwrap().is_none());
    let clipped = |i: usize| (1500.0 * (0.4 * (i / 1440) as f32).sin()).clamp(-999.0, 999.0);
    let clipped = Image::new(
        dims,
        (0..40 * 36 * 32).map(clipped).collect(),
        Geometry::default(),
    );
    assert!(clipped.mark_dead(true).unwrap().is_none());
    let filled = ridge(dims, |at| (at[1] > 30).then_some(-9999.0));
    assert!(filled.mark_dead(false).unwrap().is_none());
    assert_eq!(filled.mark_dead(true).unwrap().unwrap().notes.len(), 1);
}

#[test]
fn null_values_are_named_on_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let image = ridge([48, 40, 36], |at| (at[1] > 33).then_some(7777.0));
    atomesh::image::formats::write(&at.join("r.npy"), &image).unwrap();
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
        run_args(at, &[&job[..], null].concat())
    };
    let said = mesh(&["--null", "7777"]);
    assert!(said.contains("hold no data"), "{said}");
    assert!(!mesh(&["--null", "none"]).contains("hold no data"));
    let info = run_args(at, &["info", "r.npy", "--null", "7777,-1"]);
    assert!(info.to_lowercase().contains("nan"), "{info}");
    let said = expect_refusal(at, &["mesh", "r.npy", "--null", "seven"]);
    assert!(
        said.contains("null seven") && said.contains("no number"),
        "{said}"
    );
}
