//! d of which each of a group has some layers, and is told what is near to what it works on.
//!
//! What is told comes in bricks, each of which holds the samples of its cells, so that interpolation, which is that of
//! all samples to the last bit, looks into one brick only.

use std::borrow::Cow;
use std::ops::Range;

use super::features::{DistanceLimits, coarse_grid, for_each_corner};
use super::grading::limit_gradient_in_layers;
use super::{CellPosition, Distance, GridCell, density_sum, max_slopes, slope_norm};
use crate::comm::{Comm, partition_range};
use crate::error::Result;
use crate::geometry::morphology;
use crate::image::{MissFlag, ScalarField};
use crate::progress::CancelToken;

/// Cells along an edge of a brick.
const BRICK_CELLS: usize = 8;
/// Samples along an edge of a brick.
const BRICK_SAMPLES: usize = BRICK_CELLS + 1;
/// A brick of which nothing is known here.
const NOT_LOCAL: u32 = u32::MAX;

/// The nominal distance between atoms, as a group has it.
#[derive(Debug, Clone, PartialEq)]
pub enum DistributedDistance<const D: usize> {
    /// Each has all of it.
    Global(Distance<D>),
    /// Each has some layers.
    Layers(DistanceLayers<D>),
}

/// Samples of d of some layers along the last axis.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceLayers<const D: usize> {
    /// Of the whole grid.
    dims: [usize; D],
    step: [f64; D],
    /// The layer of the first samples: those beside one's own are here, too.
    first_layer: usize,
    samples: Vec<f32>,
    summary: DistanceSummary,
}

/// What all of a group know of d.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DistanceSummary {
    pub min: f64,
    pub max: f64,
    /// The mean of d^-D.
    pub mean_density: f64,
    /// A bound on |grad d|.
    pub max_slope: f64,
}

/// Some bricks of samples of d; others are elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceBricks<const D: usize> {
    dims: [usize; D],
    step: [f64; D],
    /// For each brick, x fastest, its number among those that are here.
    local_indices: Vec<u32>,
    samples: Vec<f32>,
    pub(super) summary: DistanceSummary,
    misses: MissFlag,
}

/// Bricks along each axis.
fn bricks_per_axis<const D: usize>(dims: [usize; D]) -> [usize; D] {
    dims.map(|n| n.saturating_sub(1).max(1).div_ceil(BRICK_CELLS))
}

/// The layers of bricks of one of `count`, and its layers of samples.
fn owned_layers<const D: usize>(
    dims: [usize; D],
    rank: usize,
    count: usize,
) -> (Range<usize>, Range<usize>) {
    let all = bricks_per_axis(dims)[D - 1];
    let own = partition_range(all, rank, count);
    let layers = match own.is_empty() {
        true => 0..0,
        false if own.end == all => own.start * BRICK_CELLS..dims[D - 1],
        false => own.start * BRICK_CELLS..own.end * BRICK_CELLS,
    };
    (own, layers)
}

