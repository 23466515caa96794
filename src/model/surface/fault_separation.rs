//! Horizons end on faults: which facets are of either kind, and where a fault stands between two
//! facets of horizons.

use crate::parallel::prelude::*;

use super::continuation_votes::smooth_neighbour;
use super::facets::{FacetComplex, NONE};
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, dot, norm, sub, unit};

/// Single facets of the wrong kind are found by so many rings of neighbours.
const KIND_RINGS: usize = 3;

/// The facets of faults, where a feature has horizons, too.
///
/// A fault throws layers, and beyond it another reflector may lie where this one ends. So what lies on
/// either side of a fault is not one horizon for being in line, but only by a way around the fault.
pub struct FaultSeparation<const D: usize> {
    /// For each facet whether it lies on a horizon.
    is_horizon: Vec<bool>,
    /// Centres of facets, by number.
    centres: Vec<[f64; D]>,
    /// The facets of faults.
    faults: Vec<FaultFacet<D>>,
    /// The centres of these.
    fault_cells: CellList<D>,
    /// The largest of these.
    max_fault_size: f64,
}

struct FaultFacet<const D: usize> {
    centre: [f64; D],
    normal: [f64; D],
    size: f64,
}

impl<const D: usize> FaultSeparation<D> {
    /// `horizons` are the facets that lie on horizons, nodes ascending, sorted. `None` unless there are
    /// facets of either kind.
    pub fn new(facets: &FacetComplex<D>, horizons: &[[u32; D]]) -> Option<Self> {
        let on = |facet: &[u32; D]| {
            let mut sorted = *facet;
            sorted.sort_unstable();
            horizons.binary_search(&sorted).is_ok()
        };
        let told: Vec<bool> = facets.facets.iter().map(on).collect();
        if told.iter().all(|h| *h) || !told.contains(&true) {
            return None;
        }
        let horizon = smooth_kinds(facets, told);
        let centres: Vec<[f64; D]> = (0..facets.len())
            .map(|f| {
                let corners = facets.corners(f).into_iter();
                corners.fold([0.0; D], |sum, x| add_scaled(sum, 1.0 / D as f64, x))
            })
            .collect();
        let wall = |f: usize| FaultFacet {
            centre: centres[f],
            normal: unit(facets.normal(f)),
            size: facets.size(f),
        };
        let faults: Vec<FaultFacet<D>> = (0..facets.len())
            .filter(|&f| !horizon[f])
            .map(wall)
            .collect();
        let largest = faults.iter().map(|w| w.size).fold(0.0, f64::max);
        let at: Vec<[f64; D]> = faults.iter().map(|w| w.centre).collect();
        let mean = faults.iter().map(|w| w.size).sum::<f64>() / faults.len().max(1) as f64;
        Some(Self {
            fault_cells: CellList::new(&at, (2.0 * mean).max(f64::MIN_POSITIVE)),
            is_horizon: horizon,
            centres,
            faults,
            max_fault_size: largest,
        })
    }

    /// Whether two facets cannot continue each other: of a fault and a horizon, or of horizons on
    /// either side of a fault.
    pub fn separates(&self, f: usize, g: usize) -> bool {
        match [f, g].map(|f| self.is_horizon[f]) {
            [true, true] => self.has_fault_between(self.centres[f], self.centres[g]),
            [a, b] => a != b,
        }
    }

    /// Whether the way from one point to another leads through a fault, or past a facet of it by less than
    /// half the facet's size: a fault lacks facets here and there.
    fn has_fault_between(&self, a: [f64; D], b: [f64; D]) -> bool {
        let to = sub(b, a);
        let middle = add_scaled(a, 0.5, to);
        let mut found = false;
        let reach = 0.5 * norm(to) + self.max_fault_size;
        self.fault_cells.visit_within(middle, reach, |n| {
            let wall = &self.faults[n];
            let [from, until] = [a, b].map(|x| dot(sub(x, wall.centre), wall.normal));
            if from * until < 0.0 {
                let at = add_scaled(a, from / (from - until), to);
                found |= norm(sub(at, wall.centre)) < wall.size;
            }
        });
        found
    }
}

/// The kind of each facet by what it and those that surely continue it were told to be.
fn smooth_kinds<const D: usize>(facets: &FacetComplex<D>, mut horizon: Vec<bool>) -> Vec<bool> {
    let near: Vec<[u32; D]> = (0..facets.len())
        .into_par_iter()
        .map(|f| std::array::from_fn(|k| smooth_neighbour(facets, D * f + k)))
        .collect();
    for _ in 0..KIND_RINGS {
        horizon = (0..facets.len())
            .into_par_iter()
            .map(|f| {
                let sign = |f: usize| if horizon[f] { 1 } else { -1 };
                let others = near[f].iter().filter(|&&g| g != NONE);
                // Two neighbours outvote a facet, one does not.
                let sum: i32 = others.map(|&g| sign(g as usize)).sum();
                2 * sum + 3 * sign(f) > 0
            })
            .collect();
    }
    horizon
}
