//! Directions round which normals gather.

use crate::geometry::wide::wide;
use crate::geometry::{dot, unit};

/// Directions at most ...
const MOST: usize = 4;
/// ... judged by so many normals ...
const NORMALS: usize = 300;
/// ... within this (cosine: 18 degrees) ...
const SAME: f64 = 0.95;
/// ... with at least this share of all.
const LEAST: f64 = 0.025;
/// Normals from which a direction is sought, and the strongest.
const STARTS: usize = 16;

/// Normals looked at at once.
const LANES: usize = 8;

/// A normal and its weight.
type Weighted<const D: usize> = ([f64; D], f64);

/// Up to [`MOST`] directions round which normals gather, given with their weights.
pub fn modes<const D: usize>(mut normals: Vec<Weighted<D>>) -> Vec<[f64; D]> {
    let every = normals.len() / NORMALS + 1;
    if every > 1 {
        normals = normals.into_iter().step_by(every).collect();
    }
    let all: f64 = normals.iter().map(|n| n.1).sum();
    let mut modes = Vec::new();
    while modes.len() < MOST {
        let strongest = normals.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some(&(strongest, _)) = strongest else {
            break;
        };
        // The best of some starts, moved to the mean of what is round it.
        let columns = Columns::new(&normals);
        let starts = normals.iter().step_by(normals.len() / STARTS + 1);
        let starts = starts.map(|n| n.0).chain([strongest]);
        let best = starts
            .map(|start| columns.round(start))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((mode, _)) = best else { break };
        let (mode, weight) = columns.round(mode);
        if weight < LEAST * all {
            break;
        }
        modes.push(mode);
        normals.retain(|(n, _)| dot(*n, mode).abs() <= SAME);
    }
    modes
}

/// Normals and their weights by component, with some of no weight at the end, so that their number is a
/// multiple of the lanes.
struct Columns<const D: usize> {
    normals: [Vec<f64>; D],
    weights: Vec<f64>,
}

impl<const D: usize> Columns<D> {
    fn new(normals: &[Weighted<D>]) -> Self {
        let length = normals.len().next_multiple_of(LANES);
        let filled = |of: &dyn Fn(&Weighted<D>) -> f64| {
            let mut column: Vec<f64> = Vec::with_capacity(length);
            column.extend(normals.iter().map(of));
            column.resize(length, 0.0);
            column
        };
        Self {
            normals: std::array::from_fn(|k| filled(&|n| n.0[k])),
            weights: filled(&|n| n.1),
        }
    }

    /// The mean direction of the normals near one, and their weight.
    fn round(&self, about: [f64; D]) -> Weighted<D> {
        let mut sums = [[0.0f64; LANES]; D];
        let mut weights = [0.0f64; LANES];
        wide(
            #[inline(always)]
            || {
                for (group, weight) in self.weights.chunks_exact(LANES).enumerate() {
                    let n: [&[f64]; D] =
                        std::array::from_fn(|k| &self.normals[k][group * LANES..][..LANES]);
                    for l in 0..LANES {
                        let c: f64 = (0..D).map(|k| n[k][l] * about[k]).sum();
                        let near = if c.abs() > SAME { weight[l] } else { 0.0 };
                        weights[l] += near;
                        // A normal has no sign.
                        let near = near.copysign(c);
                        for k in 0..D {
                            sums[k][l] += near * n[k][l];
                        }
                    }
                }
            },
        );
        let total = |lanes: [f64; LANES]| -> f64 { lanes.iter().sum() };
        (unit(sums.map(total)), total(weights))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_sheets_among_stray_normals_give_three_directions() {
        let sheets = [[1.0, 0.1, 0.0], [0.0, 0.8, 0.6], [-0.5, 0.5, 0.7]].map(unit);
        let mut normals = Vec::new();
        for i in 0..500 {
            // Within five degrees, and on either side.
            let turn = |k: usize| 0.05 * ((i * (7 + k)) as f64).sin();
            let sheet = sheets[i % 3];
            let n = unit(std::array::from_fn(|k| sheet[k] + turn(k)));
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            normals.push((n.map(|c| sign * c), 1.0 + 0.1 * turn(3)));
        }
        normals.push((unit([0.3, -0.9, 0.3]), 0.5));
        let found = modes(normals);
        assert_eq!(found.len(), 3, "{found:?}");
        for sheet in sheets {
            assert!(found.iter().any(|mode| dot(*mode, sheet).abs() > 0.999));
        }
        assert!(modes::<3>(Vec::new()).is_empty());
    }
}
