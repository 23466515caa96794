//! How large a mesh will become.

use super::CellKind;
use crate::Result;
use crate::feature::FeatureKind;
use crate::image::ImageSource;
use crate::improve::tets::SlabCuts;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Seeding;
use crate::memory;
use crate::progress::SizeEstimate;

/// What a mesh takes while it is made, improved, measured and written, in bytes an atom; measured with
/// 0.1 to 12 million atoms.
fn bytes_per_atom<const D: usize>(kind: CellKind) -> f64 {
    match (D, kind) {
        (2, CellKind::Simplices) => 360.0,
        (2, CellKind::Voronoi) => 900.0,
        (_, CellKind::Simplices) => 850.0,
        (_, CellKind::Voronoi) => 2_600.0,
    }
}

/// What atoms take while they are placed, in bytes each: each rank places its own where the lattice is regular, and else
/// all. While they move and after that it is less.
const PLACING_BYTES_PER_ATOM: f64 = 65.0;

/// Cells an atom.
fn cells_per_atom<const D: usize>(kind: CellKind) -> f64 {
    match (D, kind) {
        (_, CellKind::Voronoi) => 1.0,
        (2, CellKind::Simplices) => 2.0,
        (_, CellKind::Simplices) => 6.0,
    }
}

/// Refuses an image for whose features there is no memory, if so many ranks share the work.
///
/// # Errors
/// [`Error::Job`](crate::Error::Job).
pub(super) fn afford_features<const D: usize>(
    source: ImageSource<'_, D>,
    kind: FeatureKind,
    ranks: usize,
) -> Result<()> {
    let samples: f64 = source.dims().iter().map(|&n| n as f64).product();
    let bytes = kind.search_bytes(source, ranks);
    let remedy = "give a part of the image, or every second sample";
    memory::ensure_available(
        "the image",
        bytes,
        format!("features of {samples:.0} samples"),
        remedy,
    )
}

/// The size of a mesh of atoms so far apart.
pub(super) fn estimate_from_distance<const D: usize>(
    distance: &Distance<D>,
    extent: [f64; D],
    kind: CellKind,
) -> SizeEstimate {
    estimate_from_atom_count::<D>(distance.estimate_atom_count(extent), kind)
}

/// The size of a mesh of so many atoms.
pub(super) fn estimate_from_atom_count<const D: usize>(atoms: f64, kind: CellKind) -> SizeEstimate {
    SizeEstimate {
        atoms,
        cells: atoms * cells_per_atom::<D>(kind),
        bytes: atoms * bytes_per_atom::<D>(kind),
    }
}

/// What each of so many ranks takes of that where it has a part of the mesh only, if there are several parts.
pub(super) fn estimate_per_rank<const D: usize>(
    total: SizeEstimate,
    extent: [f64; D],
    distance: &Distance<D>,
    seeding: Seeding,
    ranks: usize,
) -> SizeEstimate {
    let longest = extent.into_iter().fold(0.0, f64::max);
    let slabs = SlabCuts::max_slabs(total.atoms as usize, longest, distance.max());
    if D != 3 || slabs < 2 {
        return total;
    }
    let share = slabs.div_ceil(ranks) as f64 / slabs as f64;
    let placed_atoms = match seeding {
        Seeding::Fcc | Seeding::Grown => total.atoms / ranks as f64,
        _ => total.atoms,
    };
    SizeEstimate {
        bytes: placed_atoms * PLACING_BYTES_PER_ATOM + share * total.bytes,
        ..total
    }
}

/// Refuses a mesh for which there is no memory.
///
/// # Errors
/// [`Error::Job`](crate::Error::Job) with the figures.
pub(super) fn afford(estimate: &SizeEstimate) -> Result<()> {
    let what = format!(
        "about {:.2e} atoms and {:.2e} cells",
        estimate.atoms, estimate.cells
    );
    memory::ensure_available("distance", estimate.bytes, what, "give a larger distance")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rank_takes_its_share_of_a_mesh_that_is_large_and_all_atoms_where_these_are_drawn() {
        let d = Distance::Constant(5.0);
        let bytes = |extent: [f64; 3], ranks| {
            let total = estimate_from_distance(&d, extent, CellKind::Simplices);
            let bytes_per_rank =
                |seeding| estimate_per_rank(total, extent, &d, seeding, ranks).bytes;
            let [regular, drawn] =
                [Seeding::Grown, Seeding::Refine { seed: 0 }].map(bytes_per_rank);
            let placed = PLACING_BYTES_PER_ATOM * total.atoms;
            let difference = placed - placed / ranks as f64;
            assert!((drawn - regular - difference).abs() < 1e-6 * drawn);
            (drawn - placed) / total.bytes
        };
        // Four slabs.
        let large = [1000.0, 600.0, 600.0];
        for (ranks, share) in [(2, 0.5), (3, 0.5), (4, 0.25), (9, 0.25)] {
            assert!((bytes(large, ranks) - share).abs() < 1e-9, "{ranks} ranks");
        }
        let small = [450.0; 3];
        let total = estimate_from_distance(&d, small, CellKind::Simplices);
        let per_rank = estimate_per_rank(total, small, &d, Seeding::Fcc, 4);
        assert_eq!(per_rank.bytes, total.bytes);
    }

    #[test]
    fn a_lattice_has_as_many_atoms_as_are_seeded() {
        use crate::lattice::seeding::{Alignment, seed};
        use crate::progress::CancelToken;

        fn assert_as_seeded<const D: usize>(extent: [f64; D]) {
            let d = Distance::Constant(5.0);
            let (seeding, cancel) = (Seeding::default(), &CancelToken::never());
            let seeded = seed(
                seeding,
                extent,
                &d,
                &[],
                Alignment::OnFeatures,
                None,
                cancel,
            );
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
