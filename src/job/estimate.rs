//! How large a mesh will become.

use super::CellKind;
use crate::Result;
use crate::feature::FeatureKind;
use crate::feature::detectors::faults::semblance::SEEN;
use crate::feature::lifted::HALO;
use crate::feature::windows::{self, WHOLE};
use crate::image::Source;
use crate::improve::tets::Cuts;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Seeding;
use crate::memory;
use crate::observer::Estimate;
use crate::ranks;

/// What features take besides an image in memory, in bytes a sample: the image smoothed, and some more.
const SAMPLE: f64 = 8.0;
/// ... and of one whose layers are read, in bytes a sample of a layer: whole layers, as far as ridges see, ...
const LAYER: f64 = 450.0;
/// ... and strips of them, twice as far as filters at all angles do.
const STRIP: f64 = 1_400.0;

/// Where faults are looked for in amplitudes: of all samples, how likely a fault is, ...
const LIKELIHOOD: f64 = 4.0;
/// ... and more of those looked at together.
const LOOKED_AT: f64 = 22.0;

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
const PLACING: f64 = 65.0;

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
    source: Source<'_, D>,
    kind: FeatureKind,
) -> Result<()> {
    let dims = source.dims();
    let samples: f64 = dims.iter().map(|&n| n as f64).product();
    let of_faults = matches!(kind, FeatureKind::Faults | FeatureKind::FaultsAndHorizons);
    let in_layers = || {
        let layer: f64 = dims[..D - 1].iter().map(|&n| n as f64).product();
        (LAYER * layer).max(STRIP * windows::looked_at(dims, HALO) as f64)
    };
    let bytes = match source {
        _ if of_faults => {
            let together = match matches!(source, Source::Held(_)) && samples <= WHOLE as f64 {
                true => samples,
                false => windows::changed_together(dims, SEEN) as f64,
            };
            // Each rank has a share, and that of its windows.
            let shared = (2.0 / ranks::count() as f64).min(1.0);
            shared * LIKELIHOOD * samples + (LOOKED_AT * together).max(in_layers())
        }
        Source::Held(_) => SAMPLE * samples,
        // Some layers at a time.
        Source::InLayers(_) => in_layers(),
    };
    let remedy = "give a part of the image, or every second sample";
    memory::afford(
        "the image",
        bytes,
        format!("features of {samples:.0} samples"),
        remedy,
    )
}

/// The size of a mesh of atoms so far apart.
pub(super) fn of_distance<const D: usize>(
    distance: &Distance<D>,
    extent: [f64; D],
    kind: CellKind,
) -> Estimate {
    of_atoms::<D>(distance.about_atoms(extent), kind)
}

/// The size of a mesh of so many atoms.
pub(super) fn of_atoms<const D: usize>(atoms: f64, kind: CellKind) -> Estimate {
    Estimate {
        atoms,
        cells: atoms * cells_per_atom::<D>(kind),
        bytes: atoms * bytes_per_atom::<D>(kind),
    }
}

/// What each of so many ranks takes of that where it has a part of the mesh only, if there are several parts.
pub(super) fn in_pieces<const D: usize>(
    whole: Estimate,
    extent: [f64; D],
    distance: &Distance<D>,
    seeding: Seeding,
    ranks: usize,
) -> Estimate {
    let longest = extent.into_iter().fold(0.0, f64::max);
    let slabs = Cuts::most(whole.atoms as usize, longest, distance.max());
    if D != 3 || slabs < 2 {
        return whole;
    }
    let share = slabs.div_ceil(ranks) as f64 / slabs as f64;
    let placed = match seeding {
        Seeding::Fcc | Seeding::Grown => whole.atoms / ranks as f64,
        _ => whole.atoms,
    };
    Estimate {
        bytes: placed * PLACING + share * whole.bytes,
        ..whole
    }
}

/// Refuses a mesh for which there is no memory.
///
/// # Errors
/// [`Error::Job`](crate::Error::Job) with the figures.
pub(super) fn afford(estimate: &Estimate) -> Result<()> {
    let what = format!(
        "about {:.2e} atoms and {:.2e} cells",
        estimate.atoms, estimate.cells
    );
    memory::afford("distance", estimate.bytes, what, "give a larger distance")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rank_takes_its_share_of_a_mesh_that_is_large_and_all_atoms_where_these_are_drawn() {
        let d = Distance::Constant(5.0);
        let bytes = |extent: [f64; 3], ranks| {
            let whole = of_distance(&d, extent, CellKind::Simplices);
            let of = |seeding| in_pieces(whole, extent, &d, seeding, ranks).bytes;
            let [regular, drawn] = [Seeding::Grown, Seeding::Refine { seed: 0 }].map(of);
            let placed = PLACING * whole.atoms;
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
        let whole = of_distance(&d, small, CellKind::Simplices);
        let pieces = in_pieces(whole, small, &d, Seeding::Fcc, 4);
        assert_eq!(pieces.bytes, whole.bytes);
    }

    #[test]
    fn a_lattice_has_as_many_atoms_as_are_seeded() {
        use crate::lattice::seeding::{Alignment, seed};
        use crate::observer::Patience;

        fn as_seeded<const D: usize>(extent: [f64; D]) {
            let d = Distance::Constant(5.0);
            let (way, patience) = (Seeding::default(), &Patience::endless());
            let seeded = seed(way, extent, &d, &[], Alignment::On, None, patience);
            let atoms = seeded.unwrap().positions.len() as f64;
            let about = of_distance(&d, extent, CellKind::Simplices).atoms;
            assert!((about / atoms - 1.0).abs() < 0.15, "{about} and {atoms}");
        }
        as_seeded([150.0; 3]);
        as_seeded([400.0; 2]);
    }
}
