//! Figures as bytes, for other ranks.

use std::io::{self, Write};

use super::acute::{AcuteLine, Pair};
use super::angles::{Angles, Judged};
use super::fidelity::{Fidelity, GapClass, Match};
use super::lattice::{Lattice, Optimisation};
use super::quality::{Points, Quality, Worst};
use crate::files::kept::{Kept, fields};
use crate::mesh::check::{CellCheck, Check};

fields! {
    Points as Points { worst, permille, percent, median }
    Worst as Worst { cell, centroid, smallest, largest }
    Quality as Quality {
        nodes, cells, kind, smallest_angle, largest_angle, below_20, below_30, above_120, above_150, above_160,
        histogram, mean_ratio, radius_edge, mean_ratio_mean, volume, smallest_volume, largest_volume, worst, angles,
    }
    AcuteLine as AcuteLine { pair, length, least_angle, mean_angle, nodes, angles }
    Angles as Angles { ok, near_acute_line, unexplained, worst_unexplained, acute_lines }
    Judged as Judged { angles, cells }
    GapClass as GapClass { from, to, points, coverage_half, coverage_one }
    Match as Match { faces, area, coverage_half, coverage_one, precision, hausdorff, hausdorff_95, by_gap }
    Fidelity as Fidelity { reference, feature_points, on_feature, claimed }
    Optimisation as Optimisation {
        energy_lattice, energy_image, energy, added_by_stiffening, added_by_laplacian, minimised, evaluations, stop,
    }
    Lattice as Lattice { atoms, spacing, optimisation }
    CellCheck as CellCheck { faces, in_columns, not_closed, without_site, warp, tied_off }
    Check as Check {
        nodes, cells, not_positive, unused_nodes, boundary_faces, faces_off_sides, volume_error, flatness_error,
        area_error, of_cells, problems,
    }
}

impl Kept for Pair {
    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        self.code().put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        Some(match u8::take(from)? {
            0 => Self::Features,
            code => Self::Side(code - 1),
        })
    }
}
