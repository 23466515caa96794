//! Nominal distance d(x) that is distributed over ranks: each rank owns some layers of samples, and
//! fetches the parts of d near the atoms that it works on.
//!
//! Parts are fetched in bricks. A brick contains all samples of its cells, so that interpolation
//! needs one brick only and is equal to the last bit to that of the complete field.

use std::borrow::Cow;
use std::ops::Range;

use super::features::{self, DistanceLimits, coarse_grid, for_each_corner};
use super::grading::{FastSweeping, row_count};
use super::{CellPosition, Distance, GridCell, density_sum, max_slopes};
use crate::comm::{Comm, partition_range};
use crate::error::Result;
use crate::feature::Features;
use crate::geometry::NONE;
use crate::geometry::grid_index::{index_at, offset_of};
use crate::geometry::{morphology, norm};
use crate::image::ScalarField;
use crate::image::bricks::{BRICK_CELLS, MissFlag, brick_counts};
use crate::progress::CancelToken;

/// Samples along an edge of a brick.
const BRICK_SAMPLES: usize = BRICK_CELLS + 1;

/// The nominal distance between atoms, local or distributed over ranks.
#[derive(Debug, Clone, PartialEq)]
pub enum DistributedDistance<const D: usize> {
    /// Each rank has all of it.
    Global(Distance<D>),
    /// Each rank has some layers.
    Layers(DistanceLayers<D>),
}

/// Samples of d in some layers along the last axis.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceLayers<const D: usize> {
    /// Samples of the global grid along each axis.
    dims: [usize; D],
    step: [f64; D],
    /// Index of the first layer in `samples`. The layers adjacent to the owned ones are included.
    first_layer: usize,
    samples: Vec<f32>,
    summary: DistanceSummary,
}

/// Properties of d that all ranks know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DistanceSummary {
    pub min: f64,
    pub max: f64,
    /// The mean of d^-D.
    pub mean_density: f64,
    /// A bound on |grad d|.
    pub max_slope: f64,
}

/// Some bricks of samples of d; the others are on other ranks.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceBricks<const D: usize> {
    dims: [usize; D],
    step: [f64; D],
    /// For each brick, x fastest, its index among the local bricks, or [`NONE`].
    local_indices: Vec<u32>,
    samples: Vec<f32>,
    pub(super) summary: DistanceSummary,
    misses: MissFlag,
}

/// Summarises d in a grid of dimensions `dims`. `field` has the local layers; this rank owns the ones
/// in `owned`.
fn summarise<const D: usize>(
    field: &ScalarField<D>,
    dims: [usize; D],
    owned: Range<usize>,
    limits: DistanceLimits,
    comm: &dyn Comm,
) -> Result<DistanceSummary> {
    let layer_len: usize = field.dims[..D - 1].iter().product();
    let owned_samples = field.samples[owned.start * layer_len..owned.end * layer_len]
        .chunks_exact(layer_len.max(1));
    let samples = owned_samples.clone().flatten();
    let min = samples.clone().fold(f32::INFINITY, |a, &b| a.min(b));
    let max = samples.fold(0.0f32, |a, &b| a.max(b));
    let density_sums: Vec<f64> = owned_samples.map(density_sum::<D>).collect();
    let slopes = if field.samples.is_empty() {
        [0.0; D]
    } else {
        max_slopes(field)
    };
    type LayerMessage<const D: usize> = ([f64; 2], ([f64; D], Vec<f64>));
    let summary = ([min.into(), max.into()], (slopes, density_sums));
    let summaries: Vec<LayerMessage<D>> = comm.all_gather("distances", summary)?;
    let reduce = |k: usize, combine: fn(f64, f64) -> f64| {
        summaries.iter().map(|(d, _)| d[k]).reduce(combine)
    };
    let steepest = |k: usize| {
        summaries
            .iter()
            .fold(0.0, |a: f64, (_, (slopes, _))| a.max(slopes[k]))
    };
    let density: f64 = summaries.iter().flat_map(|(_, (_, sums))| sums).sum();
    Ok(DistanceSummary {
        min: reduce(0, f64::min).unwrap_or(limits.min),
        max: reduce(1, f64::max).unwrap_or(limits.max),
        mean_density: density / dims.iter().product::<usize>() as f64,
        max_slope: norm::<f64, D>(std::array::from_fn(steepest)),
    })
}

