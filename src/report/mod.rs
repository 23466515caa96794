//! Measures meshes and the runs that made them.
//!
//! - `quality`: shapes of cells
//! - `advice`: options that were tried on a part of the image
//! - `acute`: lines at which features, or a feature and a side of the box, meet at a small angle
//! - `angle_space`: the space whose angles decide what a mesh is fit for
//! - `angles`: bad angles that these lines explain
//! - `assumptions`: what was assumed about the input
//! - `body`: the size of what the mesh fills
//! - `fidelity`: how well the faces of the mesh follow the features
//! - `given_surfaces`: how well the mesh follows the surfaces that the user gave
//! - `face_samples`: faces cut into small pieces
//! - `face_distances`: distances of feature points from faces
//! - `reference`: the features with which a mesh is compared
//! - `mesh_faces`: faces of a distributed mesh
//! - `tally`: statistics of distributed distances
//! - `codecs`: report data as bytes
//! - `lattice`: how evenly the atoms are spread
//! - `certificate`: each connected part of the image's labels, sample by sample
//! - `cells`: Voronoi cells, as flow simulators need them
//! - `padding`: cells beyond the image
//! - `regions`: regions that the labels of an image become
//! - `summary`: what everybody needs to know, for a small terminal
//! - `table`: a whole report on one screen
//! - `verdict`: a report in three lines
//! - `issues`: what is wrong with a mesh, and what helps
//! - `job_facts`: facts about the job on which the verdict depends

mod acute;
mod advice;
mod angle_space;
pub(crate) mod angles;
pub(crate) mod assumptions;
mod body;
pub(crate) mod cells;
pub mod certificate;
mod codecs;
mod face_distances;
mod face_samples;
pub(crate) mod fidelity;
mod given_surfaces;
mod issues;
mod job_facts;
pub(crate) mod lattice;
mod mesh_faces;
mod padding;
pub(crate) mod quality;
pub(crate) mod reference;
mod regions;
mod summary;
pub(crate) mod table;
mod tally;
mod verdict;

pub use crate::progress::cost::{self, Clock, StageCost};
pub use acute::{AcuteLine, AcutePair};
pub use advice::{Advice, Trial};
pub use angle_space::AngleSpace;
pub(crate) use angles::assess_angles;
pub(crate) use angles::assess_partition_angles;
pub use angles::{AngleAssessment, Angles};
pub use body::BodySize;
pub use cells::Voronoi;
pub(crate) use cells::{lattice_of_graph, measure_voronoi};
pub use certificate::Certificate;
pub use fidelity::{FaceMatch, Fidelity, SurfaceCoverage, fidelity};
pub(crate) use fidelity::{fidelity_of_cells, fidelity_of_partition};
pub use given_surfaces::GivenSurfaceReport;
pub(crate) use lattice::lattice_of_partition;
pub use lattice::{LatticeReport, Optimisation, TracedLattice};
pub use padding::{PaddingRegion, PaddingReport};
pub use quality::{Quality, quality, smallest_angles};
pub(crate) use quality::{cells_below, quality_of_partition};
pub use reference::Reference;
pub use regions::{Hole, LostParts, RegionReport, RegionSummary, VolumeReference};
pub(crate) use regions::{MIN_MISSING_SHARE, finer_distance};
pub use verdict::{Grade, Verdict};

use crate::feature::{Doubt, KindOutcome, MissingData};
use crate::improve;
use crate::mesh::check::Check;
use serde::Serialize;

/// Report on a run or a mesh. Sections that were not measured are `None`, which is null in JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Version of atomesh.
    pub version: String,
    /// Input from which the mesh was made.
    pub input: Option<Input>,
    /// Parameters of the run, with all defaults filled in.
    pub parameters: serde_json::Value,
    /// Cost of each stage, in the order in which they ran.
    pub stages: Vec<StageCost>,
    /// Atoms of the lattice.
    pub lattice: Option<LatticeReport>,
    /// Lattice at steps of the optimisation, if it was traced.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub trace: Vec<TracedLattice>,
    /// Space whose angles the verdict judges, if the image is known.
    pub angle_space: Option<AngleSpace>,
    /// Shapes in lattice space, in which cells should be well shaped.
    pub quality: Option<Quality>,
    /// Size of the box around the cells, if it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub body: Option<BodySize>,
    /// Shapes in physical space, if it differs and all its axes are lengths.
    pub quality_physical: Option<Quality>,
    /// Doubt about the kind of feature, if it was chosen from the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doubt: Option<Doubt>,
    /// For each kind of feature, the points that were found, and those that the mesh follows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub outcomes: Vec<KindOutcome>,
    /// Samples without data, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing: Option<MissingData>,
    /// Fidelity to the features.
    pub fidelity: Option<Fidelity>,
    /// Surfaces that the user gave, and how much of each the mesh follows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub given_surfaces: Vec<GivenSurfaceReport>,
    /// Check that the mesh is valid and fills its box.
    #[serde(rename = "box")]
    pub box_check: Option<Check>,
    /// Cells of a Voronoi mesh, which the sections above do not describe.
    pub voronoi: Option<Voronoi>,
    /// Regions that the labels of the image became.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub regions: Option<RegionSummary>,
    /// The regions judged by the samples of the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Certificate>,
    /// Options that were tried for the issue that the verdict names.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<Advice>,
    /// Cells beyond the image, if the mesh continues there. All other sections are about the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub padding: Option<PaddingReport>,
    /// Improvement, and the constraints that prevent more of it.
    pub improvement: Option<Improvement>,
    /// Result of the other method for the same atoms, if the two are compared.
    pub baseline: Option<Baseline>,
    /// Distance between atoms that was in use, if that of the parameters was adapted to the image.
    #[serde(skip)]
    pub distance_in_use: Option<String>,
    /// Options that make cells well shaped in physical space.
    #[serde(skip)]
    pub shape_option: String,
    /// `true` if there is memory for a mesh with half the distance between atoms.
    #[serde(skip)]
    pub has_memory_for_finer: bool,
    /// Notes for the reader of the report.
    pub notes: Vec<String>,
}

