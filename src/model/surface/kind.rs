//! The kinds of surfaces: faults, horizons and interfaces.

use serde::Serialize;

use super::Surfaces;
use crate::geometry::{norm, normal};

/// The kind of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SurfaceKind {
    /// A fault, or any other feature that is not a horizon.
    Fault,
    /// A boundary between layers.
    Horizon,
    /// The interface between two labels of an image.
    Interface,
}

impl SurfaceKind {
    /// Returns the name of the kind in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fault => "fault",
            Self::Horizon => "horizon",
            Self::Interface => "interface",
        }
    }
}

/// Returns the kind of each surface: an interface if it separates two labels; a horizon if at least
/// half of its area is in `horizons` (facets with nodes ascending, sorted); otherwise a fault.
pub fn surface_kinds<const D: usize>(
    surfaces: &Surfaces<D>,
    nodes: &[[f64; D]],
    horizons: &[[u32; D]],
) -> Vec<SurfaceKind> {
    let kind = |surface: usize| {
        if surfaces.interfaces.contains(&surface) {
            return SurfaceKind::Interface;
        }
        let sign = |facet: &[u32; D]| {
            let mut sorted = *facet;
            sorted.sort_unstable();
            match horizons.binary_search(&sorted) {
                Ok(_) => 1.0,
                Err(_) => -1.0,
            }
        };
        let area = |f: &[u32; D]| norm(normal(&f.map(|n| nodes[n as usize])));
        let balance: f64 = (surfaces.facets_of(surface).iter())
            .map(|f| sign(f) * area(f))
            .sum();
        if balance >= 0.0 && !horizons.is_empty() {
            SurfaceKind::Horizon
        } else {
            SurfaceKind::Fault
        }
    };
    (0..surfaces.len()).map(kind).collect()
}
