//! Nodes are added, removed and moved.

use super::*;
use crate::geometry::random::Random;
use crate::improve::Target;
use crate::improve::feature_planes::FeaturePlanes;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::{Alignment, fcc};
use crate::mesh::check::check;
use crate::mesh::delaunay;

const EXTENT: [f64; 3] = [24.0, 20.0, 22.0];

#[test]
fn circumsphere_of_a_corner() {
    let p = [[0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]];
    assert!(volume6(&p) > 0.0);
    let radius = 3f64.sqrt();
    for (fraction, inside) in [(0.0, true), (0.99, true), (1.01, false)] {
        let x = [1.0 + fraction * radius, 1.0, 1.0];
        assert_eq!(is_in_circumsphere(&p, x), inside, "{fraction}");
    }
}

/// Returns a box of atoms with spacing 4.
fn box_part() -> (TetMesh, Vec<AtomKind>) {
    let atoms = fcc(EXTENT, &Distance::Constant(4.0), &[], Alignment::OnFeatures).unwrap();
    let mesh = delaunay::delaunay(&atoms.positions).unwrap();
    (mesh, atoms.kinds)
}

fn context<'a>(planes: &'a FeaturePlanes, distance: &'a Distance<3>) -> ImproveContext<'a> {
    ImproveContext {
        extent: EXTENT,
        planes,
        distance,
        target: Target::default(),
    }
}

fn reshape_checked(mesh: TetMesh, request: &ReshapeRequest<3>) -> ReshapeResult<TetMesh> {
    let planes = FeaturePlanes::new(&[], EXTENT, 3.0, 4.0);
    let distance = Distance::Constant(4.0);
    let angle = Target::default().min_dihedral;
    let result = mesh
        .reshape(request, EXTENT, &planes, &distance, angle)
        .unwrap_or_else(|why| panic!("{why:?} of {:?}", request.kinds));
    let checked = check(&result.mesh, [0.0; 3], EXTENT, 1e-9);
    assert!(checked.passed(), "{:?}", checked.problems);
    result
}

#[test]
fn every_atom_but_corners_can_be_removed() {
    let (mesh, kinds) = box_part();
    for node in (0..kinds.len())
        .filter(|&n| kinds[n] != AtomKind::Corner)
        .step_by(3)
    {
        let mut is_removed = vec![false; kinds.len()];
        is_removed[node] = true;
        let request = ReshapeRequest {
            targets: mesh.nodes.clone(),
            kinds: kinds.clone(),
            is_removed,
        };
        let result = reshape_checked(mesh.clone(), &request);
        assert!(!result.request_nodes.contains(&(node as u32)));
        assert!(
            result.report.blocked.len() < 6,
            "{node}: {:?}",
            result.report
        );
    }
}

#[test]
fn atoms_can_be_inserted_anywhere_also_on_faces_edges_and_sides() {
    let (mesh, kinds) = box_part();
    let middle = |nodes: &[u32]| -> [f64; 3] {
        let sum = |k: usize| {
            nodes
                .iter()
                .map(|&n| mesh.nodes[n as usize][k])
                .sum::<f64>()
        };
        std::array::from_fn(|k| sum(k) / nodes.len() as f64)
    };
    for t in (0..mesh.tets.len()).step_by(11) {
        for count in [2, 3, 4] {
            let x = middle(&mesh.tets[t][..count]);
            let mut request = ReshapeRequest {
                targets: mesh.nodes.clone(),
                kinds: kinds.clone(),
                is_removed: vec![false; kinds.len() + 1],
            };
            request.targets.push(x);
            request.kinds.push(AtomKind::Fixed);
            let result = reshape_checked(mesh.clone(), &request);
            let node = result
                .request_nodes
                .iter()
                .position(|&n| n as usize == kinds.len())
                .unwrap();
            assert_eq!(
                (result.mesh.nodes[node], result.kinds[node]),
                (x, AtomKind::Fixed)
            );
        }
    }
}