impl Default for Report {
    /// Creates a report of this version without measures.
    fn default() -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_string(),
            input: None,
            parameters: serde_json::Value::Null,
            stages: Vec::new(),
            lattice: None,
            trace: Vec::new(),
            angle_space: None,
            quality: None,
            quality_physical: None,
            doubt: None,
            outcomes: Vec::new(),
            missing: None,
            fidelity: None,
            given_surfaces: Vec::new(),
            box_check: None,
            voronoi: None,
            regions: None,
            certificate: None,
            advice: None,
            padding: None,
            improvement: None,
            baseline: None,
            body: None,
            distance_in_use: None,
            shape_option: "--metric shape".into(),
            has_memory_for_finer: true,
            notes: Vec::new(),
        }
    }
}

impl Report {
    /// Names the features of a mesh of labels: the smoothed interface, which is not the image.
    pub(crate) fn name_smoothed_interface(&mut self) {
        if let Some(fidelity) = &mut self.fidelity {
            fidelity.reference = "smoothed interface".into();
        }
    }
}

/// Input from which a mesh was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Input {
    /// Path of the file.
    pub file: String,
    /// Number of samples along each axis, x first.
    pub dims: Vec<usize>,
    /// Hash of the file, with its kind: `sha256:...`.
    pub hash: String,
}

/// Improvement of a mesh, and the constraints that prevent more of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Improvement {
    /// Number of tetrahedra below the target before.
    pub below_target_before: usize,
    /// Number of tetrahedra below the target after.
    pub below_target_after: usize,
    /// Number of changes of each kind.
    pub counts: improve::OperationCounts,
    /// Holes in the faces on features that were closed.
    pub sealed: improve::SealReport,
    /// Tetrahedra that are still below the target, grouped by the constraints on their nodes, the
    /// largest group first.
    pub blockers: Vec<Blocker>,
    /// Worst of these tetrahedra.
    pub worst: Vec<improve::BlockedCell>,
}

/// Mesh of the same atoms by another method of improvement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Baseline {
    /// Method.
    pub method: improve::SliverMethod,
    /// Shapes in lattice space.
    pub quality: Quality,
    /// Fidelity to the features.
    pub fidelity: Option<Fidelity>,
}

impl std::fmt::Display for Baseline {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            method, quality, ..
        } = self;
        write!(
            f,
            "{method} instead: {:.1} to {:.1}, {} below 30",
            quality.smallest_angle.worst, quality.largest_angle.worst, quality.below_30
        )?;
        match self.fidelity.as_ref().and_then(|f| f.tagged_faces.as_ref()) {
            Some(faces) => write!(
                f,
                "; cover {:.3} {:.3} precision {:.3}",
                faces.coverage_half, faces.coverage_one, faces.precision
            ),
            None => Ok(()),
        }
    }
}

/// Tetrahedra below the target whose nodes have the same constraints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Blocker {
    /// Number of tetrahedra.
    pub tets: usize,
    /// Number of nodes of each that lie in a side of the box.
    pub nodes_on_sides: usize,
    /// Number of nodes of each that lie on a feature.
    pub nodes_on_features: usize,
    /// Number of nodes of each that lie on several features.
    pub nodes_on_crossings: usize,
    /// Smallest dihedral angle among them, in degrees.
    pub smallest: f64,
    /// Largest dihedral angle among them, in degrees.
    pub largest: f64,
}

impl From<improve::ImproveReport> for Improvement {
    fn from(outcome: improve::ImproveReport) -> Self {
        let mut blockers: Vec<Blocker> = Vec::new();
        for b in &outcome.blocked {
            let node_counts = (b.nodes_on_sides, b.nodes_on_features, b.nodes_on_crossings);
            let has_same_counts = |k: &&mut Blocker| {
                (k.nodes_on_sides, k.nodes_on_features, k.nodes_on_crossings) == node_counts
            };
            if let Some(group) = blockers.iter_mut().find(has_same_counts) {
                group.tets += 1;
                group.smallest = group.smallest.min(b.min_angle);
                group.largest = group.largest.max(b.max_angle);
            } else {
                blockers.push(Blocker {
                    tets: 1,
                    nodes_on_sides: node_counts.0,
                    nodes_on_features: node_counts.1,
                    nodes_on_crossings: node_counts.2,
                    smallest: b.min_angle,
                    largest: b.max_angle,
                });
            }
        }
        blockers.sort_by_key(|group| std::cmp::Reverse(group.tets));
        Self {
            below_target_before: outcome.below_target_before,
            below_target_after: outcome.blocked.len(),
            counts: outcome.counts,
            sealed: improve::SealReport::default(),
            blockers,
            worst: outcome.blocked.into_iter().take(20).collect(),
        }
    }
}
