//! Surfaces in meshes of images, against what is known of these.

use super::*;
use crate::feature::{self, Features};
use crate::image::synth::{self, SyntheticKind};
use crate::image::{Geometry, Image};
use crate::job::{self, Outcome, Params, Spacing};
use crate::lattice::optimize::NoProgress;
use crate::mesh::interface::marks_from_bits;

fn image(dims: [usize; 3], value: impl Fn([f64; 3]) -> f64) -> Image<3> {
    let [nx, ny, _] = dims;
    let at = |i: usize| [i % nx, i / nx % ny, i / (nx * ny)].map(|c| c as f64);
    let samples = (0..dims.iter().product()).map(|i| value(at(i)) as f32);
    Image::new(dims, samples.collect(), Geometry::default())
}

fn mesh(image: &Image<3>, kind: feature::FeatureKind, d: f64) -> Outcome {
    let params = Params {
        spacing: Spacing::Constant(d),
        feature: kind,
        ..Params::default()
    };
    job::run(image, &params, &mut NoProgress).unwrap()
}

fn marked_facets(outcome: &Outcome) -> Vec<[u32; 3]> {
    let marks: Vec<bool> =
        marks_from_bits::<3>(&outcome.simplices().unwrap().feature_faces).collect();
    facet_selection::marked_facets(&outcome.simplices().unwrap().mesh, &marks)
}

fn group_facets(outcome: &Outcome, min_area: Option<f64>) -> Surfaces<3> {
    let faces = marked_facets(outcome);
    let options = Options {
        min_area,
        ..Options::default()
    };
    Surfaces::find(
        &outcome.simplices().unwrap().mesh.nodes,
        faces,
        &[],
        &options,
    )
}

/// Area of the plane n.x = c in the box: over the two axes along which it is steepest.
fn plane_area(n: [f64; 3], c: f64, dims: [usize; 3]) -> f64 {
    let k = (0..3).fold(0, |k, j| if n[j].abs() > n[k].abs() { j } else { k });
    let (i, j) = ((k + 1) % 3, (k + 2) % 3);
    let mut inside = 0;
    for p in 0..4 * (dims[i] - 1) {
        for q in 0..4 * (dims[j] - 1) {
            let [u, v] = [p, q].map(|c| 0.25 * c as f64 + 0.125);
            let x = (c - n[i] * u - n[j] * v) / n[k];
            inside += usize::from((0.0..=(dims[k] - 1) as f64).contains(&x));
        }
    }
    inside as f64 / 16.0 / n[k].abs()
}

#[test]
#[ignore = "slow: make test-all"]
fn as_many_faults_come_out_as_went_in() {
    for (kind, seed) in [
        (SyntheticKind::Planes, 4),
        (SyntheticKind::Planes, 6),
        (SyntheticKind::Faults, 2),
    ] {
        let options = synth::Options {
            dims: [110, 100, 96],
            seed,
            count: Some(3),
            ..synth::Options::default()
        };
        let made = synth::make(kind, &options).unwrap();
        let outcome = mesh(&made.image, feature::FeatureKind::Ridges, 6.0);
        let surfaces = group_facets(&outcome, None);
        let found = measure(
            &surfaces,
            &outcome.simplices().unwrap().mesh.nodes,
            &MapAxes::from_axis(0, true),
            &[],
        );
        assert_eq!(found.len(), 3, "{kind:?} {seed}: {found:#?}");
        let truth = &made.truth;
        let [nx, ny, _] = truth.dims;
        for m in &found {
            // The exact plane, by a sample near it whose truth fits the surface best.
            let n: [f64; 3] = std::array::from_fn(|k| m.normal[k]);
            let middle: [f64; 3] = std::array::from_fn(|k| m.centre[k]);
            let near = (0..truth.distance.len()).filter(|&i| truth.distance[i] < 2.0);
            let fit = |&i: &usize| {
                let at = [i % nx, i / nx % ny, i / (nx * ny)].map(|c| c as f64);
                let off = dot(geometry::sub(at, middle), n).abs();
                let aligned = dot(truth.direction[i].map(f64::from), n).abs();
                (1.0 - aligned) + 1e-3 * off
            };
            let best = near.min_by(|i, j| fit(i).total_cmp(&fit(j))).unwrap();
            let at = [best % nx, best / nx % ny, best / (nx * ny)].map(|c| c as f64);
            let exact = truth.direction[best].map(f64::from);
            if kind == SyntheticKind::Planes {
                let foot = geometry::add_scaled(at, f64::from(truth.distance[best]), exact);
                let area = plane_area(exact, dot(foot, exact), truth.dims);
                assert!(
                    (m.area / area - 1.0).abs() < 0.05,
                    "{seed}: {} {area}",
                    m.area
                );
                assert!(
                    dot(exact, n).abs() > 0.5f64.to_radians().cos(),
                    "{exact:?} {n:?}"
                );
                assert!(m.rms_plane_distance < 0.3, "{m:?}");
            }
        }
        // In all: the volume of a layer about the faults tells their area (but for where they
        // cross: there it tells less).
        let layer = truth.distance.iter().filter(|&&d| d < 2.0).count() as f64 / 4.0;
        let all: f64 = found.iter().map(|m| m.area).sum();
        assert!(
            (all / layer - 1.03).abs() < 0.05,
            "{kind:?} {seed}: {all} {layer}"
        );

        // The same faces, but for a few, are found by the potential alone.
        let Features {
            potential, sigma, ..
        } = &outcome.features;
        let by_image = facet_selection::valley_facets(
            &outcome.simplices().unwrap().mesh,
            potential,
            *sigma,
            0.6,
            0.82,
        );
        let marked = marked_facets(&outcome);
        let both = by_image
            .iter()
            .filter(|f| marked.binary_search(f).is_ok())
            .count();
        let [one, other] = [&marked, &by_image].map(|list| both as f64 / list.len() as f64);
        assert!(one > 0.95 && other > 0.8, "{one} {other}");
    }
}

