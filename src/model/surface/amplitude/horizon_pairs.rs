//! Throw from pairs of horizons that end on both sides of a fault.
//!
//! A horizon near a fault is continued along its dip to the fault, where it has a level. The waveform
//! around it, along the dip of the fault and averaged over the faces of the horizon near the fault on
//! one side, tells which horizons of both sides are the same reflector. Each such pair votes for the
//! difference of its levels as the throw, in bins along the strike of the fault. Where most votes agree,
//! they give the throw. A horizon with the same number on both sides does not count: where it is not
//! displaced, it mostly leaks past the fault.

use std::collections::BTreeMap;

use super::super::facets::FacetComplex;
use super::AmplitudeSpace;
use crate::geometry::cell_list::CellList;
use crate::geometry::statistics::upper_median;
use crate::geometry::{add_scaled, distance2, dot, norm, normal, sub, unit};
use crate::image::fault_traces::{FaultPoint, MAX_LAG};

/// Distances (samples) of the faces of horizons from the fault.
const MIN_DISTANCE: f64 = 3.0;
const MAX_DISTANCE: f64 = 14.0;

/// Largest distance (samples) along the fault from the nearest face of it.
const MAX_OFFSET: f64 = 6.0;

/// Length (samples) of the bins along the strike.
const BIN: f64 = 8.0;

/// Half the length (samples) of a waveform.
const HALF_WAVEFORM: isize = 24;

/// Smallest number of faces of a horizon on one side, and of common bins of a pair.
const MIN_FACES: usize = 6;
const MIN_BINS: usize = 2;

/// Smallest correlation of the waveforms of a pair, and the correlation at which a vote has no
/// weight.
const MIN_CORRELATION: f64 = 0.7;
const NO_WEIGHT_CORRELATION: f64 = 0.5;

/// Width (bins) over which votes count along the strike, and width (samples) of a vote.
const BIN_WIDTH: f64 = 2.0;
const VOTE_WIDTH: f64 = 2.0;

/// Smallest sum of votes, and the largest share of it that may vote for another throw.
const MIN_VOTES: f64 = 0.3;
const MAX_OTHER_VOTES: f64 = 0.7;

/// The faces of all horizons.
pub(super) struct HorizonFaces<const D: usize> {
    centroids: Vec<[f64; D]>,
    normals: Vec<[f64; D]>,
    horizons: Vec<usize>,
}

/// Throws of the faces of a fault, in samples downwards, from pairs of horizons.
#[derive(Debug, Clone, Default)]
pub(super) struct PairThrows {
    /// The throw at each face.
    pub throws: Vec<Option<f64>>,
    /// Number of pairs.
    pub pairs: usize,
}

/// A horizon on one side of a fault.
struct Cutoff {
    /// Sum of levels and number of faces in each bin.
    levels: BTreeMap<i64, (f64, usize)>,
    /// Sum of samples and number of known ones.
    waveform: Vec<(f64, usize)>,
    faces: usize,
}

/// A vote for a throw.
struct Vote {
    bin: i64,
    throw: f64,
    weight: f64,
}

impl<const D: usize> HorizonFaces<D> {
    /// Returns the faces of the horizons with these numbers.
    pub fn new<'a>(horizons: impl Iterator<Item = (usize, FacetComplex<'a, D>)>) -> Self {
        let mut faces = Self {
            centroids: Vec::new(),
            normals: Vec::new(),
            horizons: Vec::new(),
        };
        for (number, complex) in horizons {
            faces.centroids.extend(complex.centroids());
            let corners = (complex.facets.iter()).map(|f| f.map(|n| complex.nodes[n as usize]));
            faces.normals.extend(corners.map(|x| unit(normal(&x))));
            faces.horizons.resize(faces.centroids.len(), number);
        }
        faces
    }
}

