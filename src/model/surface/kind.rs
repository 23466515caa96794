//! Faults and horizons.

use serde::Serialize;

use super::Surfaces;
use crate::geometry::{norm, normal};

/// What a surface is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SurfaceKind {
    /// A fault, or any other feature that is no horizon.
    Fault,
    /// Where layers meet.
    Horizon,
    /// What parts two labels of an image.
    Interface,
}

impl SurfaceKind {
    /// In lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fault => "fault",
            Self::Horizon => "horizon",
            Self::Interface => "interface",
        }
    }
}

/// The kind of each surface: an interface if it parts two labels, a horizon if at least half of its area is in `horizons`, facets with
/// nodes ascending, sorted.
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