impl<const D: usize> DistanceLayers<D> {
    /// d from what it is at points, of which each of the group has some, growing away from these.
    ///
    /// # Errors
    /// Those of the others.
    pub(super) fn from_points(
        extent: [f64; D],
        limits: DistanceLimits,
        points: impl Iterator<Item = ([f32; D], f32)>,
        patience: &CancelToken<'_>,
        group: &dyn Comm,
    ) -> Result<Self> {
        let (rank, count) = (group.rank(), group.size());
        let (dims, step) = coarse_grid(extent, limits.min);
        let layers: Vec<Range<usize>> = (0..count)
            .map(|of| owned_layers(dims, of, count).1)
            .collect();
        let own = layers[rank].clone();
        let first = own.start.saturating_sub(1);
        let end = match own.is_empty() {
            true => first,
            false => (own.end + 1).min(dims[D - 1]),
        };
        let layer: usize = dims[..D - 1].iter().product();
        let mut here = dims;
        here[D - 1] = end - first;
        let mut field = ScalarField {
            dims: here,
            step,
            samples: vec![limits.max as f32; layer * (end - first)],
        };
        // Each sample round a point is its layer's.
        let mut to: Vec<Vec<([f32; D], f32)>> = vec![Vec::new(); count];
        let mut put = |(x, d): ([f32; D], f32), mut other: Option<&mut Vec<Vec<_>>>| {
            for_each_corner(x.map(f64::from), dims, step, |mut at| {
                if own.contains(&at[D - 1]) {
                    at[D - 1] -= first;
                    let at = (0..D).rev().fold(0, |all, k| all * here[k] + at[k]);
                    field.samples[at] = field.samples[at].min(d);
                } else if let Some(to) = &mut other {
                    let of = layers.iter().position(|of| of.contains(&at[D - 1]));
                    let to: &mut Vec<_> = &mut to[of.unwrap_or(rank)];
                    if to.last() != Some(&(x, d)) {
                        to.push((x, d));
                    }
                }
            });
        };
        points.for_each(|point| put(point, Some(&mut to)));
        let told: Vec<Vec<([f32; D], f32)>> = group.all_to_all("distances at points", to)?;
        told.into_iter()
            .flatten()
            .for_each(|point| put(point, None));
        limit_gradient_in_layers(&mut field, first, &layers, limits.growth, patience, group)?;

        let from = (own.start - first) * layer;
        let own = field.samples[from..from + own.len() * layer].chunks_exact(layer.max(1));
        let least = own.clone().flatten().fold(f32::INFINITY, |a, &b| a.min(b));
        let most = own.clone().flatten().fold(0.0f32, |a, &b| a.max(b));
        let crowds: Vec<f64> = own.map(density_sum::<D>).collect();
        let slopes = match field.samples.is_empty() {
            true => [0.0; D],
            false => max_slopes(&field),
        };
        type LayerMessage<const D: usize> = ([f64; 2], ([f64; D], Vec<f64>));
        let told = ([least.into(), most.into()], (slopes, crowds));
        let all: Vec<LayerMessage<D>> = group.all_gather("distances", told)?;
        let fold = |k: usize, of: fn(f64, f64) -> f64| all.iter().map(|(d, _)| d[k]).reduce(of);
        let steepest = |k: usize| {
            all.iter()
                .fold(0.0, |a: f64, (_, (slopes, _))| a.max(slopes[k]))
        };
        let crowd: f64 = all.iter().flat_map(|(_, (_, crowds))| crowds).sum();
        Ok(Self {
            dims,
            step,
            first_layer: first,
            samples: field.samples,
            summary: DistanceSummary {
                min: fold(0, f64::min).unwrap_or(limits.min),
                max: fold(1, f64::max).unwrap_or(limits.max),
                mean_density: crowd / dims.iter().product::<usize>() as f64,
                max_slope: slope_norm::<D>(std::array::from_fn(steepest)),
            },
        })
    }

    /// Of one's own layers all that the group has.
    fn all_gather(&self, group: &dyn Comm) -> Result<Distance<D>> {
        let layer: usize = self.dims[..D - 1].iter().product();
        let (_, own) = owned_layers(self.dims, group.rank(), group.size());
        let from = own.start.saturating_sub(self.first_layer) * layer;
        let samples = self.samples[from..from + own.len() * layer].to_vec();
        Ok(Distance::Field(ScalarField {
            dims: self.dims,
            step: self.step,
            samples: group.all_gather("samples of distances", samples)?.concat(),
        }))
    }

    /// Some bricks, wherever they are.
    fn fetch_bricks(&self, wanted: &[bool], group: &dyn Comm) -> Result<Distance<D>> {
        let along = bricks_per_axis(self.dims);
        let layer = wanted.len() / along[D - 1];
        let of = |rank: usize| -> Vec<usize> {
            let (own, _) = owned_layers(self.dims, rank, group.size());
            let own = own.start * layer..own.end * layer;
            own.filter(|&brick| wanted[brick]).collect()
        };
        let asked: Vec<Vec<usize>> = group.all_to_all(
            "bricks that are wanted",
            (0..group.size()).map(of).collect(),
        )?;
        let told = asked.iter().enumerate().map(|(rank, asked)| {
            let mut samples = Vec::new();
            if rank != group.rank() {
                samples.reserve_exact(asked.len() * BRICK_SAMPLES.pow(D as u32));
                asked
                    .iter()
                    .for_each(|&brick| self.copy_brick(brick, &mut samples));
            }
            samples
        });
        let told: Vec<Vec<f32>> = group.all_to_all("bricks of distances", told.collect())?;
        let mut samples = Vec::new();
        let count = wanted.iter().filter(|wanted| **wanted).count();
        samples.reserve_exact(count * BRICK_SAMPLES.pow(D as u32));
        for (rank, told) in told.into_iter().enumerate() {
            // What is here need not be passed on.
            match rank == group.rank() {
                true => asked[rank]
                    .iter()
                    .for_each(|&brick| self.copy_brick(brick, &mut samples)),
                false => samples.extend(told),
            }
        }
        let mut number = 0..;
        let slot = |&wanted: &bool| match wanted {
            true => number.next().unwrap_or(NOT_LOCAL),
            false => NOT_LOCAL,
        };
        Ok(self.with_bricks(wanted.iter().map(slot).collect(), samples))
    }

    fn with_bricks(&self, slots: Vec<u32>, samples: Vec<f32>) -> Distance<D> {
        Distance::Bricks(DistanceBricks {
            dims: self.dims,
            step: self.step,
            local_indices: slots,
            samples,
            summary: self.summary,
            misses: MissFlag::default(),
        })
    }

