//! What stages give, as bytes: every number exactly as it is in memory.

use std::io::{self, Write};

use crate::feature::{
    Doubt, FeatureKind, FeaturePoint, Features, KindOutcome, Labelled, LeftOut, MissingData, OfAll,
    Settled,
};
use crate::files::kept::{Kept, fields, numbered};
use crate::image::{Field, Sparse};
use crate::improve::{Blocked, Counts, Sealed};
use crate::job::{Joined, Marked};
use crate::lattice::AtomKind;
use crate::lattice::energy::{self, Terms};
use crate::lattice::optimize::{Rest, Stop};
use crate::lattice::seeding::Atoms;
use crate::mesh::delaunay::Delaunay;
use crate::mesh::{TetMesh, TriMesh};
use crate::report::{Blocker, Improvement, Judged};

fields! {
    @(const D: usize) FeaturePoint<D> as FeaturePoint { position, normal, strength }
    @(const D: usize) Field<D> as Field { dims, step, samples }
    @(const D: usize) Sparse<D> as Sparse { dims, step, slots, masks, samples, in_shares, missed }
    Doubt as Doubt { question, assumed, other }
    OfAll as OfAll { points, on_horizon }
    KindOutcome as KindOutcome { kind, points, left_out, signal_to_noise, gently_dipping }
    MissingData as MissingData { bridged, without_features }
    LeftOut as LeftOut { near_another_sheet, in_small_pieces, in_narrow_parts, weak }
    Settled as Settled { kind, scale, low, high, min_area, mask }
    @(const D: usize) Labelled<D> as Labelled { dims, step, labels, names, winner, lead, volumes }
    @(const D: usize) Features<D> as Features {
        points, sheet, on_horizon, potential, spacing, in_shares, sigma, outcomes, missing, notes, settled, labels, confidence, doubt,
    }
    @(const D: usize) Atoms<D> as Atoms { positions, kinds }
    energy::Parts as EnergyParts { lattice, image }
    Terms as Terms { published, energy, stiffening, smoothing }
    Rest as Rest { stop, rounds, iterations, evaluations, energy_before, energy_after, terms }
    TetMesh as TetMesh { nodes, tets }
    TriMesh as TriMesh { nodes, triangles }
    Delaunay as Delaunay { mesh, neighbors }
    Counts as Counts {
        flips, moves, pierced_before, pierced_flipped, pierced_snapped, pierced_split, pierced_left,
        collapses, insertions, released,
    }
    Sealed as Sealed { faces, area, pockets, rooms }
    Blocked as Blocked {
        centroid, smallest, largest, nodes_on_sides, nodes_on_features, nodes_on_crossings,
    }
    Blocker as Blocker {
        tets, nodes_on_sides, nodes_on_features, nodes_on_crossings, smallest, largest,
    }
    Improvement as Improvement { poor_before, poor_after, counts, sealed, blockers, worst }
    @(M: Kept) Joined<M> as Joined { made, neighbors, improvement, rival }
}

use energy::Parts as EnergyParts;

impl<M: Kept> Kept for Marked<M> {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self {
            mesh,
            kinds,
            feature_faces,
            regions,
            // Judged when it is measured.
            judged: _,
        } = self;
        mesh.put(out)?;
        kinds.put(out)?;
        feature_faces.put(out)?;
        regions.put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        Some(Self {
            mesh: M::take(from)?,
            kinds: Kept::take(from)?,
            feature_faces: Kept::take(from)?,
            regions: Kept::take(from)?,
            judged: Judged::default(),
        })
    }
}

numbered! {
    AtomKind { Interior, Side, Edge, Corner, Fixed }
    Stop { Converged, MaxIterations, Interrupted }
    FeatureKind {
        Auto, Ridges, Valleys, Edges, Canny, Paths, Horizons, Faults, FaultsAndHorizons, Labels, Mask, Potential
    }
}
