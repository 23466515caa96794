//! How large a mesh will become.

use super::CellKind;
use crate::Result;
use crate::comm;
use crate::feature::FeatureKind;
use crate::feature::detectors::faults::semblance::HALO_LAYERS;
use crate::feature::oriented::FILTER_HALO_LAYERS;
use crate::feature::windows::{self, MAX_WHOLE_SAMPLES};
use crate::image::ImageSource;
use crate::improve::tets::SlabCuts;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Seeding;
use crate::memory;
use crate::progress::SizeEstimate;

/// What features take besides an image in memory, in bytes a sample: the image smoothed, and some more.
const BYTES_PER_SAMPLE: f64 = 8.0;
/// ... and of one whose layers are read, in bytes a sample of a layer: whole layers, as far as ridges see, ...
const BYTES_PER_LAYER_SAMPLE: f64 = 450.0;
/// ... and strips of them, twice as far as filters at all angles do.
const BYTES_PER_STRIP_SAMPLE: f64 = 1_400.0;

/// Where faults are looked for in amplitudes: of all samples, how likely a fault is, ...
const LIKELIHOOD_BYTES_PER_SAMPLE: f64 = 4.0;
/// ... and more of those looked at together.
const SCAN_BYTES_PER_SAMPLE: f64 = 22.0;

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

/// Refuses an image for whose features there is no memory.
///
/// # Errors
/// [`Error::Job`](crate::Error::Job).
pub(super) fn afford_features<const D: usize>(
    source: ImageSource<'_, D>,
    kind: FeatureKind,
) -> Result<()> {
    let dims = source.dims();
    let samples: f64 = dims.iter().map(|&n| n as f64).product();
    let of_faults = matches!(kind, FeatureKind::Faults | FeatureKind::FaultsAndHorizons);
    let in_layers = || {
        let layer: f64 = dims[..D - 1].iter().map(|&n| n as f64).product();
        (BYTES_PER_LAYER_SAMPLE * layer).max(
            BYTES_PER_STRIP_SAMPLE * windows::strip_layer_samples(dims, FILTER_HALO_LAYERS) as f64,
        )
    };
    let bytes = match source {
        _ if of_faults => {
            let together = match matches!(source, ImageSource::InMemory(_))
                && samples <= MAX_WHOLE_SAMPLES as f64
            {
                true => samples,
                false => windows::min_mapped_samples(dims, HALO_LAYERS) as f64,
            };
            // Each rank has a share, and that of its windows.
            let shared = (2.0 / comm::size() as f64).min(1.0);
            shared * LIKELIHOOD_BYTES_PER_SAMPLE * samples
                + (SCAN_BYTES_PER_SAMPLE * together).max(in_layers())
        }
        ImageSource::InMemory(_) => BYTES_PER_SAMPLE * samples,
        // Some layers at a time.
        ImageSource::Layered(_) => in_layers(),
    };
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
    whole: SizeEstimate,
    extent: [f64; D],
    distance: &Distance<D>,
    seeding: Seeding,
    ranks: usize,
) -> SizeEstimate {
    let longest = extent.into_iter().fold(0.0, f64::max);
    let slabs = SlabCuts::max_slabs(whole.atoms as usize, longest, distance.max());
    if D != 3 || slabs < 2 {
        return whole;
    }
    let share = slabs.div_ceil(ranks) as f64 / slabs as f64;
    let placed = match seeding {
        Seeding::Fcc | Seeding::Grown => whole.atoms / ranks as f64,
        _ => whole.atoms,
    };
    SizeEstimate {
        bytes: placed * PLACING_BYTES_PER_ATOM + share * whole.bytes,
        ..whole
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
            let whole = estimate_from_distance(&d, extent, CellKind::Simplices);
            let of = |seeding| estimate_per_rank(whole, extent, &d, seeding, ranks).bytes;
            let [regular, drawn] = [Seeding::Grown, Seeding::Refine { seed: 0 }].map(of);
            let placed = PLACING_BYTES_PER_ATOM * whole.atoms;
            let more = placed - placed / ranks as f64;
            assert!((drawn - regular - more).abs() < 1e-6 * drawn);
            (drawn - placed) / whole.bytes
        };
        // Four slabs.
        let large = [1000.0, 600.0, 600.0];
        for (ranks, share) in [(2, 0.5), (3, 0.5), (4, 0.25), (9, 0.25)] {
            assert!((bytes(large, ranks) - share).abs() < 1e-9, "{ranks} ranks");
        }
        let small = [450.0; 3];
        let whole = estimate_from_distance(&d, small, CellKind::Simplices);
        let pieces = estimate_per_rank(whole, small, &d, Seeding::Fcc, 4);
        assert_eq!(pieces.bytes, whole.bytes);
    }

    #[test]
    fn a_lattice_has_as_many_atoms_as_are_seeded() {
        use crate::lattice::seeding::{Alignment, seed};
        use crate::progress::CancelToken;

        fn assert_as_seeded<const D: usize>(extent: [f64; D]) {
            let d = Distance::Constant(5.0);
            let (way, patience) = (Seeding::default(), &CancelToken::never());
            let seeded = seed(way, extent, &d, &[], Alignment::OnFeatures, None, patience);
            let atoms = seeded.unwrap().positions.len() as f64;
            let about = estimate_from_distance(&d, extent, CellKind::Simplices).atoms;
            assert!((about / atoms - 1.0).abs() < 0.15, "{about} and {atoms}");
        }
        assert_as_seeded([150.0; 3]);
        assert_as_seeded([400.0; 2]);
    }
}