impl<const D: usize> AmplitudeSpace<'_, D> {
    /// Returns the throws at the faces of a fault whose centres and normals are `points`. In the plane
    /// there are none.
    pub(super) fn pair_throws(
        &self,
        points: &[FaultPoint<D>],
        horizons: &HorizonFaces<D>,
    ) -> PairThrows {
        let mut result = PairThrows {
            throws: vec![None; points.len()],
            pairs: 0,
        };
        let Some(strike) = self
            .strike(points)
            .filter(|_| !horizons.horizons.is_empty())
        else {
            return result;
        };
        let bin = |x: [f64; D]| (dot(x, strike) / BIN).floor() as i64;
        let cutoffs = self.cutoffs(points, horizons, bin);
        let mut votes = Vec::new();
        for ((a, _), foot) in cutoffs.iter().filter(|((_, hanging), _)| !hanging) {
            for ((b, _), hanging) in cutoffs.iter().filter(|((_, hanging), _)| *hanging) {
                if a != b && add_votes(foot, hanging, &mut votes) {
                    result.pairs += 1;
                }
            }
        }
        let mut by_bin: BTreeMap<i64, Option<f64>> = BTreeMap::new();
        for (throw, point) in result.throws.iter_mut().zip(points) {
            let bin = bin(point.position);
            *throw = *by_bin
                .entry(bin)
                .or_insert_with(|| agreed_throw(&votes, bin));
        }
        result
    }

    /// Returns the horizontal direction along a fault; `None` in the plane, and for a fault that is
    /// horizontal on average.
    fn strike(&self, points: &[FaultPoint<D>]) -> Option<[f64; D]> {
        if D != 3 {
            return None;
        }
        let sum = points
            .iter()
            .fold([0.0; D], |sum, point| add_scaled(sum, 1.0, point.normal));
        let [a, b] = [(self.vertical + 1) % D, (self.vertical + 2) % D];
        let mut strike = [0.0; D];
        (strike[a], strike[b]) = (-sum[b], sum[a]);
        (norm(strike) > 0.1 * points.len() as f64).then(|| unit(strike))
    }

    /// Returns the horizons on the footwall (`false`) and on the hanging wall (`true`).
    fn cutoffs(
        &self,
        points: &[FaultPoint<D>],
        horizons: &HorizonFaces<D>,
        bin: impl Fn([f64; D]) -> i64,
    ) -> BTreeMap<(usize, bool), Cutoff> {
        let positions: Vec<[f64; D]> = points.iter().map(|point| point.position).collect();
        let list = CellList::new(&positions, MAX_DISTANCE);
        let mut cutoffs: BTreeMap<(usize, bool), Cutoff> = BTreeMap::new();
        let faces = horizons.centroids.iter().zip(&horizons.normals);
        for ((centre, horizon_normal), number) in faces.zip(&horizons.horizons) {
            let mut nearest = (MAX_DISTANCE * MAX_DISTANCE, usize::MAX);
            list.visit_within(*centre, MAX_DISTANCE, |i| {
                let distance = distance2(&positions[i], centre);
                if (distance, i) < nearest {
                    nearest = (distance, i);
                }
            });
            let Some(point) = points.get(nearest.1) else {
                continue;
            };
            if nearest.0 < MIN_DISTANCE * MIN_DISTANCE {
                continue;
            }
            let Some((side, place)) = self.projected(point, *centre, *horizon_normal) else {
                continue;
            };
            let length = (2 * HALF_WAVEFORM + 1) as usize;
            let cutoff = cutoffs
                .entry((*number, side > 0.0))
                .or_insert_with(|| Cutoff {
                    levels: BTreeMap::new(),
                    waveform: vec![(0.0, 0); length],
                    faces: 0,
                });
            let level = cutoff.levels.entry(bin(place)).or_default();
            *level = (level.0 + place[self.vertical], level.1 + 1);
            cutoff.faces += 1;
            let along = point.down_dip(self.vertical);
            for (sum, u) in cutoff.waveform.iter_mut().zip(-HALF_WAVEFORM..) {
                let x = add_scaled(*centre, u as f64, along);
                let dims = self.image.dims();
                if (0..D).all(|k| x[k] >= 0.0 && x[k] <= (dims[k] - 1) as f64) {
                    let value = f64::from(self.image.interpolate_linear(x)) - self.scale.mean;
                    *sum = (sum.0 + value, sum.1 + 1);
                }
            }
        }
        cutoffs.retain(|_, cutoff| cutoff.faces >= MIN_FACES);
        cutoffs
    }

    /// Returns the distance of a face of a horizon from a fault, positive in the hanging wall, and the
    /// place where the horizon, continued along its dip, meets the fault.
    fn projected(
        &self,
        point: &FaultPoint<D>,
        centre: [f64; D],
        horizon_normal: [f64; D],
    ) -> Option<(f64, [f64; D])> {
        let offset = sub(centre, point.position);
        let side = dot(offset, point.normal);
        let along = norm(add_scaled(offset, -side, point.normal));
        let mut across = point.normal;
        across[self.vertical] = 0.0;
        if side.abs() < 0.5 || along > MAX_OFFSET {
            return None;
        }
        if norm(across) < 0.2 || horizon_normal[self.vertical].abs() < 0.3 {
            return None;
        }
        let mut step = unit(across);
        step[self.vertical] = -dot(horizon_normal, step) / horizon_normal[self.vertical];
        let approach = dot(step, point.normal);
        if approach.abs() < 0.05 {
            return None;
        }
        let length = -side / approach;
        (length.abs() < MAX_DISTANCE).then(|| (side, add_scaled(centre, length, step)))
    }
}