/// Limits the slope of a field as [`limit_gradient`](super::limit_gradient) does, where the field is distributed over
/// ranks. Rank r owns the layers `rank_layers[r]` along the last axis. `field` holds the layers
/// from `first` on: the owned ones and the adjacent layers of other ranks.
///
/// # Errors
/// Returns an error if another rank fails.
fn limit_gradient_in_layers<const D: usize>(
    field: &mut ScalarField<D>,
    first: usize,
    rank_layers: &[Range<usize>],
    growth: f64,
    cancel: &CancelToken<'_>,
    comm: &dyn Comm,
) -> Result<()> {
    let all_rows = row_count(field);
    let (rank, layer_len) = (comm.rank(), field.dims[..D - 1].iter().product::<usize>());
    let rows_per_layer = layer_len / field.dims[0].max(1);
    let owned = rank_layers[rank].clone();
    let mutable_rows = if owned.is_empty() {
        0..0
    } else {
        (owned.start - first) * rows_per_layer..((owned.end - first) * rows_per_layer).min(all_rows)
    };
    let mut sweeps = FastSweeping::new(field, mutable_rows, growth);
    // The layers before and after the owned layers of a rank.
    let ghost_layers = |rank: usize| {
        if rank_layers[rank].is_empty() {
            [None; 2]
        } else {
            [
                rank_layers[rank].start.checked_sub(1),
                Some(rank_layers[rank].end),
            ]
        }
    };
    let mut is_first_round = true;
    loop {
        let changed = sweeps.sweep_until_stable(cancel) || std::mem::take(&mut is_first_round);
        let sent = (0..rank_layers.len()).map(|other_rank| -> Vec<(usize, Vec<f32>)> {
            let layers = ghost_layers(other_rank).into_iter().flatten();
            let layers =
                layers.filter(|index| changed && other_rank != rank && owned.contains(index));
            let layer =
                |index| sweeps.field.samples[(index - first) * layer_len..][..layer_len].to_vec();
            layers.map(|index| (index, layer(index))).collect()
        });
        let received: Vec<Vec<(usize, Vec<f32>)>> =
            comm.all_to_all("layers of distances", sent.collect())?;
        let mut has_lowered = false;
        for (index, layer) in received.into_iter().flatten() {
            has_lowered |= sweeps.lower_layer(index - first, &layer);
        }
        let states: Vec<(bool, bool)> =
            comm.all_gather("distances", (has_lowered, cancel.is_cancelled()))?;
        if !states.iter().any(|(lower, _)| *lower) || states.iter().any(|(_, over)| *over) {
            return Ok(());
        }
    }
}

/// Returns the layers of bricks that one of `count` ranks owns, and its layers of samples.
fn owned_layers<const D: usize>(
    dims: [usize; D],
    rank: usize,
    count: usize,
) -> (Range<usize>, Range<usize>) {
    let brick_layers = brick_counts(dims)[D - 1];
    let bricks = partition_range(brick_layers, rank, count);
    let layers = if bricks.is_empty() {
        0..0
    } else if bricks.end == brick_layers {
        bricks.start * BRICK_CELLS..dims[D - 1]
    } else {
        bricks.start * BRICK_CELLS..bricks.end * BRICK_CELLS
    };
    (bricks, layers)
}

