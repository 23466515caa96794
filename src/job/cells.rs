//! Atoms at rest become Voronoi cells (a PEBI grid): they are alongside features, so that the faces
//! between them follow the features.

use rayon::prelude::*;

use super::measure::measured;
use super::{BOX_TOLERANCE, Made, Meshing, Params, Scene, Space, Stages, pairs};
use crate::Result;
use crate::geometry::{add_scaled, dot, in_space, norm, sub};
use crate::image::{Geometry, Image};
use crate::improve::sheets::{SAME_SHEET, Sheets};
use crate::lattice::energy::{Beta, Pairwise};
use crate::lattice::optimize::{self, Stop};
use crate::lattice::seeding::{Alignment, Atoms};
use crate::mesh::check::{Known, check_while};
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::observer::{Patience, Stage};
use crate::report::{self, Reference, Report};

/// Evaluations in which the other atoms make room for pairs.
const PAIRED_EVALUATIONS: usize = 15;

/// Cuts Voronoi cells around atoms at rest, and measures them.
pub(super) fn made<const D: usize>(
    mut atoms: Atoms<D>,
    scene: &Scene<'_, D>,
    image: &Image<D>,
    params: &Params<D>,
    stages: &mut Stages<'_>,
) -> Result<(Made<D>, Report)>
where
    Space<D>: Meshing<D>,
{
    let Scene {
        extent,
        features,
        distance,
    } = *scene;
    let weld = params.weld;
    let sheets = Space::<D>::sheets(scene);
    if !features.points.is_empty() {
        stages.begin(Stage::Pairing);
        let points: Vec<_> = features.points.iter().map(Space::<D>::in_space).collect();
        atoms = pairs::mirrored(&atoms, extent, &points, &sheets, distance);
        let options = optimize::Effort {
            seed: params.seed,
            max_rounds: 1,
            max_evaluations: PAIRED_EVALUATIONS,
            ..optimize::Effort::default()
        };
        let energy = Pairwise::new(extent, distance, None, Beta::Constant(0.0))?;
        let mut energy = energy.aligned(Alignment::Alongside);
        let moved = optimize::optimize(
            &mut atoms,
            &mut energy,
            distance,
            extent,
            &options,
            stages.observer,
        )?;
        if moved.stop == Stop::Interrupted {
            stages.stopped();
        }
    }
    stages.begin(Stage::Cutting);
    let mut mesh = Space::<D>::cells(&atoms.positions, extent, weld)?;
    mesh.on_feature = across(&mesh, &sheets);

    stages.begin(Stage::Measuring);
    let report = stages.patiently(|patience| measure(&mesh, weld, scene, image, patience));
    Ok((Made::Voronoi { mesh, weld }, report))
}

/// The figures of cells, as far as `patience` lasts: what was not measured to its end is left out.
fn measure<const D: usize>(
    mesh: &PolyMesh<D>,
    weld: f64,
    scene: &Scene<'_, D>,
    image: &Image<D>,
    patience: &Patience<'_>,
) -> Report {
    let (features, distance) = (scene.features, scene.distance);
    let step = features.potential.step;
    let graph = Graph::from_poly(mesh);
    let known = Known {
        weld,
        ..Known::default()
    };
    let voronoi = measured(patience, || {
        let low = [0.0; D];
        let check = check_while(mesh, known, low, scene.extent, BOX_TOLERANCE, patience);
        let physical = Graph::from_poly(&to_world(mesh, step, &image.geometry));
        report::voronoi(check, &graph, &physical)
    });
    let fidelity = measured(patience, || {
        let reference = Reference::from_features(features);
        let any = !features.points.is_empty();
        any.then(|| fidelity(mesh, step, &reference, patience))
    });
    Report {
        voronoi,
        lattice: Some(report::lattice_of_graph(&graph, |x| distance.at(x))),
        fidelity: fidelity.flatten(),
        ..Report::default()
    }
}

/// Fidelity of cells in a lattice space where samples are `step` apart; of no use once `patience` is
/// over.
pub fn fidelity<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> report::Fidelity {
    let in_samples = mesh.mapped(|x| std::array::from_fn(|k| x[k] / step[k]), false);
    report::fidelity_of_cells_while(&in_samples, reference, patience)
}

/// Cells in lattice space as cells where the image lies in the world.
pub fn to_world<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    geometry: &Geometry<D>,
) -> PolyMesh<D> {
    mesh.mapped(
        |x| geometry.to_physical(std::array::from_fn(|k| x[k] / step[k])),
        geometry.determinant() < 0.0,
    )
}

/// Which faces lie along a feature: those whose atoms are on either side of it, where the line
/// between them meets the face. So no way from cell to cell passes a feature but through such a face.
fn across<const D: usize>(mesh: &PolyMesh<D>, sheets: &Sheets) -> Vec<bool> {
    let inner = mesh.inner_faces();
    (0..mesh.face_cells.len())
        .into_par_iter()
        .map(|f| {
            if f >= inner {
                return false;
            }
            let [a, b] = mesh.face_cells[f].map(|c| in_space(mesh.sites[c as usize]));
            let line = sub(b, a);
            let middle = add_scaled(a, 0.5, line);
            let half = 0.5 * norm(line);
            let passes = |offset: f64, normal: [f64; 3], at: [f64; 3]| {
                let reach = 0.5 * dot(line, normal).abs();
                offset.abs() < reach && norm(sub(at, middle)) <= half
            };
            let near = sheets.near(middle);
            near.iter().any(|sheet| {
                let slope = dot(line, sheet.normal);
                if !passes(sheet.offset, sheet.normal, middle) {
                    return false;
                }
                // Once more where the line meets the plane: the sheet may end before it.
                let at = add_scaled(middle, -sheet.offset / slope, line);
                let there = sheets.near(at);
                there.iter().any(|s| {
                    dot(s.normal, sheet.normal).abs() > SAME_SHEET && s.offset.abs() < 0.25 * half
                })
            })
        })
        .collect()
}
