//! Estimates of the size of a mesh, and checks that it fits into memory.

use super::CellKind;
use super::spec::SeedingKind;
use crate::Result;
use crate::feature::FeatureKind;
use crate::image::ImageSource;
use crate::improve::tets::SlabCuts;
use crate::lattice::distance::Distance;
use crate::memory;
use crate::progress::SizeEstimate;

/// Returns the memory for making, improving, measuring and writing a mesh, in bytes per atom.
/// Measured with 0.1 to 12 million atoms.
fn bytes_per_atom<const D: usize>(kind: CellKind) -> f64 {
    match (D, kind) {
        (2, CellKind::Simplices) => 360.0,
        (2, CellKind::Voronoi) => 900.0,
        (_, CellKind::Simplices) => 850.0,
        (_, CellKind::Voronoi) => 2_600.0,
    }
}

/// Memory for placing atoms, in bytes per atom. Each rank places its own atoms if the lattice is
/// regular, otherwise all atoms. While atoms move, and after that, they take less.
const PLACING_BYTES_PER_ATOM: f64 = 65.0;

/// Returns the number of cells per atom.
fn cells_per_atom<const D: usize>(kind: CellKind) -> f64 {
    match (D, kind) {
        (_, CellKind::Voronoi) => 1.0,
        (2, CellKind::Simplices) => 2.0,
        (_, CellKind::Simplices) => 6.0,
    }
}

/// Checks that there is enough memory to detect the features of an image.
///
/// # Errors
/// Returns [`Error::Job`](crate::Error::Job) if there is not.
pub(super) fn afford_features<const D: usize>(
    source: ImageSource<'_, D>,
    kind: FeatureKind,
    rank_count: usize,
) -> Result<()> {
    let samples: f64 = source.dims().iter().map(|&n| n as f64).product();
    let bytes = kind.search_bytes(source, rank_count);
    let remedy = "give a part of the image, or every second sample";
    memory::ensure_available(
        "the image",
        bytes,
        format!("features of {samples:.0} samples"),
        remedy,
    )
}

/// Estimates the size of a mesh with this nominal distance.
pub(super) fn estimate_from_distance<const D: usize>(
    distance: &Distance<D>,
    extent: [f64; D],
    kind: CellKind,
) -> SizeEstimate {
    estimate_from_atom_count::<D>(distance.estimate_atom_count(extent), kind)
}

/// Estimates the size of a mesh with this number of atoms.
pub(super) fn estimate_from_atom_count<const D: usize>(atoms: f64, kind: CellKind) -> SizeEstimate {
    SizeEstimate {
        atoms,
        cells: atoms * cells_per_atom::<D>(kind),
        bytes: atoms * bytes_per_atom::<D>(kind),
    }
}

/// Estimates the size of a mesh on each of `rank_count` ranks, which hold only a part of the mesh if it
/// is divided into several slabs.
pub(super) fn estimate_per_rank<const D: usize>(
    total: SizeEstimate,
    extent: [f64; D],
    distance: &Distance<D>,
    seeding: SeedingKind,
    rank_count: usize,
) -> SizeEstimate {
    let longest = extent.into_iter().fold(0.0, f64::max);
    let slabs = SlabCuts::max_slabs(total.atoms as usize, longest, distance.max());
    if D != 3 || slabs < 2 {
        return total;
    }
    let share = slabs.div_ceil(rank_count) as f64 / slabs as f64;
    let placed_atoms = match seeding {
        SeedingKind::Fcc | SeedingKind::Grown => total.atoms / rank_count as f64,
        _ => total.atoms,
    };
    SizeEstimate {
        bytes: placed_atoms * PLACING_BYTES_PER_ATOM + share * total.bytes,
        ..total
    }
}

/// Checks that there is enough memory for a mesh.
///
/// # Errors
/// Returns [`Error::Job`](crate::Error::Job) with the figures if there is not.
pub(super) fn afford(estimate: &SizeEstimate) -> Result<()> {
    let size = format!(
        "about {:.2e} atoms and {:.2e} cells",
        estimate.atoms, estimate.cells
    );
    memory::ensure_available("distance", estimate.bytes, size, "give a larger distance")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rank_takes_its_share_of_a_large_mesh_and_all_atoms_if_these_are_drawn() {
        let d = Distance::Constant(5.0);
        let bytes = |extent: [f64; 3], rank_count| {
            let total = estimate_from_distance(&d, extent, CellKind::Simplices);
            let bytes_per_rank =
                |seeding| estimate_per_rank(total, extent, &d, seeding, rank_count).bytes;
            let [regular, drawn] = [SeedingKind::Grown, SeedingKind::Refine].map(bytes_per_rank);
            let placed = PLACING_BYTES_PER_ATOM * total.atoms;
            let difference = placed - placed / rank_count as f64;
            assert!((drawn - regular - difference).abs() < 1e-6 * drawn);
            (drawn - placed) / total.bytes
        };
        // This box is divided into four slabs.
        let large = [1000.0, 600.0, 600.0];
        for (rank_count, share) in [(2, 0.5), (3, 0.5), (4, 0.25), (9, 0.25)] {
            assert!(
                (bytes(large, rank_count) - share).abs() < 1e-9,
                "{rank_count} ranks"
            );
        }
        let small = [450.0; 3];
        let total = estimate_from_distance(&d, small, CellKind::Simplices);
        let per_rank = estimate_per_rank(total, small, &d, SeedingKind::Fcc, 4);
        assert_eq!(per_rank.bytes, total.bytes);
    }

    #[test]
    fn the_estimated_atom_count_is_close_to_the_seeded_one() {
        use crate::lattice::seeding::{Alignment, fcc};

        fn assert_as_seeded<const D: usize>(extent: [f64; D]) {
            let d = Distance::Constant(5.0);
            let seeded = fcc(extent, &d, &[], Alignment::OnFeatures);
            let atoms = seeded.unwrap().positions.len() as f64;
            let estimate = estimate_from_distance(&d, extent, CellKind::Simplices).atoms;
            assert!(
                (estimate / atoms - 1.0).abs() < 0.15,
                "{estimate} and {atoms}"
            );
        }
        assert_as_seeded([150.0; 3]);
        assert_as_seeded([400.0; 2]);
    }
}