    /// The samples of a brick of one's own; beyond the box its outermost ones repeat.
    fn copy_brick(&self, brick: usize, samples: &mut Vec<f32>) {
        let along = bricks_per_axis(self.dims);
        let mut rest = brick;
        let low: [usize; D] = std::array::from_fn(|k| {
            let at = rest % along[k] * BRICK_CELLS;
            rest /= along[k];
            at
        });
        for number in 0..BRICK_SAMPLES.pow(D as u32) {
            let (mut rest, mut at, mut stride) = (number, 0, 1);
            for k in 0..D {
                let mut along = (low[k] + rest % BRICK_SAMPLES).min(self.dims[k] - 1);
                if k == D - 1 {
                    along -= self.first_layer;
                }
                at += along * stride;
                stride *= self.dims[k];
                rest /= BRICK_SAMPLES;
            }
            samples.push(self.samples[at]);
        }
    }
}

impl<const D: usize> DistributedDistance<D> {
    /// The largest d anywhere.
    pub fn max(&self) -> f64 {
        match self {
            Self::Global(distance) => distance.max(),
            Self::Layers(some) => some.summary.max,
        }
    }

    /// What all of the group know of it: how large it is, and how many atoms it asks for, but not where.
    pub fn outline(&self) -> Cow<'_, Distance<D>> {
        match self {
            Self::Global(distance) => Cow::Borrowed(distance),
            Self::Layers(some) => {
                let nothing = vec![NOT_LOCAL; bricks_per_axis(some.dims).iter().product()];
                Cow::Owned(some.with_bricks(nothing, Vec::new()))
            }
        }
    }

    /// All of it, on all of the group.
    ///
    /// # Errors
    /// Those of the others.
    pub fn global(&self, group: &dyn Comm) -> Result<Cow<'_, Distance<D>>> {
        match self {
            Self::Global(distance) => Ok(Cow::Borrowed(distance)),
            Self::Layers(some) => some.all_gather(group).map(Cow::Owned),
        }
    }

    /// The same, and nothing else.
    ///
    /// # Errors
    /// Those of the others.
    pub fn into_global(self, group: &dyn Comm) -> Result<Distance<D>> {
        match self {
            Self::Global(distance) => Ok(distance),
            Self::Layers(some) => some.all_gather(group),
        }
    }

    /// d no farther than `reach` from some positions along each axis. Where more is asked for, that is
    /// [noticed](Distance::has_misses).
    ///
    /// # Errors
    /// Those of the others.
    pub fn fetch_near(
        &self,
        positions: &[[f64; D]],
        reach: f64,
        group: &dyn Comm,
    ) -> Result<Cow<'_, Distance<D>>> {
        let some = match self {
            Self::Global(distance) => return Ok(Cow::Borrowed(distance)),
            Self::Layers(some) => some,
        };
        let wanted = morphology::bricks_near(
            positions,
            reach,
            bricks_per_axis(some.dims),
            (BRICK_CELLS, some.step),
        );
        Ok(Cow::Owned(some.fetch_bricks(&wanted, group)?))
    }

    /// d between two heights along an axis, and along the edges of the box.
    ///
    /// # Errors
    /// Those of the others.
    pub fn fetch_between(
        &self,
        axis: usize,
        [low, high]: [f64; 2],
        group: &dyn Comm,
    ) -> Result<Cow<'_, Distance<D>>> {
        let some = match self {
            Self::Global(distance) => return Ok(Cow::Borrowed(distance)),
            Self::Layers(some) => some,
        };
        let along = bricks_per_axis(some.dims);
        let at = |x: f64| ((x / some.step[axis]) as usize / BRICK_CELLS).min(along[axis] - 1);
        let heights = at(low)..at(high) + 1;
        let wanted = |brick: usize| {
            let (mut rest, mut outermost, mut is_between) = (brick, 0, false);
            for (k, &count) in along.iter().enumerate() {
                let at = rest % count;
                rest /= count;
                outermost += usize::from(at == 0 || at + 1 == count);
                is_between |= k == axis && low <= high && heights.contains(&at);
            }
            is_between || outermost + 1 >= D
        };
        let wanted: Vec<bool> = (0..along.iter().product()).map(wanted).collect();
        Ok(Cow::Owned(some.fetch_bricks(&wanted, group)?))
    }
}

