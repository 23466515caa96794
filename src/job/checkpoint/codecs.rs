//! Encoding of the results of stages as bytes: every number exactly as it is in memory.

use std::io::{self, Write};

use crate::feature::{
    Confidences, Doubt, DroppedPoints, FeaturePoint, Features, FlatFaults, KindOutcome, LabelMap,
    MissingData, PointCounts, ResolvedOptions, ValueField,
};
use crate::files::codec::{Codec, codec_fields, codec_variants};
use crate::image::{ScalarField, SparseField};
use crate::improve::{BlockedCell, OperationCounts, SealReport};
use crate::job::{AnnotatedMesh, JoinedMesh};
use crate::lattice::AtomKind;
use crate::lattice::energy::{self, EnergyTerms};
use crate::lattice::optimise::{OptimiseResult, StopReason};
use crate::lattice::seeding::Atoms;
use crate::mesh::delaunay::Delaunay;
use crate::mesh::{TetMesh, TriMesh};
use crate::report::{AngleAssessment, Blocker, Improvement};

codec_fields! {
    @(const D: usize) FeaturePoint<D> as FeaturePoint { position, normal, strength }
    @(const D: usize) ScalarField<D> as ScalarField { dims, step, samples }
    @(const D: usize) SparseField<D> as SparseField { dims, step, slots, masks, samples, is_distributed, miss_flag }
    Doubt as Doubt { question, assumed, other }
    PointCounts as PointCounts { points, on_horizon }
    KindOutcome as KindOutcome { kind, points, dropped, signal_to_noise, gently_dipping, below_min_dip, confidence, chaotic }
    Confidences as Confidences { surfaces, lowest, median, doubtful, doubtful_share, dropped }
    FlatFaults as FlatFaults { min_dip, count, largest_area, dips, assumed_velocity }
    MissingData as MissingData { bridged, without_features }
    DroppedPoints as DroppedPoints { near_another_surface, in_small_pieces, in_narrow_parts, weak }
    ResolvedOptions as ResolvedOptions { kind, scale, low, high, min_area, mask, levels }
    @(const D: usize) LabelMap<D> as LabelMap { dims, step, labels, names, winner, lead, values, volumes }
    @(const D: usize) ValueField<D> as ValueField { dims, samples, levels }
    @(const D: usize) Features<D> as Features {
        points, surface, names, on_horizon, potential, spacing, global_counts, sigma, outcomes, missing, notes, resolved, labels, confidence, doubt,
    }
    @(const D: usize) Atoms<D> as Atoms { positions, kinds }
    energy::EnergyParts as EnergyParts { lattice, image }
    EnergyTerms as EnergyTerms { published, energy, stiffening, smoothing }
    OptimiseResult as OptimiseResult { stop, rounds, iterations, evaluations, energy_before, energy_after, terms }
    TetMesh as TetMesh { nodes, tets }
    TriMesh as TriMesh { nodes, triangles }
    Delaunay as Delaunay { mesh, neighbours }
    OperationCounts as OperationCounts {
        flips, moves, intersecting_before, intersecting_flipped, intersecting_snapped, intersecting_split, intersecting_left,
        collapses, insertions, released,
    }
    SealReport as SealReport { faces, area, pockets, compartments }
    BlockedCell as BlockedCell {
        centroid, min_angle, max_angle, nodes_on_sides, nodes_on_features, nodes_on_crossings,
    }
    Blocker as Blocker {
        tets, nodes_on_sides, nodes_on_features, nodes_on_crossings, smallest, largest,
    }
    Improvement as Improvement { below_target_before, below_target_after, counts, sealed, blockers, worst }
    @(M: Codec) JoinedMesh<M> as JoinedMesh { annotated_mesh, neighbours, improvement, baseline }
}

use energy::EnergyParts;

impl<M: Codec> Codec for AnnotatedMesh<M> {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self {
            mesh,
            node_kinds,
            feature_faces,
            regions,
            // The assessment is made when the mesh is measured.
            angle_assessment: _,
        } = self;
        mesh.encode(out)?;
        node_kinds.encode(out)?;
        feature_faces.encode(out)?;
        regions.encode(out)
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        Some(Self {
            mesh: M::decode(bytes)?,
            node_kinds: Codec::decode(bytes)?,
            feature_faces: Codec::decode(bytes)?,
            regions: Codec::decode(bytes)?,
            angle_assessment: AngleAssessment::default(),
        })
    }
}

codec_variants! {
    AtomKind { Interior, Side, Edge, Corner, Fixed }
    StopReason { Converged, MaxIterations, Interrupted }
}
