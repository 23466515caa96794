//! What it costs to call a cell object or background, and to have a boundary between two cells.

use super::{Links, Options, SegmentSeeds};
use crate::error::cause;
use crate::{Error, Result};

/// Number of classes of a histogram.
const BIN_COUNT: usize = 64;

/// Share of every histogram that lies evenly over all classes: no value is impossible.
const UNIFORM_SHARE: f64 = 0.01;

/// The least width to which a seed's value is spread, in classes.
const MIN_KERNEL_WIDTH: f64 = 1.5;

/// The largest capacity, but for those of seeds: whole numbers up to here, thousands of which add up
/// to less than 2^31.
const MAX_CAPACITY: f64 = (1 << 20) as f64;

/// -ln Pr of object and of background, by classes of values.
#[derive(Debug, Clone)]
pub struct RegionCosts {
    low: f32,
    /// Classes in a unit of value.
    scale: f32,
    costs: Vec<[f64; 2]>,
}

impl RegionCosts {
    /// From the values of the seeds, each spread as a Gaussian of the width that suits their number
    /// (Silverman 1986: 1.06 times their standard deviation over the fifth root of it), of 1.5
    /// classes at least.
    ///
    /// # Errors
    /// [`Error::Job`] if either kind has no seed, or a cell is a seed of both.
    pub fn new(values: &[f32], seeds: &SegmentSeeds) -> Result<Self> {
        let [object, background] = [("object", &seeds.object), ("background", &seeds.background)]
            .map(|(seeds, cells)| match cells.is_empty() {
                false => Ok(cells),
                true => Err(Error::Job(
                    cause(
                        format!("the {seeds}'s seeds"),
                        "hold no cell or sample",
                        "give a point, or a box that is not smaller than a cell",
                    )
                    .with_parameter(seeds),
                )),
            });
        let (object, background) = (object?, background?);
        let mut sorted = background.clone();
        sorted.sort_unstable();
        if let Some(both) = object
            .iter()
            .find(|&cell| sorted.binary_search(cell).is_ok())
        {
            return Err(Error::Job(cause(
                "seeds of object and background",
                format!("both hold cell {both}"),
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
            let places: Vec<f64> = cells
                .iter()
                .map(|&cell| f64::from((values[cell as usize] - low) * scale))
                .collect();
            histogram(&places)
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

    /// What a value costs as object, and as background.
    #[inline]
    pub fn costs(&self, value: f32) -> [f64; 2] {
        let class = ((value - self.low) * self.scale) as usize;
        self.costs[class.min(BIN_COUNT - 1)]
    }
}

/// The share of each class, from values in units of classes.
fn histogram(places: &[f64]) -> Vec<f64> {
    let n = places.len() as f64;
    let mean = places.iter().sum::<f64>() / n;
    let variance = places.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / n;
    let width = (1.06 * variance.sqrt() / n.powf(0.2)).max(MIN_KERNEL_WIDTH);
    let mut counts = vec![0.0; BIN_COUNT];
    for &place in places {
        counts[(place as usize).min(BIN_COUNT - 1)] += 1.0;
    }
    let spread = |class: usize| {
        let part = |(other, count): (usize, &f64)| {
            let off = (class as f64 - other as f64) / width;
            count * (-0.5 * off * off).exp()
        };
        counts.iter().enumerate().map(part).sum::<f64>()
    };
    let spread: Vec<f64> = (0..BIN_COUNT).map(spread).collect();
    let sum: f64 = spread.iter().sum();
    let share = |s: &f64| (1.0 - UNIFORM_SHARE) * s / sum + UNIFORM_SHARE / BIN_COUNT as f64;
    spread.iter().map(share).collect()
}

/// Costs of boundaries, and whole numbers for all costs.
#[derive(Debug, Clone)]
pub struct BoundaryCosts {
    /// The difference of values at which a boundary is cheap.
    pub sigma: f64,
    /// -1 / (2 sigma^2).
    exponent: f32,
    /// Whole numbers in a unit of cost.
    scale: f64,
}

impl BoundaryCosts {
    /// Of cells with these values.
    pub fn new(values: &[f32], links: Links<'_>, options: &Options) -> Self {
        let (mut sum, mut count, mut largest) = (0.0, 0.0, 0.0f64);
        links(&mut |a, b, area| {
            let difference = f64::from(values[a as usize]) - f64::from(values[b as usize]);
            sum += difference * difference;
            count += 1.0;
            largest = largest.max(area);
        });
        let mean_square = if count > 0.0 { sum / count } else { 0.0 };
        let sigma = options.sigma.unwrap_or_else(|| mean_square.sqrt());
        // Where all neighbours are alike no boundary is cheap.
        let exponent = if sigma > 0.0 {
            -0.5 / (sigma * sigma)
        } else {
            0.0
        };
        Self {
            sigma,
            exponent: exponent as f32,
            scale: if largest > 0.0 {
                MAX_CAPACITY / largest
            } else {
                MAX_CAPACITY
            },
        }
    }

    /// exp(-(p - q)^2 / (2 sigma^2)).
    #[inline]
    pub fn boundary_weight(&self, p: f32, q: f32) -> f64 {
        f64::from((self.exponent * (p - q) * (p - q)).exp())
    }

    /// A cost as a capacity; of what is costlier than 2^9 of the largest faces the order is lost.
    #[inline]
    pub fn capacity(&self, cost: f64) -> i32 {
        // Beyond what all of a cell's faces can carry it makes no difference.
        (cost * self.scale + 0.5).min(512.0 * MAX_CAPACITY) as i32
    }

    /// A sum of capacities as a cost.
    pub fn to_cost(&self, capacity: i64) -> f64 {
        capacity as f64 / self.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histograms_are_shares_round_the_seeds() {
        for places in [
            vec![10.2],
            vec![0.0, 63.9, 64.0],
            (0..1000).map(|i| f64::from(i) * 0.064).collect(),
        ] {
            let shares = histogram(&places);
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!(shares.iter().all(|s| *s > 1e-4));
        }
        let one = histogram(&[10.2]);
        let best = one
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(b.1))
            .unwrap()
            .0;
        assert_eq!(best, 10);
        // A value that is 4 standard deviations off is as unlikely as the even part says.
        assert!((one[40] - UNIFORM_SHARE / 64.0).abs() < 1e-12);
        let even = histogram(&(0..6400).map(|i| f64::from(i) * 0.01).collect::<Vec<_>>());
        assert!((even[32] * 64.0 - 1.0).abs() < 0.1, "{}", even[32]);
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
        // Far from both, neither: the cut decides.
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
        // All alike: every boundary costs its whole area.
        let flat = BoundaryCosts::new(&[1.0; 4], &links, &Options::default());
        assert_eq!(flat.boundary_weight(1.0, 1.0), 1.0);
    }
}
