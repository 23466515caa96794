//! Tests of surfaces in meshes of images, against the known features of these.

use super::*;
use crate::feature::{self, Features};
use crate::image::synth::{self, SyntheticKind};
use crate::image::{Geometry, Image};
use crate::job::spec::{MeshSpec, NominalDistance};
use crate::job::{self, Outcome, Params};
use crate::lattice::optimise::NoProgress;
use crate::mesh::interface::marks_from_bits;

fn mesh(image: &Image<3>, kind: feature::FeatureKind, d: f64) -> Outcome {
    let params = Params::new(MeshSpec {
        distance: NominalDistance::Constant(d),
        feature: kind,
        ..MeshSpec::default()
    })
    .unwrap();
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

/// Returns the area of the plane n.x = c in the box, by sampling it over the two axes to which it
/// is least inclined.
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
fn all_synthetic_faults_are_found() {
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
        let synthetic = synth::make(kind, &options).unwrap();
        let outcome = mesh(&synthetic.image, feature::FeatureKind::Ridges, 6.0);
        let surfaces = group_facets(&outcome, None);
        let measures = measure(
            &surfaces,
            &outcome.simplices().unwrap().mesh.nodes,
            &MapAxes::from_axis(0, true),
            &[],
        );
        assert_eq!(measures.len(), 3, "{kind:?} {seed}: {measures:#?}");
        let truth = &synthetic.truth;
        let position = |i: usize| truth.index_of(i).map(|c| c as f64);
        for m in &measures {
            // The exact plane comes from a nearby sample whose true orientation fits the surface
            // best.
            let n: [f64; 3] = std::array::from_fn(|k| m.normal[k]);
            let middle: [f64; 3] = std::array::from_fn(|k| m.centre[k]);
            let candidates = (0..truth.distance.len()).filter(|&i| truth.distance[i] < 2.0);
            let fit = |&i: &usize| {
                let distance = dot(geometry::sub(position(i), middle), n).abs();
                let aligned = dot(truth.direction[i].map(f64::from), n).abs();
                (1.0 - aligned) + 1e-3 * distance
            };
            let best = candidates.min_by(|i, j| fit(i).total_cmp(&fit(j))).unwrap();
            let position = position(best);
            let exact = truth.direction[best].map(f64::from);
            if kind == SyntheticKind::Planes {
                let foot = geometry::add_scaled(position, f64::from(truth.distance[best]), exact);
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
        // The volume of a layer around the faults gives their total area (a little less where they
        // cross).
        let layer = truth.distance.iter().filter(|&&d| d < 2.0).count() as f64 / 4.0;
        let total_area: f64 = measures.iter().map(|m| m.area).sum();
        assert!(
            (total_area / layer - 1.03).abs() < 0.05,
            "{kind:?} {seed}: {total_area} {layer}"
        );

        // The potential alone finds almost the same faces.
        let Features {
            potential, sigma, ..
        } = &outcome.features;
        let valley_facets = facet_selection::valley_facets(
            &outcome.simplices().unwrap().mesh,
            potential,
            *sigma,
            0.6,
            0.82,
        );
        let marked = marked_facets(&outcome);
        let common_count = valley_facets
            .iter()
            .filter(|f| marked.binary_search(f).is_ok())
            .count();
        let [marked_share, valley_share] =
            [&marked, &valley_facets].map(|list| common_count as f64 / list.len() as f64);
        assert!(
            marked_share > 0.95 && valley_share > 0.8,
            "{marked_share} {valley_share}"
        );
    }
}

/// Returns the unit of a point: three folded layers that a fault displaces give six units.
fn layer_unit([x, y, z]: [f64; 3]) -> u32 {
    let is_beyond = y - 30.0 + 0.35 * (x - 36.0) - 0.15 * (z - 26.0) > 0.0;
    let depth = x + 2.0 * (z * 0.1).sin() + if is_beyond { 9.0 } else { 0.0 };
    let layer = [22.0, 48.0].iter().filter(|&&top| depth > top).count() as u32;
    layer + if is_beyond { 3 } else { 0 }
}

#[test]
fn painted_units_have_their_volume_and_do_not_leak() {
    let dims = [72, 60, 52];
    let image = Image::from_fn(dims, Geometry::default(), |x| f64::from(layer_unit(x)));
    let outcome = mesh(&image, feature::FeatureKind::Labels, 6.0);
    let mut closed = group_facets(&outcome, Some(0.0)).facets;
    closed.iter_mut().for_each(|f| f.sort_unstable());
    closed.sort_unstable();
    let cells = cells(&outcome.simplices().unwrap().mesh, &closed);
    let (block, count) = blocks(&cells, 0.3, 24);
    assert_eq!(count, 6);
    let image_mesh = &outcome.simplices().unwrap().mesh;
    let geodesics = Geodesics::new(image_mesh, &image_mesh.cells_of_faces().unwrap(), &cells);

    // The true volume of each unit, from points half a sample apart.
    let mut truth = [0.0; 6];
    let fine_dims = dims.map(|n| 2 * (n - 1));
    for z in 0..fine_dims[2] {
        for y in 0..fine_dims[1] {
            for x in 0..fine_dims[0] {
                truth[layer_unit([x, y, z].map(|c| 0.5 * c as f64 + 0.25)) as usize] += 0.125;
            }
        }
    }
    // One seed in the middle of each unit, painted one after the other, so that nothing else stops
    // the paint.
    let positions = [
        [10.0, 20.0],
        [32.0, 15.0],
        [60.0, 8.0],
        [6.0, 50.0],
        [26.0, 48.0],
        [55.0, 45.0],
    ];
    for [x, y] in positions {
        let seed = [x, y, 25.3];
        let expected = layer_unit(seed);
        let source = GeodesicSource {
            position: seed,
            cell: cell_at(image_mesh, seed),
            label: expected,
        };
        let painted = grow(&geodesics, &block, None, &[source], f64::INFINITY).label;
        let (mut painted_volume, mut leaked_volume) = (0.0, 0.0);
        for t in 0..cells.len() {
            if painted[t].is_some() {
                painted_volume += cells.volumes[t];
                if layer_unit(cells.centres[t]) != expected {
                    leaked_volume += cells.volumes[t];
                }
            }
        }
        let true_volume = truth[expected as usize];
        assert!(
            (painted_volume / true_volume - 1.0).abs() < 0.03,
            "unit {expected}: {painted_volume} {true_volume}"
        );
        assert!(
            leaked_volume < 0.02 * true_volume,
            "unit {expected}: {leaked_volume} of {true_volume} leaked"
        );
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let outcome = mesh(
        &Image::from_fn([40, 36, 32], Geometry::default(), |x| {
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
    let single = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let four = rayon::ThreadPoolBuilder::new()
        .num_threads(4)
        .build()
        .unwrap();
    assert_eq!(single.install(run), four.install(run));
}