impl<const D: usize> DistanceLayers<D> {
    /// Computes d from its values at points, which are distributed over the ranks. d grows away
    /// from the points.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    fn from_points(
        extent: [f64; D],
        limits: DistanceLimits,
        points: impl Iterator<Item = ([f32; D], f32)>,
        cancel: &CancelToken<'_>,
        comm: &dyn Comm,
    ) -> Result<Self> {
        let (rank, rank_count) = (comm.rank(), comm.size());
        let (dims, step) = coarse_grid(extent, limits.min);
        let layers: Vec<Range<usize>> = (0..rank_count)
            .map(|rank| owned_layers(dims, rank, rank_count).1)
            .collect();
        let owned = layers[rank].clone();
        let first = owned.start.saturating_sub(1);
        let end = if owned.is_empty() {
            first
        } else {
            (owned.end + 1).min(dims[D - 1])
        };
        let layer_len: usize = dims[..D - 1].iter().product();
        let mut local_dims = dims;
        local_dims[D - 1] = end - first;
        let mut field = ScalarField {
            dims: local_dims,
            step,
            samples: vec![limits.max as f32; layer_len * (end - first)],
        };
        // Each corner of the cell around a point belongs to the rank that owns its layer.
        let mut sent: Vec<Vec<([f32; D], f32)>> = vec![Vec::new(); rank_count];
        let mut add_point = |(x, d): ([f32; D], f32), mut outgoing: Option<&mut Vec<Vec<_>>>| {
            for_each_corner(x.map(f64::from), dims, step, |mut corner| {
                if owned.contains(&corner[D - 1]) {
                    corner[D - 1] -= first;
                    let sample = &mut field.samples[offset_of(local_dims, corner)];
                    *sample = sample.min(d);
                } else if let Some(lists) = &mut outgoing {
                    let owner = layers
                        .iter()
                        .position(|layers| layers.contains(&corner[D - 1]));
                    let list: &mut Vec<_> = &mut lists[owner.unwrap_or(rank)];
                    if list.last() != Some(&(x, d)) {
                        list.push((x, d));
                    }
                }
            });
        };
        points.for_each(|point| add_point(point, Some(&mut sent)));
        let received: Vec<Vec<([f32; D], f32)>> = comm.all_to_all("distances at points", sent)?;
        received
            .into_iter()
            .flatten()
            .for_each(|point| add_point(point, None));
        limit_gradient_in_layers(&mut field, first, &layers, limits.growth, cancel, comm)?;

        let summary = summarise(
            &field,
            dims,
            owned.start - first..owned.end - first,
            limits,
            comm,
        )?;
        Ok(Self {
            dims,
            step,
            first_layer: first,
            samples: field.samples,
            summary,
        })
    }

    /// Returns the complete field, gathered from the owned layers of all ranks.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    fn all_gather(&self, comm: &dyn Comm) -> Result<Distance<D>> {
        let layer_len: usize = self.dims[..D - 1].iter().product();
        let (_, owned) = owned_layers(self.dims, comm.rank(), comm.size());
        let start = owned.start.saturating_sub(self.first_layer) * layer_len;
        let samples = self.samples[start..start + owned.len() * layer_len].to_vec();
        Ok(Distance::Field(ScalarField {
            dims: self.dims,
            step: self.step,
            samples: comm.all_gather("samples of distances", samples)?.concat(),
        }))
    }

    /// Returns d in the bricks that are marked in `is_requested`, whichever rank owns them.
    fn fetch_bricks(&self, is_requested: &[bool], comm: &dyn Comm) -> Result<Distance<D>> {
        let brick_dims = brick_counts(self.dims);
        let bricks_per_layer = is_requested.len() / brick_dims[D - 1];
        let requested_of = |rank: usize| -> Vec<usize> {
            let (owned, _) = owned_layers(self.dims, rank, comm.size());
            let bricks = owned.start * bricks_per_layer..owned.end * bricks_per_layer;
            bricks.filter(|&brick| is_requested[brick]).collect()
        };
        let select = |bricks: &Vec<usize>| -> Vec<f32> {
            let mut samples = Vec::with_capacity(bricks.len() * BRICK_SAMPLES.pow(D as u32));
            (bricks.iter()).for_each(|&brick| self.copy_brick(brick, &mut samples));
            samples
        };
        let requested = (0..comm.size()).map(requested_of).collect();
        let places = ["requested bricks of distances", "bricks of distances"];
        let (own, mut received) = comm.fetch(places, requested, select)?;
        received[comm.rank()] = select(&own);
        let samples = received.concat();
        let mut next_index = 0..;
        let slot = |&is_requested: &bool| {
            if is_requested {
                next_index.next().unwrap_or(NONE)
            } else {
                NONE
            }
        };
        Ok(self.with_bricks(is_requested.iter().map(slot).collect(), samples))
    }

    fn with_bricks(&self, local_indices: Vec<u32>, samples: Vec<f32>) -> Distance<D> {
        Distance::Bricks(DistanceBricks {
            dims: self.dims,
            step: self.step,
            local_indices,
            samples,
            summary: self.summary,
            misses: MissFlag::default(),
        })
    }

    /// Appends the samples of an owned brick. Beyond the box the outermost samples are repeated.
    fn copy_brick(&self, brick: usize, samples: &mut Vec<f32>) {
        let low = index_at(brick_counts(self.dims), brick).map(|i| i * BRICK_CELLS);
        for number in 0..BRICK_SAMPLES.pow(D as u32) {
            let in_brick = index_at([BRICK_SAMPLES; D], number);
            let mut index: [usize; D] =
                std::array::from_fn(|k| (low[k] + in_brick[k]).min(self.dims[k] - 1));
            index[D - 1] -= self.first_layer;
            samples.push(self.samples[offset_of(self.dims, index)]);
        }
    }
}

