//! A job has the same result for any number of ranks.

use super::*;
use crate::comm::run_threads;
use crate::feature::scenes::{ExactSurface, ridge_image};
use crate::job::spec::MeshSpec;
use crate::mesh::TetMesh;
use crate::progress::NoProgress;

/// Returns an image of two surfaces that cross, and parameters with this distance.
fn job(dims: [usize; 3], distance: f64) -> (Image<3>, Params<3>) {
    let middle = dims.map(|n| 0.5 * n as f64);
    let surfaces = [
        ExactSurface::plane([1.0, 0.4, 0.2], middle),
        ExactSurface::plane([-0.3, 1.0, 0.1], middle),
    ];
    let spec = MeshSpec {
        distance: NominalDistance::Constant(distance),
        ..MeshSpec::default()
    };
    (
        ridge_image(dims, &surfaces, 1.5, 0.1),
        Params::new(spec).unwrap(),
    )
}

/// Returns the outcome of a job on each of `count` ranks.
fn run_ranks(
    (image, params): &(Image<3>, Params<3>),
    count: usize,
    may_partition: bool,
) -> Vec<Outcome<3>> {
    run_threads(count, |comm| {
        let options = RunOptions {
            may_partition,
            comm,
            ..RunOptions::default()
        };
        run_from(
            ImageSource::InMemory(image),
            params,
            options,
            &mut NoProgress,
        )
        .unwrap()
    })
}

fn annotated(outcome: &Outcome<3>) -> &AnnotatedMesh<TetMesh> {
    outcome.simplices().unwrap()
}

/// Asserts that two reports have the same figures, except for rounded sums.
fn assert_same_figures(actual: &Report, expected: &Report) {
    assert_eq!(actual.fidelity, expected.fidelity);
    assert_eq!(actual.lattice, expected.lattice);
    assert_eq!(actual.improvement, expected.improvement);
    assert_eq!(actual.notes, expected.notes);
    let worst = |report: &Report| report.quality.clone().unwrap().worst;
    assert_eq!(worst(actual), worst(expected));
}

#[test]
fn every_rank_has_the_whole_of_a_small_mesh() {
    let job = job([48, 44, 40], 7.0);
    let expected = &run_ranks(&job, 1, false)[0];
    for count in [2, 3] {
        for outcome in run_ranks(&job, count, true) {
            assert!(outcome.share.is_none());
            assert_eq!(annotated(&outcome).mesh, annotated(expected).mesh);
            let marks = &annotated(&outcome).feature_faces;
            assert_eq!(*marks, annotated(expected).feature_faces);
            assert_same_figures(&outcome.report, &expected.report);
        }
    }
}

#[test]
#[ignore = "slow: make test-all"]
fn partitions_of_a_large_mesh_are_the_mesh_of_one_rank() {
    let job = job([320, 60, 50], 3.0);
    let expected = &run_ranks(&job, 1, false)[0];
    let whole = annotated(expected);
    for (count, may_partition) in [(2, false), (2, true), (3, true)] {
        let (mut tets, mut marks) = (Vec::new(), Vec::<u8>::new());
        for outcome in run_ranks(&job, count, may_partition) {
            assert_same_figures(&outcome.report, &expected.report);
            let local = annotated(&outcome);
            let Some(share) = &outcome.share else {
                assert!(!may_partition && local.mesh == whole.mesh);
                continue;
            };
            assert_eq!(share.first_cell, tets.len());
            for (x, &n) in local.mesh.nodes.iter().zip(&share.nodes) {
                assert_eq!(*x, whole.mesh.nodes[n as usize]);
            }
            let global = |tet: &[u32; 4]| tet.map(|n| share.nodes[n as usize]);
            tets.extend(local.mesh.tets.iter().map(global));
            marks.extend(&local.feature_faces);
        }
        if may_partition {
            assert!(tets == whole.mesh.tets && marks == whole.feature_faces);
        }
    }
}