/// Adds the votes of two horizons if they are the same reflector. Returns `true` if they are.
fn add_votes(foot: &Cutoff, hanging: &Cutoff, votes: &mut Vec<Vote>) -> bool {
    let mean = |(sum, count): &(f64, usize)| sum / *count as f64;
    let throws: Vec<(i64, f64)> = (foot.levels.iter())
        .filter_map(|(bin, low)| {
            let high = hanging.levels.get(bin)?;
            Some((*bin, mean(high) - mean(low)))
        })
        .collect();
    let mut sizes: Vec<f64> = throws.iter().map(|throw| throw.1.abs()).collect();
    let median = upper_median(&mut sizes);
    if throws.len() < MIN_BINS || median.is_none_or(|size| size > MAX_LAG as f64) {
        return false;
    }
    let known = (foot.waveform.iter().zip(&hanging.waveform)).filter(|(a, b)| a.1 > 0 && b.1 > 0);
    let (mut product, mut squares, mut count) = (0.0, [0.0; 2], 0);
    for (a, b) in known {
        let (a, b) = (mean(a), mean(b));
        product += a * b;
        squares = [squares[0] + a * a, squares[1] + b * b];
        count += 1;
    }
    let energy: f64 = squares[0] * squares[1];
    let correlation = product / energy.sqrt().max(f64::MIN_POSITIVE);
    if count < HALF_WAVEFORM || correlation < MIN_CORRELATION {
        return false;
    }
    let weight = correlation - NO_WEIGHT_CORRELATION;
    votes.extend(
        throws
            .into_iter()
            .map(|(bin, throw)| Vote { bin, throw, weight }),
    );
    true
}

/// Returns the throw for which most votes in and around a bin agree.
fn agreed_throw(votes: &[Vote], bin: i64) -> Option<f64> {
    let bell = |x: f64| (-0.5 * x * x).exp();
    let weight = |vote: &Vote| vote.weight * bell((vote.bin - bin) as f64 / BIN_WIDTH);
    let sum_at = |throw: f64| -> f64 {
        let near = votes.iter();
        near.map(|vote| weight(vote) * bell((vote.throw - throw) / VOTE_WIDTH))
            .sum()
    };
    let max = 2 * MAX_LAG as isize;
    let sums: Vec<(f64, f64)> = (-max..=max)
        .map(|k| 0.5 * k as f64)
        .map(|throw| (throw, sum_at(throw)))
        .collect();
    let best =
        (sums.iter().copied()).reduce(|best, sum| if sum.1 > best.1 { sum } else { best })?;
    let others = sums
        .iter()
        .filter(|sum| (sum.0 - best.0).abs() > 2.5 * VOTE_WIDTH);
    let other = others.fold(0.0, |max, sum| f64::max(max, sum.1));
    if best.1 < MIN_VOTES || other > MAX_OTHER_VOTES * best.1 {
        return None;
    }
    let near = votes
        .iter()
        .filter(|vote| (vote.throw - best.0).abs() < 2.0 * VOTE_WIDTH);
    let (sum, total) = near.fold((0.0, 0.0), |(sum, total), vote| {
        let weight = weight(vote);
        (sum + weight * vote.throw, total + weight)
    });
    Some(sum / total)
}
