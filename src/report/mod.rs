//! What is measured about a mesh and about the run that made it.
//!
//! - `quality`: shapes of the tetrahedra
//! - `acute`: lines at which features, or a feature and a side of the box, meet at a small angle
//! - `angles`: which bad angles these explain
//! - `fidelity`: how well the mesh's faces follow the features
//! - `pieces`: faces cut into small pieces
//! - `reach`: how far feature points are from the faces
//! - `reference`: where the features really are
//! - `surface`: faces of a mesh in parts, each of which is one holder's
//! - `tally`: distances of which several have some each
//! - `kept`: figures as bytes
//! - `lattice`: how evenly the atoms are spread
//! - `cells`: Voronoi cells, as flow simulators see them
//! - `regions`: what became of the labels of an image
//! - [`cost`]: seconds and memory of each stage
//! - `table`: a report on one screen
//! - `verdict`: a report in three lines

mod acute;
pub(crate) mod angles;
pub(crate) mod cells;
mod codecs;
pub mod cost;
mod face_distances;
mod face_samples;
pub(crate) mod fidelity;
pub(crate) mod lattice;
mod mesh_faces;
mod nearest;
pub(crate) mod quality;
pub(crate) mod reference;
mod regions;
pub(crate) mod table;
mod tally;
mod verdict;

pub use acute::{AcuteLine, AcutePair};
pub(crate) use angles::assess_partition_angles;
pub use angles::{AngleAssessment, Angles, assess_angles};
pub use cells::{Voronoi, lattice_of_graph, measure_voronoi};
pub use cost::{Clock, StageCost};
pub use fidelity::{FaceMatch, Fidelity, fidelity, fidelity_of_cells};
pub(crate) use fidelity::{
    TaggedFaces, fidelity_of_cells_with_cancel, fidelity_of_partition, fidelity_with_cancel,
};
pub(crate) use lattice::lattice_of_partition;
pub use lattice::{LatticeReport, Optimisation, TracedLattice, measure_lattice};
pub(crate) use nearest::squared_distance_to_face;
pub use quality::{Quality, quality, smallest_angles};
pub(crate) use quality::{quality_of_partition, quality_with_cancel};
pub use reference::Reference;
pub(crate) use regions::MIN_MISSING_SHARE;
pub use regions::{Hole, LostParts, RegionReport, RegionSummary};
pub use verdict::{Grade, Verdict};

use crate::feature::{Doubt, KindOutcome, MissingData};
use crate::improve;
use crate::mesh::check::Check;
use serde::Serialize;

/// Everything that is known about a run or a mesh. Sections that were not measured are `None`, and
/// are null in JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Version of atomesh.
    pub version: String,
    /// What the mesh was made from.
    pub input: Option<Input>,
    /// The parameters of the run, as they took effect.
    pub parameters: serde_json::Value,
    /// What each stage cost, in the order in which they ran.
    pub stages: Vec<StageCost>,
    /// The atoms.
    pub lattice: Option<LatticeReport>,
    /// The lattice as it moved, where it was traced.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub trace: Vec<TracedLattice>,
    /// Shapes in lattice space, in which cells are meant to be well shaped.
    pub quality: Option<Quality>,
    /// Shapes in physical space, where it differs and all its axes are lengths.
    pub quality_physical: Option<Quality>,
    /// Whether users work in physical space, as with scans, so that shapes there decide. In a survey cells are as
    /// flat as the layers.
    #[serde(skip)]
    pub used_in_physical_space: bool,
    /// What the image leaves open, where the kind of feature was chosen by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doubt: Option<Doubt>,
    /// What was found of each kind of feature, and what of it the mesh follows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub outcomes: Vec<KindOutcome>,
    /// The samples that hold no data, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing: Option<MissingData>,
    /// Fidelity to the features.
    pub fidelity: Option<Fidelity>,
    /// Whether the mesh is valid and fills its box.
    #[serde(rename = "box")]
    pub box_check: Option<Check>,
    /// The cells of a Voronoi mesh, of which the above says nothing.
    pub voronoi: Option<Voronoi>,
    /// The regions that the labels of the image became.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub regions: Option<RegionSummary>,
    /// What was improved, and what stands in the way of the rest.
    pub improvement: Option<Improvement>,
    /// What the other method makes of the same atoms, where the two are compared.
    pub baseline: Option<Baseline>,
    /// Lines that whoever reads the report should know.
    pub notes: Vec<String>,
}

