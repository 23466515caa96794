//! Encodes report data as bytes, to send them to other ranks.

use std::io::{self, Write};

use super::acute::{AcuteLine, AcutePair};
use super::angles::{AngleAssessment, Angles};
use super::fidelity::{FaceMatch, Fidelity, GapClass, SurfaceCoverage};
use super::lattice::{LatticeReport, Optimisation};
use super::quality::{Quality, Quantiles, Worst};
use crate::files::codec::{Codec, codec_fields};
use crate::mesh::check::{CellCheck, Check};

codec_fields! {
    Quantiles as Quantiles { worst, permille, percent, median }
    Worst as Worst { cell, centroid, smallest, largest }
    Quality as Quality {
        space, nodes, cells, kind, smallest_angle, largest_angle, below_20, below_30, above_120, above_150, above_160,
        histogram, mean_ratio, radius_edge, mean_ratio_mean, volume, smallest_volume, largest_volume, worst, angles,
    }
    AcuteLine as AcuteLine { pair, length, min_angle, mean_angle, nodes, angles }
    Angles as Angles { ok, near_acute_line, unexplained, worst_unexplained, acute_lines }
    AngleAssessment as AngleAssessment { angles, cell_classes }
    GapClass as GapClass { from, to, points, coverage_half, coverage_one }
    FaceMatch as FaceMatch { faces, area, coverage_half, coverage_one, precision, hausdorff, hausdorff_95, by_gap }
    SurfaceCoverage as SurfaceCoverage { surface, points, covered_points }
    Fidelity as Fidelity { reference, feature_points, on_feature, tagged_faces, surfaces }
    Optimisation as Optimisation {
        energy_lattice, energy_image, energy, added_by_stiffening, added_by_laplacian, minimised, evaluations, stop,
    }
    LatticeReport as LatticeReport { atoms, spacing, optimisation }
    CellCheck as CellCheck { faces, is_columnar, open_cells, cells_without_site, warp, self_crossing_width }
    Check as Check {
        nodes, cells, non_positive_cells, unused_nodes, boundary_faces, faces_off_sides, outer_faces, volume_error, flatness_error,
        area_error, cell_check, problems,
    }
}

impl Codec for AcutePair {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        self.code().encode(out)
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        Some(match u8::decode(bytes)? {
            0 => Self::Features,
            code => Self::Side(code - 1),
        })
    }
}
