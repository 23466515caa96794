//! Costs of a segmentation: of assigning a cell to object or background, and of a boundary between
//! two cells.

use super::{Links, Options, SegmentSeeds};
use crate::error::cause;
use crate::geometry::sorted;
use crate::{Error, Result};

/// Number of bins of a histogram.
const BIN_COUNT: usize = 64;

/// Fraction of each histogram that is spread evenly over all bins, so that no value is impossible.
const UNIFORM_SHARE: f64 = 0.01;

/// Smallest standard deviation of the smoothing kernel, in bins.
const MIN_KERNEL_WIDTH: f64 = 1.5;

/// Largest capacity of a face. Capacities are integers; sums of thousands of them stay below 2^31.
/// Capacities of seeds may be larger.
const MAX_CAPACITY: f64 = (1 << 20) as f64;

/// Costs -ln Pr(value) of object and of background, by bins of values.
#[derive(Debug, Clone)]
pub struct RegionCosts {
    low: f32,
    /// Number of bins per unit of value.
    scale: f32,
    costs: Vec<[f64; 2]>,
}

impl RegionCosts {
    /// Computes the costs from the values of the seeds. Each histogram is smoothed by a Gaussian
    /// kernel whose standard deviation is 1.06 times that of the values over the fifth root of
    /// their number (Silverman 1986), but at least 1.5 bins.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if object or background has no seed, or if a cell is a seed of both.
    pub fn new(values: &[f32], seeds: &SegmentSeeds) -> Result<Self> {
        let [object, background] = [("object", &seeds.object), ("background", &seeds.background)]
            .map(|(kind, cells)| {
                if cells.is_empty() {
                    Err(Error::Job(
                        cause(
                            format!("the {kind}'s seeds"),
                            "contain no cell or sample",
                            "give a point, or a box that is not smaller than a cell",
                        )
                        .with_parameter(kind),
                    ))
                } else {
                    Ok(cells)
                }
            });
        let (object, background) = (object?, background?);
        let sorted = sorted(background.clone());
        if let Some(shared) = object
            .iter()
            .find(|&cell| sorted.binary_search(cell).is_ok())
        {
            return Err(Error::Job(cause(
                "seeds of object and background",
                format!("both contain cell {shared}"),
                "move them apart, or mesh with a smaller distance",
            )));
        }
        let (low, high) = values
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &v| {
                (low.min(v), high.max(v))
            });
        let scale = if high > low {
            BIN_COUNT as f32 / (high - low)
        } else {
            0.0
        };
        let histogram = |cells: &[u32]| {
            let positions: Vec<f64> = cells
                .iter()
                .map(|&cell| f64::from((values[cell as usize] - low) * scale))
                .collect();
            histogram(&positions)
        };
        let (object, background) = (histogram(object), histogram(background));
        let costs = object
            .iter()
            .zip(&background)
            .map(|(o, b)| [-o.ln(), -b.ln()]);
        Ok(Self {
            low,
            scale,
            costs: costs.collect(),
        })
    }

    /// Returns the cost of a value as object and as background.
    #[inline]
    pub fn costs(&self, value: f32) -> [f64; 2] {
        let bin = ((value - self.low) * self.scale) as usize;
        self.costs[bin.min(BIN_COUNT - 1)]
    }
}

/// Returns the probability of each bin, from values in units of bins.
fn histogram(positions: &[f64]) -> Vec<f64> {
    let n = positions.len() as f64;
    let mean = positions.iter().sum::<f64>() / n;
    let variance = positions.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / n;
    let width = (1.06 * variance.sqrt() / n.powf(0.2)).max(MIN_KERNEL_WIDTH);
    let mut counts = vec![0.0; BIN_COUNT];
    for &position in positions {
        counts[(position as usize).min(BIN_COUNT - 1)] += 1.0;
    }
    let smoothed = |bin: usize| {
        let kernel = |(other, count): (usize, &f64)| {
            let deviation = (bin as f64 - other as f64) / width;
            count * (-0.5 * deviation * deviation).exp()
        };
        counts.iter().enumerate().map(kernel).sum::<f64>()
    };
    let smoothed: Vec<f64> = (0..BIN_COUNT).map(smoothed).collect();
    let sum: f64 = smoothed.iter().sum();
    let share = |s: &f64| (1.0 - UNIFORM_SHARE) * s / sum + UNIFORM_SHARE / BIN_COUNT as f64;
    smoothed.iter().map(share).collect()
}