impl Default for Report {
    /// A report of this version, with nothing measured.
    fn default() -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_string(),
            input: None,
            parameters: serde_json::Value::Null,
            stages: Vec::new(),
            lattice: None,
            trace: Vec::new(),
            quality: None,
            quality_physical: None,
            doubt: None,
            outcomes: Vec::new(),
            missing: None,
            used_in_physical_space: false,
            fidelity: None,
            box_check: None,
            voronoi: None,
            regions: None,
            improvement: None,
            baseline: None,
            notes: Vec::new(),
        }
    }
}

/// What a mesh was made from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Input {
    /// The file.
    pub file: String,
    /// Number of samples along each axis, x first.
    pub dims: Vec<usize>,
    /// Hash of the file, with its kind: `sha256:...`.
    pub hash: String,
}

/// What was improved, and what stands in the way of the rest.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Improvement {
    /// Tetrahedra below the target before.
    pub below_target_before: usize,
    /// Tetrahedra below the target after.
    pub below_target_after: usize,
    /// Changes made.
    pub counts: improve::OperationCounts,
    /// Holes in the faces on features that were closed.
    pub sealed: improve::SealReport,
    /// The tetrahedra still below the target, grouped by what holds their nodes; largest group
    /// first.
    pub blockers: Vec<Blocker>,
    /// The worst of them.
    pub worst: Vec<improve::BlockedCell>,
}

/// A mesh of the same atoms by another method of improvement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Baseline {
    /// The method.
    pub method: improve::SliverMethod,
    /// Its shapes in lattice space.
    pub quality: Quality,
    /// Its fidelity to the features.
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

/// Tetrahedra below the target that are held in the same way.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Blocker {
    /// How many.
    pub tets: usize,
    /// Nodes of each that lie in a side of the box.
    pub nodes_on_sides: usize,
    /// Nodes of each that lie on a feature.
    pub nodes_on_features: usize,
    /// Nodes of each that lie on several features at once.
    pub nodes_on_crossings: usize,
    /// Smallest dihedral angle among them, in degrees.
    pub smallest: f64,
    /// Largest dihedral angle among them, in degrees.
    pub largest: f64,
}

impl From<&improve::ImproveReport> for Improvement {
    fn from(outcome: &improve::ImproveReport) -> Self {
        let mut blockers: Vec<Blocker> = Vec::new();
        for b in &outcome.blocked {
            let held = (b.nodes_on_sides, b.nodes_on_features, b.nodes_on_crossings);
            let same = |k: &&mut Blocker| {
                (k.nodes_on_sides, k.nodes_on_features, k.nodes_on_crossings) == held
            };
            if let Some(group) = blockers.iter_mut().find(same) {
                group.tets += 1;
                group.smallest = group.smallest.min(b.min_angle);
                group.largest = group.largest.max(b.max_angle);
            } else {
                blockers.push(Blocker {
                    tets: 1,
                    nodes_on_sides: held.0,
                    nodes_on_features: held.1,
                    nodes_on_crossings: held.2,
                    smallest: b.min_angle,
                    largest: b.max_angle,
                });
            }
        }
        blockers.sort_by_key(|group| std::cmp::Reverse(group.tets));
        Self {
            below_target_before: outcome.below_target_before,
            below_target_after: outcome.below_target_after,
            counts: outcome.counts,
            sealed: improve::SealReport::default(),
            blockers,
            worst: outcome.blocked.iter().take(20).cloned().collect(),
        }
    }
}