impl<const D: usize> DistributedDistance<D> {
    /// Computes d(x) as [`from_features`](super::from_features) does. If the points are distributed over ranks, so
    /// is d.
    ///
    /// # Errors
    /// Returns an error as [`from_features`](super::from_features) does, or if another rank fails.
    pub fn from_features(
        features: &Features<D>,
        limits: DistanceLimits,
        cancel: &CancelToken<'_>,
        comm: &dyn Comm,
    ) -> Result<Self> {
        Self::from_points(features, limits, |_| limits.min as f32, cancel, comm)
    }

    /// Returns d(x) that follows the gaps between features: d is [`Features::spacing`] at every feature
    /// point, clipped to `min` to `max`, and grows away from where it is small by `growth` per lattice
    /// unit. If the points are distributed over ranks, so is d.
    ///
    /// # Errors
    /// Returns an error as [`from_features`](super::from_features) does, or if another rank fails.
    pub fn from_gaps(
        features: &Features<D>,
        limits: DistanceLimits,
        cancel: &CancelToken<'_>,
        comm: &dyn Comm,
    ) -> Result<Self> {
        let [min, max] = [limits.min, limits.max].map(|d| d as f32);
        let spacing = features.spacing.as_deref().unwrap_or(&[]);
        let spacing_at = |i: usize| spacing.get(i).map_or(max, |d| d.clamp(min, max));
        let mut has_fine_points = (0..features.points.len()).any(|i| spacing_at(i) < max);
        if features.global_counts.is_some() {
            has_fine_points = comm
                .all_gather("fine points", has_fine_points)?
                .contains(&true);
        }
        // If no gap needs a smaller distance, d is constant.
        if !has_fine_points {
            limits.check()?;
            return Ok(Self::Global(Distance::Constant(limits.max)));
        }
        Self::from_points(features, limits, spacing_at, cancel, comm)
    }

    /// Returns d(x) from the value of d at each feature point.
    fn from_points(
        features: &Features<D>,
        limits: DistanceLimits,
        d_at_point: impl Fn(usize) -> f32,
        cancel: &CancelToken<'_>,
        comm: &dyn Comm,
    ) -> Result<Self> {
        limits.check()?;
        if features.global_counts.is_none() {
            let distance = features::from_points(features, limits, d_at_point, cancel);
            return Ok(Self::Global(distance));
        }
        let points = features.points.iter().enumerate();
        let points = points.map(|(i, point)| (point.position, d_at_point(i)));
        let extent = features.potential.extent();
        DistanceLayers::from_points(extent, limits, points, cancel, comm).map(Self::Layers)
    }

    /// Returns the largest d anywhere.
    pub fn max(&self) -> f64 {
        match self {
            Self::Global(distance) => distance.max(),
            Self::Layers(layers) => layers.summary.max,
        }
    }