/// Three layers, folded and thrown by a fault: six units.
fn layer_unit([x, y, z]: [f64; 3]) -> u32 {
    let beyond = y - 30.0 + 0.35 * (x - 36.0) - 0.15 * (z - 26.0) > 0.0;
    let depth = x + 2.0 * (z * 0.1).sin() + if beyond { 9.0 } else { 0.0 };
    let layer = [22.0, 48.0].iter().filter(|&&top| depth > top).count() as u32;
    layer + if beyond { 3 } else { 0 }
}

#[test]
fn painted_units_have_their_volume_and_do_not_leak() {
    let dims = [72, 60, 52];
    let image = image(dims, |x| f64::from(layer_unit(x)));
    let outcome = mesh(&image, feature::FeatureKind::Labels, 6.0);
    let mut closed = group_facets(&outcome, Some(0.0)).facets;
    closed.iter_mut().for_each(|f| f.sort_unstable());
    closed.sort_unstable();
    let cells = cells(&outcome.simplices().unwrap().mesh, &closed);
    let (block, count) = blocks(&cells, 0.3, 24);
    assert_eq!(count, 6);
    let of_image = &outcome.simplices().unwrap().mesh;
    let ways = Geodesics::new(of_image, &of_image.cells_of_faces().unwrap(), &cells);

    // The truth: the volume of each unit, by points half a sample apart.
    let mut truth = [0.0; 6];
    let fine = dims.map(|n| 2 * (n - 1));
    for z in 0..fine[2] {
        for y in 0..fine[1] {
            for x in 0..fine[0] {
                truth[layer_unit([x, y, z].map(|c| 0.5 * c as f64 + 0.25)) as usize] += 0.125;
            }
        }
    }
    // A seed in the middle of each unit, one unit after the other: nothing else stops the paint.
    let places = [
        [10.0, 20.0],
        [32.0, 15.0],
        [60.0, 8.0],
        [6.0, 50.0],
        [26.0, 48.0],
        [55.0, 45.0],
    ];
    for [x, y] in places {
        let seed = [x, y, 25.3];
        let want = layer_unit(seed);
        let source = GeodesicSource {
            position: seed,
            cell: cell_at(of_image, seed),
            label: want,
        };
        let painted = flow(&ways, &block, None, &[source], f64::INFINITY).label;
        let (mut all, mut wrong) = (0.0, 0.0);
        for t in 0..cells.len() {
            if painted[t].is_some() {
                all += cells.volumes[t];
                if layer_unit(cells.centres[t]) != want {
                    wrong += cells.volumes[t];
                }
            }
        }
        let true_volume = truth[want as usize];
        assert!(
            (all / true_volume - 1.0).abs() < 0.03,
            "unit {want}: {all} {true_volume}"
        );
        assert!(
            wrong < 0.02 * true_volume,
            "unit {want}: {wrong} of {true_volume} leaked"
        );
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let outcome = mesh(
        &image([40, 36, 32], |x| {
            f64::from(u8::from(x[0] + 0.3 * x[1] > 25.0))
        }),
        feature::FeatureKind::Labels,
        6.0,
    );
    let run = || {
        let surfaces = group_facets(&outcome, None);
        let cells = cells(&outcome.simplices().unwrap().mesh, &surfaces.facets);
        (surfaces, blocks(&cells, 0.3, 10))
    };
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let four = rayon::ThreadPoolBuilder::new()
        .num_threads(4)
        .build()
        .unwrap();
    assert_eq!(one.install(run), four.install(run));
}