/// Costs of boundaries, and the scale from costs to integer capacities.
#[derive(Debug, Clone)]
pub struct BoundaryCosts {
    /// Difference between values at which a boundary becomes cheap.
    pub sigma: f64,
    /// -1 / (2 sigma^2), or 0 if sigma is 0.
    exponent: f32,
    /// Units of capacity per unit of cost.
    scale: f64,
}

impl BoundaryCosts {
    /// Computes the costs for cells with these values.
    pub fn new(values: &[f32], links: Links<'_>, options: &Options) -> Self {
        let (mut sum, mut count, mut max_area) = (0.0, 0.0, 0.0f64);
        links(&mut |a, b, area| {
            let difference = f64::from(values[a as usize]) - f64::from(values[b as usize]);
            sum += difference * difference;
            count += 1.0;
            max_area = max_area.max(area);
        });
        let mean_square = if count > 0.0 { sum / count } else { 0.0 };
        let sigma = options.sigma.unwrap_or_else(|| mean_square.sqrt());
        // If all neighbours have equal values, every boundary costs its whole area.
        let exponent = if sigma > 0.0 {
            -0.5 / (sigma * sigma)
        } else {
            0.0
        };
        Self {
            sigma,
            exponent: exponent as f32,
            scale: if max_area > 0.0 {
                MAX_CAPACITY / max_area
            } else {
                MAX_CAPACITY
            },
        }
    }

    /// Returns exp(-(p - q)^2 / (2 sigma^2)).
    #[inline]
    pub fn boundary_weight(&self, p: f32, q: f32) -> f64 {
        f64::from((self.exponent * (p - q) * (p - q)).exp())
    }

    /// Converts a cost to a capacity. Costs above 2^9 times the largest face are limited to that
    /// value.
    #[inline]
    pub fn capacity(&self, cost: f64) -> i32 {
        // More than all faces of a cell can carry makes no difference to the cut.
        (cost * self.scale + 0.5).min(512.0 * MAX_CAPACITY) as i32
    }

    /// Converts a sum of capacities to a cost.
    pub fn to_cost(&self, capacity: i64) -> f64 {
        capacity as f64 / self.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histograms_are_shares_round_the_seeds() {
        for positions in [
            vec![10.2],
            vec![0.0, 63.9, 64.0],
            (0..1000).map(|i| f64::from(i) * 0.064).collect(),
        ] {
            let shares = histogram(&positions);
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!(shares.iter().all(|s| *s > 1e-4));
        }
        let single = histogram(&[10.2]);
        let peak = single
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(b.1))
            .unwrap()
            .0;
        assert_eq!(peak, 10);
        // A value 4 standard deviations away has only the probability of the even part.
        assert!((single[40] - UNIFORM_SHARE / 64.0).abs() < 1e-12);
        let uniform = histogram(&(0..6400).map(|i| f64::from(i) * 0.01).collect::<Vec<_>>());
        assert!((uniform[32] * 64.0 - 1.0).abs() < 0.1, "{}", uniform[32]);
    }

    #[test]
    fn the_own_histogram_is_the_cheaper_one() {
        let values: Vec<f32> = (0..100).map(|i| i as f32).collect();
        let seeds = SegmentSeeds {
            object: vec![80, 85, 90],
            background: vec![5, 10],
        };
        let regions = RegionCosts::new(&values, &seeds).unwrap();
        let [object, background] = regions.costs(84.0);
        assert!(object < 4.0 && background > 8.0, "{object} {background}");
        let [object, background] = regions.costs(7.0);
        assert!(object > 8.0 && background < 4.0, "{object} {background}");
        // Far from both groups of seeds the costs are similar, so the cut decides.
        let [object, background] = regions.costs(40.0);
        assert!((object - background).abs() < 0.5, "{object} {background}");
    }

    #[test]
    fn sigma_is_the_usual_difference() {
        let values = [0.0, 3.0, 3.0, 7.0];
        let links = |add: &mut dyn FnMut(u32, u32, f64)| {
            for i in 0..3 {
                add(i, i + 1, 2.0);
            }
        };
        let costs = BoundaryCosts::new(&values, &links, &Options::default());
        assert!((costs.sigma - (25.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((costs.boundary_weight(0.0, 5.0) - (-1.5f64).exp()).abs() < 1e-6);
        assert!((costs.to_cost(i64::from(costs.capacity(1.25))) - 1.25).abs() < 1e-5);
        // With equal values, every boundary costs its whole area.
        let uniform = BoundaryCosts::new(&[1.0; 4], &links, &Options::default());
        assert_eq!(uniform.boundary_weight(1.0, 1.0), 1.0);
    }
}
