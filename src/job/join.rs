//! The step from atoms at rest to a mesh, which differs between the plane and space.

use super::StageRunner;
use super::checkpoint::Codec;
use super::periodic::{MatchSides, MatchedSides};
use super::scene::MeshScene;
use crate::Result;
use crate::comm::SelfComm;
use crate::improve::tets::{DistributedSlabs, ImproveContext, KnownAtoms, SharedWork};
use crate::improve::{ImproveReport, SliverMethod, Target, tets, triangles};
use crate::lattice::AtomKind;
use crate::lattice::seeding::Atoms;
use crate::mesh::delaunay::{self, Delaunay};
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::progress::{CancelToken, Stage};
use crate::published::relax::{self, Relaxation};
use crate::report::{AngleAssessment, Improvement};

/// Simplices into which atoms are joined.
pub trait JoinAtoms<const D: usize>: Simplices<D> + MatchSides<D> + Codec {
    /// Snaps the atoms that are close to a feature onto it, joins all atoms, and improves the mesh
    /// until every angle is at least as large as `improvement` requires, if that is possible.
    /// Without `improvement` the atoms are only joined. In the plane, the triangulation is smoothed
    /// before that as `relaxation` says. If the job is stopped, smoothing and improvement end
    /// early. `sides` are the faces of a periodic mesh on its sides, and its atoms.
    ///
    /// # Errors
    /// Returns the errors of the triangulation.
    fn join(
        atoms: Atoms<D>,
        scene: &MeshScene<'_, D>,
        relaxation: Option<&Relaxation<D>>,
        improvement: Option<&Target>,
        sides: Option<&MatchedSides<D>>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<Self>>;
}

/// A mesh of simplices, with data on its nodes, faces and cells.
#[derive(Debug, Clone)]
pub struct AnnotatedMesh<M> {
    /// The mesh.
    pub mesh: M,
    /// The kind of each node, which says how it may move.
    pub node_kinds: Vec<AtomKind>,
    /// For each cell, bit k: its face (edge, in the plane) k, opposite node k, lies on a feature.
    pub feature_faces: Vec<u8>,
    /// The region of each cell; empty if the image has no labels.
    pub regions: Vec<i32>,
    /// Which angles the features explain; empty until the mesh is measured.
    pub angle_assessment: AngleAssessment,
}

/// A mesh into which atoms were joined.
#[derive(Debug)]
pub struct JoinedMesh<M> {
    /// The mesh.
    pub annotated_mesh: AnnotatedMesh<M>,
    /// For every cell and face, in order, the cell on the other side, if known.
    pub neighbours: Option<Vec<u32>>,
    /// Report of the improvement, if there was one.
    pub improvement: Option<Improvement>,
    /// For exudation, the mesh that Joe's transformations make of the same atoms, and its faces on
    /// features.
    pub baseline: Option<(M, Vec<u8>)>,
}

impl<M> AnnotatedMesh<M> {
    /// Returns a mesh without regions that is not measured yet.
    fn new(mesh: M, node_kinds: Vec<AtomKind>, feature_faces: Vec<u8>) -> Self {
        Self {
            mesh,
            node_kinds,
            feature_faces,
            regions: Vec::new(),
            angle_assessment: AngleAssessment::default(),
        }
    }
}

impl<M> JoinedMesh<M> {
    /// Returns a mesh that is not improved.
    fn unimproved<const D: usize>(
        mesh: M,
        kinds: Vec<AtomKind>,
        neighbours: Option<Vec<u32>>,
    ) -> Self
    where
        M: Simplices<D>,
    {
        let feature_faces = vec![0; mesh.len()];
        Self {
            annotated_mesh: AnnotatedMesh::new(mesh, kinds, feature_faces),
            neighbours,
            improvement: None,
            baseline: None,
        }
    }
}

/// Improves a whole mesh slab by slab, as [`tets::improve`] does it at once.
fn improve_slabs(
    mesh: &mut TetMesh,
    neighbours: &mut Vec<[u32; 4]>,
    kinds: &mut Vec<AtomKind>,
    slabs: &DistributedSlabs<'_>,
    context: ImproveContext<'_>,
    cancel: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let TetMesh { nodes, tets } = std::mem::take(mesh);
    let joined = std::mem::take(neighbours);
    let atoms = KnownAtoms {
        global_count: nodes.len(),
        atoms: Atoms {
            positions: nodes,
            kinds: std::mem::take(kinds),
        },
        global_ids: None,
    };
    let improved = slabs.improve(atoms, tets, joined, context, cancel)?;
    let improved = slabs.all_gather(improved)?;
    (*mesh, *neighbours) = (improved.partition.mesh, improved.partition.neighbours);
    *kinds = improved.kinds;
    Ok((improved.report, improved.feature_faces))
}

impl JoinAtoms<3> for TetMesh {
    fn join(
        mut atoms: Atoms<3>,
        scene: &MeshScene<'_, 3>,
        _: Option<&Relaxation<3>>,
        improvement: Option<&Target>,
        sides: Option<&MatchedSides<3>>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<TetMesh>> {
        let (extent, distance, comm) = (scene.extent, scene.distance, stages.comm);
        let kernel = stages.kernel;
        // The cuts are at the same places, whether this rank has all atoms or not.
        let slabs = match improvement {
            Some(_) if sides.is_none() => {
                DistributedSlabs::cut(&atoms.positions, extent, distance, &SelfComm)?
            }
            _ => None,
        };
        let slabs = slabs.map(|slabs| DistributedSlabs::new(slabs.cuts, comm));
        let Atoms { positions, kinds } = &mut atoms;
        // The atoms of a periodic mesh are on features already.
        let planes = improvement.map(|_| match sides {
            Some(_) => scene.local_planes(),
            None => scene.snap(positions, kinds),
        });
        stages.begin(Stage::Triangulating);
        let Delaunay {
            mut mesh,
            mut neighbours,
        } = stages.load_or_run("4-joined", |_| {
            delaunay::distributed_delaunay_with_neighbours(&atoms.positions, kernel, comm)
        })?;
        let mut kinds = atoms.kinds;
        let (Some(&target), Some(planes)) = (improvement, &planes) else {
            return Ok(JoinedMesh::unimproved(
                mesh,
                kinds,
                Some(neighbours.into_flattened()),
            ));
        };
        let context = ImproveContext {
            extent,
            planes,
            distance,
            target,
        };
        let (mut baseline, work) = (None, SharedWork::among(comm));
        let (neighbours, (outcome, feature_faces)) = match target.method {
            SliverMethod::Joe => {
                stages.begin(Stage::Improving);
                let result = stages.run_cancellable(|cancel| {
                    let (mesh, neighbours) = (&mut mesh, &mut neighbours);
                    let kinds = &mut kinds;
                    match (&slabs, sides) {
                        (_, Some(sides)) => {
                            let sides = &sides.by_side();
                            tets::improve_between(mesh, neighbours, kinds, sides, context, cancel)
                        }
                        (Some(slabs), None) => {
                            improve_slabs(mesh, neighbours, kinds, slabs, context, cancel)
                        }
                        (None, None) => {
                            tets::improve(mesh, neighbours, kinds, context, work, cancel)
                        }
                    }
                })?;
                (Some(neighbours.into_flattened()), result)
            }
            SliverMethod::Exude | SliverMethod::ExudeCgal => {
                stages.begin(Stage::ApplyingBaseline);
                let (mut baseline_mesh, mut baseline_kinds) = (mesh.clone(), kinds.clone());
                let (_, faces) = stages.run_cancellable(|cancel| {
                    let (mesh, neighbours) = (&mut baseline_mesh, &mut neighbours.clone());
                    tets::improve(mesh, neighbours, &mut baseline_kinds, context, work, cancel)
                })?;
                baseline = Some((baseline_mesh, faces));
                stages.begin(Stage::Improving);
                let result = stages.run_cancellable(|cancel| {
                    tets::exude(&mut mesh, neighbours, &mut kinds, context, work, cancel)
                })?;
                (None, result)
            }
        };
        Ok(JoinedMesh {
            annotated_mesh: AnnotatedMesh::new(mesh, kinds, feature_faces),
            neighbours,
            improvement: Some(outcome.into()),
            baseline,
        })
    }
}

impl JoinAtoms<2> for TriMesh {
    fn join(
        mut atoms: Atoms<2>,
        scene: &MeshScene<'_, 2>,
        relaxation: Option<&Relaxation<2>>,
        improvement: Option<&Target>,
        sides: Option<&MatchedSides<2>>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<TriMesh>> {
        let (extent, distance) = (scene.extent, scene.distance);
        let needs_planes = improvement.is_some() || relaxation.is_some();
        let Atoms { positions, kinds } = &mut atoms;
        let planes = needs_planes.then(|| match sides {
            Some(_) => scene.local_planes(),
            None => scene.snap(positions, kinds),
        });
        stages.begin(Stage::Triangulating);
        let mut mesh = match (relaxation, &planes) {
            (Some(relaxation), Some(planes)) => {
                stages.begin(Stage::Smoothing);
                let mobility = triangles::mobility(&atoms, extent, planes);
                let feature_edges = triangles::feature_edges(&atoms, extent, planes, distance)?;
                stages
                    .run_cancellable(|cancel| {
                        let points = atoms.positions;
                        relax::relax(points, &feature_edges, &mobility, relaxation, cancel)
                    })?
                    .0
            }
            _ => delaunay::delaunay_plane(&atoms.positions)?,
        };
        let mut kinds = atoms.kinds;
        let (Some(options), Some(planes)) = (improvement, &planes) else {
            return Ok(JoinedMesh::unimproved(mesh, kinds, None));
        };
        stages.begin(Stage::Improving);
        let (outcome, feature_faces) = stages.run_cancellable(|cancel| {
            triangles::improve(
                &mut mesh,
                &mut kinds,
                extent,
                planes,
                distance,
                options.min_dihedral,
                cancel,
            )
        })?;
        Ok(JoinedMesh {
            annotated_mesh: AnnotatedMesh::new(mesh, kinds, feature_faces),
            neighbours: None,
            improvement: Some(outcome.into()),
            baseline: None,
        })
    }
}