    /// Returns d with its global properties (limits, slope, count of atoms). If d is distributed,
    /// the result has no values at positions.
    pub fn outline(&self) -> Cow<'_, Distance<D>> {
        match self {
            Self::Global(distance) => Cow::Borrowed(distance),
            Self::Layers(layers) => {
                let local_indices = vec![NONE; brick_counts(layers.dims).iter().product()];
                Cow::Owned(layers.with_bricks(local_indices, Vec::new()))
            }
        }
    }

    /// Returns the complete d, on every rank.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn global(&self, comm: &dyn Comm) -> Result<Cow<'_, Distance<D>>> {
        match self {
            Self::Global(distance) => Ok(Cow::Borrowed(distance)),
            Self::Layers(layers) => layers.all_gather(comm).map(Cow::Owned),
        }
    }

    /// Returns the complete d, on every rank, and consumes this value.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn into_global(self, comm: &dyn Comm) -> Result<Distance<D>> {
        match self {
            Self::Global(distance) => Ok(distance),
            Self::Layers(layers) => layers.all_gather(comm),
        }
    }

    /// Returns d within `radius` of some positions along each axis. A request for d elsewhere is
    /// recorded as a [miss](Distance::has_misses).
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn fetch_near(
        &self,
        positions: &[[f64; D]],
        radius: f64,
        comm: &dyn Comm,
    ) -> Result<Cow<'_, Distance<D>>> {
        let layers = match self {
            Self::Global(distance) => return Ok(Cow::Borrowed(distance)),
            Self::Layers(layers) => layers,
        };
        let is_requested = morphology::bricks_near(
            positions,
            radius,
            brick_counts(layers.dims),
            BRICK_CELLS,
            layers.step,
        );
        Ok(Cow::Owned(layers.fetch_bricks(&is_requested, comm)?))
    }

    /// Returns d between the coordinates `low` and `high` along an axis, and along the edges of the
    /// box.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn fetch_between(
        &self,
        axis: usize,
        [low, high]: [f64; 2],
        comm: &dyn Comm,
    ) -> Result<Cow<'_, Distance<D>>> {
        let layers = match self {
            Self::Global(distance) => return Ok(Cow::Borrowed(distance)),
            Self::Layers(layers) => layers,
        };
        let brick_dims = brick_counts(layers.dims);
        let brick_at =
            |x: f64| ((x / layers.step[axis]) as usize / BRICK_CELLS).min(brick_dims[axis] - 1);
        let brick_range = brick_at(low)..brick_at(high) + 1;
        let is_requested = |brick: usize| {
            let index = index_at(brick_dims, brick);
            let is_outermost = |k: &usize| index[*k] == 0 || index[*k] + 1 == brick_dims[*k];
            low <= high && brick_range.contains(&index[axis])
                || (0..D).filter(is_outermost).count() + 1 >= D
        };
        let is_requested: Vec<bool> = (0..brick_dims.iter().product()).map(is_requested).collect();
        Ok(Cow::Owned(layers.fetch_bricks(&is_requested, comm)?))
    }
}