impl<const D: usize> DistanceBricks<D> {
    /// The cell round a position, if it is known here.
    #[inline]
    pub(super) fn cell(&self, position: &[f64; D]) -> Option<GridCell<'_, D>> {
        let within = CellPosition::locate(&self.dims, &self.step, position);
        let (mut brick, mut corner, mut strides) = (0, 0, [0; D]);
        for k in (0..D).rev() {
            let cells = self.dims[k].saturating_sub(1).max(1);
            brick = brick * cells.div_ceil(BRICK_CELLS) + within.low[k] / BRICK_CELLS;
            corner = corner * BRICK_SAMPLES + within.low[k] % BRICK_CELLS;
        }
        let slot = self.local_indices[brick];
        if slot == NOT_LOCAL {
            self.misses.set();
            return None;
        }
        let mut stride = 1;
        for (strides, &n) in strides.iter_mut().zip(&self.dims) {
            // Of one sample there is no other corner.
            *strides = if n > 1 { stride } else { 0 };
            stride *= BRICK_SAMPLES;
        }
        Some(GridCell {
            samples: &self.samples[slot as usize * stride..][..stride],
            corner,
            strides,
            position: within,
        })
    }

    /// Whether it was asked for where nothing is known here.
    pub(super) fn has_misses(&self) -> bool {
        self.misses.is_set()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;
    use crate::geometry::random::Random;
    use crate::lattice::distance::{limit_gradient, lower_cell_corners};

    const EXTENT: [f64; 3] = [40.0, 31.0, 120.0];

    fn limits() -> DistanceLimits {
        DistanceLimits {
            min: 2.5,
            max: 9.0,
            growth: 0.1,
        }
    }

    /// Points here and there, with distances.
    fn points() -> Vec<([f32; 3], f32)> {
        let mut random = Random::new(4);
        let point = |_| {
            let x = EXTENT.map(|e| random.range(0.0, e) as f32);
            (x, random.range(2.5, 9.0) as f32)
        };
        (0..60).map(point).collect()
    }

    /// d as one alone has it.
    fn single_process() -> Distance<3> {
        let (dims, step) = coarse_grid(EXTENT, 2.5);
        let mut field = ScalarField::from_fn(dims, step, |_| 9.0);
        for (x, d) in points() {
            lower_cell_corners(&mut field, x.map(f64::from), d);
        }
        limit_gradient(&mut field, 0.1, &CancelToken::never());
        Distance::Field(field)
    }

    /// The share of one of a group.
    fn local_partition(group: &dyn Comm) -> DistributedDistance<3> {
        let (points, patience) = (points(), &CancelToken::never());
        let own = partition_range(points.len(), group.rank(), group.size());
        let own = points[own].iter().copied();
        DistributedDistance::Layers(
            DistanceLayers::from_points(EXTENT, limits(), own, patience, group).unwrap(),
        )
    }

    #[test]
    fn in_layers_it_is_that_of_one_alone() {
        let whole = single_process();
        for count in [1, 2, 3, 7, 16] {
            run_threads(count, |group| {
                let own = local_partition(group);
                let outline = own.outline();
                assert_eq!([outline.min(), own.max()], [whole.min(), whole.max()]);
                assert_eq!(outline.max_slope(), whole.max_slope());
                assert!(*own.global(group).unwrap() == whole, "{count}");
            });
        }
    }

    #[test]
    fn each_has_what_is_near_to_it_and_notices_when_it_asks_for_more() {
        let whole = single_process();
        for count in [2, 5] {
            run_threads(count, |group| {
                let own = local_partition(group);
                let mut random = Random::new(group.rank() as u64);
                let middle = random.range(10.0, 110.0);
                let mut place = |reach: f64| {
                    let z = middle + random.range(-reach, reach);
                    [random.range(-2.0, 42.0), random.range(0.0, 31.0), z]
                };
                let positions: Vec<[f64; 3]> = (0..50).map(|_| place(4.0)).collect();
                let near = own.fetch_near(&positions, 3.0, group).unwrap();
                let layers = own
                    .fetch_between(2, [middle - 9.0, middle + 9.0], group)
                    .unwrap();
                for x in &positions {
                    let x = x.map(|x| x + 2.9);
                    assert_eq!(
                        near.value_and_gradient_at(x),
                        whole.value_and_gradient_at(x)
                    );
                }
                for x in (0..500).map(|_| place(9.0)) {
                    assert_eq!(
                        layers.value_and_gradient_at(x),
                        whole.value_and_gradient_at(x)
                    );
                }
                for x in [[0.0, 31.0, 60.0], [20.0, 0.0, 120.0], [40.0, 15.0, 0.0]] {
                    assert_eq!(layers.value_at(x), whole.value_at(x));
                }
                assert_eq!(
                    near.estimate_atom_count(EXTENT),
                    whole.estimate_atom_count(EXTENT)
                );
                assert!(!near.has_misses() && !layers.has_misses());
                let far = [20.0, 15.0, if middle > 60.0 { 5.0 } else { 115.0 }];
                assert_eq!(layers.value_at(far), whole.max());
                assert!(layers.has_misses() && !near.has_misses());
            });
        }
    }
}