#[test]
fn nodes_reach_their_targets() {
    let (mesh, kinds) = box_part();
    // A wave through the box that leaves the sides unchanged.
    let targets: Vec<[f64; 3]> = (mesh.nodes.iter())
        .map(|x| {
            let mut y = *x;
            let inside = (0..3).all(|k| x[k] > 0.0 && x[k] < EXTENT[k]);
            if inside {
                y[0] += 0.8 * (0.5 * x[1]).sin();
                y[2] += 0.8 * (0.4 * x[0]).cos();
            }
            y
        })
        .collect();
    let is_removed = vec![false; kinds.len()];
    let fixed = vec![AtomKind::Fixed; kinds.len()];
    let request = ReshapeRequest {
        targets: targets.clone(),
        kinds: fixed,
        is_removed,
    };
    let result = reshape_checked(mesh, &request);
    for (x, &n) in result.mesh.nodes.iter().zip(&result.request_nodes) {
        if let Some(target) = targets.get(n as usize) {
            assert_eq!(x, target);
        }
    }
}

#[test]
fn containing_tet_is_the_one_in_which_the_position_lies_deepest() {
    // A box with a dent: positions behind it cannot be reached by a straight walk.
    let (mut mesh, kinds) = box_part();
    let middle =
        |t: &[u32; 4], k: usize| t.iter().map(|&n| mesh.nodes[n as usize][k]).sum::<f64>() / 4.0;
    let kept: Vec<[u32; 4]> = mesh
        .tets
        .iter()
        .copied()
        .filter(|t| middle(t, 0) < 6.0 || middle(t, 1) < 4.0 || middle(t, 1) > 8.0)
        .collect();
    assert!(kept.len() < mesh.tets.len() - 10);
    mesh.tets = kept;
    let neighbours = complex::neighbours(mesh.nodes.len(), &mesh.tets).unwrap();
    let planes = FeaturePlanes::new(&[], EXTENT, 3.0, 4.0);
    let distance = Distance::Constant(4.0);
    let tets = mesh.tets.clone();
    let nodes = mesh.nodes.clone();
    let context = context(&planes, &distance);
    let cancel = &CancelToken::never();
    let mut improver = TetImprover::new(mesh, neighbours, &kinds, context, cancel);
    improver.target_sine = 0.2;
    let mut random = Random::new(9);
    let mut position = || EXTENT.map(|l| l * random.draw());
    let mut positions: Vec<[f64; 3]> = (0..400).map(|_| position()).collect();
    // Positions on nodes, edges and faces, too.
    for t in tets.iter().step_by(5) {
        for count in 1..4 {
            let sum = |k: usize| {
                t[..count]
                    .iter()
                    .map(|&n| nodes[n as usize][k])
                    .sum::<f64>()
            };
            positions.push(std::array::from_fn(|k| sum(k) / count as f64));
        }
    }
    let mut outside = 0;
    for (i, x) in positions.into_iter().enumerate() {
        improver.slots = vec![(i * 37 % tets.len()) as u32];
        let best = (0..tets.len() as u32)
            .map(|t| (improver.min_barycentric(t, x), t))
            .fold((-1e-9, None), |best, (value, t)| {
                if value > best.0 {
                    (value, Some(t))
                } else {
                    best
                }
            });
        assert_eq!(improver.containing_tet(x), best.1, "{x:?}");
        outside += usize::from(best.1.is_none());
    }
    assert!((20..200).contains(&outside), "{outside}");
}

#[test]
fn a_part_in_which_three_tetrahedra_share_a_face_is_refused() {
    let nodes = vec![
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.1, 0.1, 2.0],
        [0.2, 0.2, -1.0],
    ];
    let mesh = TetMesh {
        tets: vec![[0, 1, 2, 3], [0, 1, 2, 4], [0, 2, 1, 5]],
        nodes,
    };
    let request = ReshapeRequest {
        targets: mesh.nodes.clone(),
        kinds: vec![AtomKind::Interior; 6],
        is_removed: vec![false; 6],
    };
    let planes = FeaturePlanes::new(&[], EXTENT, 3.0, 4.0);
    let distance = Distance::Constant(4.0);
    let result = mesh.reshape(
        &request,
        EXTENT,
        &planes,
        &distance,
        Target::default().min_dihedral,
    );
    let Err(ReshapeError::Mesh(error)) = result else {
        panic!("{result:?}");
    };
    assert!(error.to_string().contains("more than two"), "{error}");
}