impl<const D: usize> DistanceBricks<D> {
    /// Returns the cell around a position, or `None` if it is not local.
    #[inline]
    pub(super) fn cell(&self, position: &[f64; D]) -> Option<GridCell<'_, D>> {
        let position_in_cell = CellPosition::locate(&self.dims, &self.step, position);
        let (mut brick, mut corner, mut strides) = (0, 0, [0; D]);
        for k in (0..D).rev() {
            let cells = self.dims[k].saturating_sub(1).max(1);
            brick = brick * cells.div_ceil(BRICK_CELLS) + position_in_cell.low[k] / BRICK_CELLS;
            corner = corner * BRICK_SAMPLES + position_in_cell.low[k] % BRICK_CELLS;
        }
        let local_index = self.local_indices[brick];
        if local_index == NONE {
            self.misses.set();
            return None;
        }
        let mut stride = 1;
        for (strides, &n) in strides.iter_mut().zip(&self.dims) {
            // Along an axis of one sample there is no other corner.
            *strides = if n > 1 { stride } else { 0 };
            stride *= BRICK_SAMPLES;
        }
        Some(GridCell {
            samples: &self.samples[local_index as usize * stride..][..stride],
            corner,
            strides,
            position: position_in_cell,
        })
    }

    /// Returns `true` if d was requested at a position that is not local.
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

    /// Random points with random distances.
    fn points() -> Vec<([f32; 3], f32)> {
        let mut random = Random::new(4);
        let point = |_| {
            let x = EXTENT.map(|e| random.range(0.0, e) as f32);
            (x, random.range(2.5, 9.0) as f32)
        };
        (0..60).map(point).collect()
    }

    /// Returns d as a single process computes it.
    fn single_process() -> Distance<3> {
        let (dims, step) = coarse_grid(EXTENT, 2.5);
        let mut field = ScalarField::from_fn(dims, step, |_| 9.0);
        for (x, d) in points() {
            lower_cell_corners(&mut field, x.map(f64::from), d);
        }
        limit_gradient(&mut field, 0.1, &CancelToken::never());
        Distance::Field(field)
    }

    /// Returns the layers of one rank.
    fn local_partition(comm: &dyn Comm) -> DistributedDistance<3> {
        let (points, cancel) = (points(), &CancelToken::never());
        let range = partition_range(points.len(), comm.rank(), comm.size());
        let owned_points = points[range].iter().copied();
        DistributedDistance::Layers(
            DistanceLayers::from_points(EXTENT, limits(), owned_points, cancel, comm).unwrap(),
        )
    }

    #[test]
    fn layers_equal_the_single_process_field() {
        let expected = single_process();
        for count in [1, 2, 3, 7, 16] {
            run_threads(count, |comm| {
                let local = local_partition(comm);
                let outline = local.outline();
                assert_eq!(
                    [outline.min(), local.max()],
                    [expected.min(), expected.max()]
                );
                assert_eq!(outline.max_slope(), expected.max_slope());
                assert!(*local.global(comm).unwrap() == expected, "{count}");
            });
        }
    }

    #[test]
    fn fetched_bricks_cover_the_request_and_report_misses() {
        let expected = single_process();
        for count in [2, 5] {
            run_threads(count, |comm| {
                let local = local_partition(comm);
                let mut random = Random::new(comm.rank() as u64);
                let middle = random.range(10.0, 110.0);
                let mut random_position = |half_width: f64| {
                    let z = middle + random.range(-half_width, half_width);
                    [random.range(-2.0, 42.0), random.range(0.0, 31.0), z]
                };
                let positions: Vec<[f64; 3]> = (0..50).map(|_| random_position(4.0)).collect();
                let nearby = local.fetch_near(&positions, 3.0, comm).unwrap();
                let layers = local
                    .fetch_between(2, [middle - 9.0, middle + 9.0], comm)
                    .unwrap();
                for x in &positions {
                    let x = x.map(|x| x + 2.9);
                    assert_eq!(
                        nearby.value_and_gradient_at(x),
                        expected.value_and_gradient_at(x)
                    );
                }
                for x in (0..500).map(|_| random_position(9.0)) {
                    assert_eq!(
                        layers.value_and_gradient_at(x),
                        expected.value_and_gradient_at(x)
                    );
                }
                for x in [[0.0, 31.0, 60.0], [20.0, 0.0, 120.0], [40.0, 15.0, 0.0]] {
                    assert_eq!(layers.value_at(x), expected.value_at(x));
                }
                assert_eq!(
                    nearby.estimate_atom_count(EXTENT),
                    expected.estimate_atom_count(EXTENT)
                );
                assert!(!nearby.has_misses() && !layers.has_misses());
                let missing = [20.0, 15.0, if middle > 60.0 { 5.0 } else { 115.0 }];
                assert_eq!(layers.value_at(missing), expected.max());
                assert!(layers.has_misses() && !nearby.has_misses());
            });
        }
    }
}
