//! Separation of horizons by faults: finds the facets of either kind, and whether a fault lies
//! between two facets of horizons.

use crate::mesh::complex::NONE;
use crate::parallel::prelude::*;

use super::continuation_votes::smooth_neighbour;
use super::facets::FacetComplex;
use super::size_classes::SizeClasses;
use crate::geometry::{add_scaled, dot, norm, sub, unit};

/// Number of rings of neighbours that correct single facets of the wrong kind.
const KIND_RINGS: usize = 3;

/// Reach of fault facets, in their sizes. A search around the middle of a line, with half its length as
/// size, then finds all facets that lie within half the line's length plus their own size.
const FAULT_REACH: f64 = 2.0;

/// The facets of faults, for features that have both faults and horizons.
///
/// A fault displaces layers, and another reflector may lie behind it where one ends. So facets on
/// opposite sides of a fault are not one horizon only because they are in line; they must be
/// connected around the fault.
pub struct FaultSeparation<const D: usize> {
    /// `true` for each facet that lies on a horizon.
    is_horizon: Vec<bool>,
    /// Centre of each facet.
    centres: Vec<[f64; D]>,
    /// The facets of faults.
    faults: Vec<FaultFacet<D>>,
    /// The centres of these facets.
    fault_centres: SizeClasses<D>,
}

struct FaultFacet<const D: usize> {
    centre: [f64; D],
    normal: [f64; D],
    size: f64,
}

impl<const D: usize> FaultSeparation<D> {
    /// Prepares the separation. `horizons` are the facets that lie on horizons (nodes ascending,
    /// sorted). Returns `None` unless there are facets of both kinds.
    pub fn new(facets: &FacetComplex<D>, horizons: &[[u32; D]]) -> Option<Self> {
        let is_on_horizon = |facet: &[u32; D]| {
            let mut sorted = *facet;
            sorted.sort_unstable();
            horizons.binary_search(&sorted).is_ok()
        };
        let marked: Vec<bool> = facets.facets.iter().map(is_on_horizon).collect();
        if marked.iter().all(|h| *h) || !marked.contains(&true) {
            return None;
        }
        let is_horizon = smooth_kinds(facets, marked);
        let centres = facets.centroids();
        let fault_facet = |f: usize| FaultFacet {
            centre: centres[f],
            normal: unit(facets.normal(f)),
            size: facets.size(f),
        };
        let faults: Vec<FaultFacet<D>> = (0..facets.len())
            .filter(|&f| !is_horizon[f])
            .map(fault_facet)
            .collect();
        let fault_centres: Vec<[f64; D]> = faults.iter().map(|fault| fault.centre).collect();
        let sizes: Vec<f64> = faults.iter().map(|fault| fault.size).collect();
        Some(Self {
            fault_centres: SizeClasses::new(&fault_centres, &sizes, FAULT_REACH),
            is_horizon,
            centres,
            faults,
        })
    }

    /// Returns `true` if two facets cannot continue each other: one is of a fault and the other of
    /// a horizon, or they are of horizons on opposite sides of a fault.
    pub fn separates(&self, f: usize, g: usize) -> bool {
        match [f, g].map(|f| self.is_horizon[f]) {
            [true, true] => self.has_fault_between(self.centres[f], self.centres[g]),
            [a, b] => a != b,
        }
    }

    /// Returns `true` if the line between two points crosses the plane of a fault facet within the
    /// facet's size of its centre. This is more than the facet itself, because a fault lacks some
    /// facets.
    fn has_fault_between(&self, a: [f64; D], b: [f64; D]) -> bool {
        let direction = sub(b, a);
        let middle = add_scaled(a, 0.5, direction);
        let mut is_crossed = false;
        let half_length = 0.5 * norm(direction);
        self.fault_centres.visit(middle, half_length, |n| {
            if is_crossed {
                return;
            }
            let fault = &self.faults[n];
            let [start, end] = [a, b].map(|x| dot(sub(x, fault.centre), fault.normal));
            if start * end < 0.0 {
                let crossing = add_scaled(a, start / (start - end), direction);
                is_crossed |= norm(sub(crossing, fault.centre)) < fault.size;
            }
        });
        is_crossed
    }
}

/// Corrects the kind of each facet by the kinds of its smooth neighbours.
fn smooth_kinds<const D: usize>(facets: &FacetComplex<D>, mut is_horizon: Vec<bool>) -> Vec<bool> {
    let neighbours: Vec<[u32; D]> = (0..facets.len())
        .into_par_iter()
        .map(|f| std::array::from_fn(|k| smooth_neighbour(facets, D * f + k)))
        .collect();
    for _ in 0..KIND_RINGS {
        is_horizon = (0..facets.len())
            .into_par_iter()
            .map(|f| {
                let sign = |f: usize| if is_horizon[f] { 1 } else { -1 };
                let others = neighbours[f].iter().filter(|&&g| g != NONE);
                // Two neighbours overrule a facet, one does not.
                let sum: i32 = others.map(|&g| sign(g as usize)).sum();
                2 * sum + 3 * sign(f) > 0
            })
            .collect();
    }
    is_horizon
}
