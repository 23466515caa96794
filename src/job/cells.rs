//! Image in, Voronoi cells (PEBI grid) out: atoms alongside features, so that the faces between them
//! follow the features.

use rayon::prelude::*;

use super::join::Scene;
use super::{BOX_TOLERANCE, Meshing, Params, Settled, Space, optimisation, pairs, settle};
use crate::Result;
use crate::feature::Features;
use crate::geometry::{add_scaled, dot, in_space, norm, sub};
use crate::image::{Geometry, Image};
use crate::improve::sheets::{SAME_SHEET, Sheets};
use crate::lattice::distance::Distance;
use crate::lattice::energy::{Beta, Pairwise};
use crate::lattice::optimize::{self, Observer};
use crate::lattice::seeding::Alignment;
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::mesh::poly_check::check_welded;
use crate::report::{self, Lattice, Reference, Report};

/// Voronoi cells in lattice space, and what led to them.
#[derive(Debug, Clone)]
pub struct CellsOutcome<const D: usize = 3> {
    /// The cells; they fill the box `[0, extent]`.
    pub mesh: PolyMesh<D>,
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis.
    pub step: [f64; D],
    /// What the cells follow.
    pub features: Features<D>,
    /// Nominal distance between atoms.
    pub distance: Distance<D>,
    /// Share of the cells' size within which nodes are welded.
    pub weld: f64,
    /// What the optimiser did in its last pass, and why it stopped.
    pub optimised: optimize::Rest,
    /// Figures of the cells and of what they cost; where they come from is for the caller to add.
    pub report: Report,
}

/// Evaluations in which the other atoms make room for pairs.
const PAIRED_EVALUATIONS: usize = 15;

/// Makes Voronoi cells of an image. Of `params`, the smallest angle has no meaning here.
///
/// # Errors
/// As [`mesh_image`](super::mesh_image); also for fixed atoms on a side of the box, and for the
/// sampled potential.
pub fn voronoi_image<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    observer: &mut dyn Observer,
) -> Result<CellsOutcome<D>>
where
    Space<D>: Meshing<D>,
{
    let Settled {
        mut stages,
        extent,
        step,
        features,
        distance,
        mut atoms,
        optimised,
    } = settle(image, params, Alignment::Alongside, observer)?;
    let sheets = Space::<D>::sheets(&Scene {
        extent,
        features: &features,
        distance: &distance,
    });
    if !features.points.is_empty() {
        stages.begin("pairing atoms");
        let points: Vec<_> = features.points.iter().map(Space::<D>::in_space).collect();
        atoms = pairs::mirrored(&atoms, extent, &points, &sheets, &distance);
        let options = optimize::Effort {
            seed: params.seed,
            max_rounds: 1,
            max_evaluations: PAIRED_EVALUATIONS,
            ..optimize::Effort::default()
        };
        let energy = Pairwise::new(extent, &distance, None, Beta::Constant(0.0))?;
        let mut energy = energy.aligned(Alignment::Alongside);
        optimize::optimize(
            &mut atoms,
            &mut energy,
            &distance,
            extent,
            &options,
            stages.observer,
        )?;
    }
    stages.begin("cutting cells");
    let mut mesh = Space::<D>::cells(&atoms.positions, extent, params.weld)?;
    mesh.on_feature = across(&mesh, &sheets);

    stages.begin("measuring the mesh");
    let graph = Graph::from_poly(&mesh);
    let physical = Graph::from_poly(&to_world(&mesh, step, &image.geometry));
    let check = check_welded(&mesh, [0.0; D], extent, BOX_TOLERANCE, params.weld);
    let mut report = Report {
        voronoi: Some(report::voronoi(check, &graph, &physical)),
        lattice: Some(Lattice {
            optimisation: Some(optimisation(&optimised, mesh.sites.len())),
            ..report::lattice_of_graph(&graph, |x| distance.at(x))
        }),
        ..Report::default()
    };
    if !features.points.is_empty() {
        let reference = Reference::from_features(&features);
        report.fidelity = Some(fidelity(&mesh, step, &reference));
    }
    report.notes.extend(features.notes.iter().cloned());
    stages.clock.end();
    report.stages = stages.clock.costs().to_vec();
    Ok(CellsOutcome {
        mesh,
        extent,
        step,
        features,
        distance,
        weld: params.weld,
        optimised,
        report,
    })
}

/// Fidelity of cells in a lattice space where samples are `step` apart.
pub fn fidelity<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    reference: &Reference<'_, D>,
) -> report::Fidelity {
    let in_samples = mesh.mapped(|x| std::array::from_fn(|k| x[k] / step[k]), false);
    report::fidelity_of_cells(&in_samples, reference)
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
