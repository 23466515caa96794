//! Feature points that are distributed over ranks: each rank holds those of some layers of the
//! image, and receives those near the positions that it works on.

use super::SharedGrid;
use crate::comm::{Comm, concatenate, partition_range};
use crate::error::Result;
use crate::feature::candidate::Candidate;
use crate::feature::volume::Volume;
use crate::feature::windows::layer_len;
use crate::feature::{FeaturePoint, Features};
use crate::geometry::morphology::dilate;
use crate::parallel::prelude::*;
use std::cmp::Ordering;
use std::ops::Range;

/// Edge of the blocks of space that ranks request from each other, in lattice units.
const BLOCK_SIZE: f64 = 16.0;

/// A subset of the feature points, in the order of samples.
#[derive(Debug, Clone, PartialEq)]
pub struct PointSubset<const D: usize> {
    /// The points.
    pub points: Vec<FeaturePoint<D>>,
    /// For each point the number of its surface, and `true` if it lies on a horizon.
    pub marks: Vec<(u32, bool)>,
}

/// Numbers of points of all ranks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PointCounts {
    /// Number of feature points.
    pub points: usize,
    /// Number of feature points on horizons.
    pub on_horizon: usize,
}

/// A point, the number of its surface, and `true` if it lies on a horizon.
type MarkedPoint<const D: usize> = (FeaturePoint<D>, (u32, bool));

impl<const D: usize> Features<D> {
    /// Returns the numbers of points of all ranks.
    pub(crate) fn point_counts(&self) -> PointCounts {
        self.global_counts.unwrap_or_else(|| PointCounts {
            points: self.points.len(),
            on_horizon: self.on_horizon.iter().filter(|on| **on).count(),
        })
    }

    /// Keeps only this rank's share of points that every rank holds.
    pub(crate) fn keep_share(&mut self, comm: &dyn Comm) {
        if self.global_counts.is_some() {
            return;
        }
        self.global_counts = Some(self.point_counts());
        let range = partition_range(self.points.len(), comm.rank(), comm.size());
        keep_range(&mut self.points, range.clone());
        keep_range(&mut self.surface, range.clone());
        keep_range(&mut self.on_horizon, range.clone());
        if let Some(spacing) = &mut self.spacing {
            keep_range(spacing, range);
        }
    }

    /// Gathers the points of all ranks on every rank.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub(crate) fn gather(&mut self, comm: &dyn Comm) -> Result<()> {
        if self.global_counts.take().is_some() {
            let local_points = (0..self.points.len())
                .map(|i| self.marked_point(i))
                .collect();
            let gathered = comm.all_gather("points of features", local_points)?;
            let spacing = self.spacing.take();
            let spacing = spacing.map(|local| comm.all_gather("distances at points", local));
            self.set_from_lists(gathered, spacing.transpose()?);
        }
        Ok(())
    }

    /// Returns the points of all ranks that may be within `reach` of one of `positions`; some
    /// returned points are farther away.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub(crate) fn points_near(
        &self,
        positions: &[[f64; D]],
        reach: f64,
        comm: &dyn Comm,
    ) -> Result<PointSubset<D>> {
        let blocks = BlockGrid::new(self.potential.extent());
        let needed = blocks.within_reach(positions, reach);
        // A rank is queried only for blocks in layers in which it has points.
        let layers = self.points.iter().map(|p| blocks.layer_of(p));
        let bounds = layers.fold([usize::MAX, 0], |[low, high], at| {
            [low.min(at), high.max(at)]
        });
        let ranges: Vec<[usize; 2]> = comm.all_gather("where points of features are", bounds)?;
        let requests = ranges.iter().map(|&[low, high]| -> Vec<u32> {
            let in_range =
                (low..=high.min(blocks.dims[D - 1] - 1)).flat_map(|at| blocks.layer_range(at));
            in_range
                .filter(|&block| needed[block])
                .map(|block| block as u32)
                .collect()
        });
        let request: Vec<Vec<u32>> = comm.all_to_all("blocks of space", requests.collect())?;
        let replies = request.iter().map(|options| -> Vec<MarkedPoint<D>> {
            if options.is_empty() {
                return Vec::new();
            }
            let mut is_requested = vec![false; needed.len()];
            options
                .iter()
                .for_each(|&block| is_requested[block as usize] = true);
            let local_points = self.points.par_iter().enumerate();
            let selected = local_points
                .filter(|(_, p)| is_requested[blocks.block_of(p.position.map(f64::from))]);
            selected.map(|(i, _)| self.marked_point(i)).collect()
        });
        let (points, marks) =
            concatenate(comm.all_to_all("points of features", replies.collect())?)
                .into_iter()
                .unzip();
        Ok(PointSubset { points, marks })
    }

    /// Replaces the points of this rank.
    pub(crate) fn replace_points(&mut self, subset: PointSubset<D>) {
        self.points = subset.points;
        (self.surface, self.on_horizon) = subset.marks.into_iter().unzip();
        self.spacing = None;
    }

    /// Sorts the points by position, last axis first. Points that are distributed over ranks are
    /// redistributed: each rank gets those in its layers.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub(in crate::feature) fn sort_points(&mut self, grid: SharedGrid<'_, D>) -> Result<()> {
        let comm = grid.comm;
        if self.global_counts.is_some() {
            let (layers, step) = (self.potential.dims[D - 1], self.potential.step[D - 1]);
            // Layers at which all ranks but the first begin.
            let ends =
                (1..comm.size()).map(|rank| partition_range(layers, rank, comm.size()).start);
            let ends: Vec<f64> = ends.map(|end| end as f64).collect();
            let rank_of = |i: usize| {
                let at = f64::from(self.points[i].position[D - 1]) / step;
                ends.partition_point(|&end| at >= end)
            };
            let mut targets = vec![Vec::new(); comm.size()];
            (0..self.points.len()).for_each(|i| targets[rank_of(i)].push(i));
            let marked_points =
                |indices: &Vec<usize>| indices.iter().map(|&i| self.marked_point(i)).collect();
            let received = comm.all_to_all(
                "points of features",
                targets.iter().map(marked_points).collect(),
            )?;
            let spacing = self.spacing.take().map(|local| {
                let permuted = targets.iter().map(|to| permute(to, &local));
                comm.all_to_all("distances at points", permuted.collect())
            });
            self.set_from_lists(received, spacing.transpose()?);
        }
        // Of two points at one position the one on a fault comes first, on any number of ranks.
        let last_axis_first = |&i: &usize, &j: &usize| {
            let [p, q] = [i, j].map(|i| self.points[i].position.iter().rev());
            p.zip(q)
                .map(|(a, b)| a.total_cmp(b))
                .find(|order| order.is_ne())
                .unwrap_or(Ordering::Equal)
                .then(self.on_horizon[i].cmp(&self.on_horizon[j]))
        };
        let mut order: Vec<usize> = (0..self.points.len()).collect();
        order.sort_by(last_axis_first);
        self.points = permute(&order, &self.points);
        self.on_horizon = permute(&order, &self.on_horizon);
        self.surface = permute(&order, &self.surface);
        self.spacing = (self.spacing.take()).map(|spacing| permute(&order, &spacing));
        Ok(())
    }

    fn marked_point(&self, i: usize) -> MarkedPoint<D> {
        (self.points[i], (self.surface[i], self.on_horizon[i]))
    }

    fn set_from_lists(&mut self, lists: Vec<Vec<MarkedPoint<D>>>, spacing: Option<Vec<Vec<f32>>>) {
        let (points, marks) = lists.into_iter().flatten().unzip();
        self.replace_points(PointSubset { points, marks });
        self.spacing = spacing.map(|lists| lists.concat());
    }
}

fn keep_range<T>(values: &mut Vec<T>, range: Range<usize>) {
    values.truncate(range.end);
    values.drain(..range.start);
    values.shrink_to_fit();
}

fn permute<T: Copy>(order: &[usize], values: &[T]) -> Vec<T> {
    order.iter().map(|&i| values[i]).collect()
}

/// Feature points of one rank's layers and its halo as candidates, sorted by their samples.
pub struct PointsWithHalo<'g, const D: usize> {
    grid: SharedGrid<'g, D>,
    pub candidates: Vec<Candidate<D>>,
    /// Number of the surface of each point.
    pub surface: Vec<u32>,
    /// For each point, `true` if this rank owns it.
    pub is_owned: Vec<bool>,
    /// Indices of the owned points in their original order.
    owned_indices: Vec<u32>,
    /// For each rank, the points sent to it and received from it that are in layers next to the other rank's.
    sent_indices: Vec<Vec<u32>>,
    received_indices: Vec<Vec<u32>>,
}

impl<'g, const D: usize> PointsWithHalo<'g, D> {
    /// Adds a halo of `reach` layers to the points of a rank. `surface` numbers the surface of each.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn new(
        grid: SharedGrid<'g, D>,
        owned: Vec<Candidate<D>>,
        surface: Option<&[u32]>,
        reach: usize,
    ) -> Result<Self> {
        let SharedGrid { dims, comm } = grid;
        let rank = comm.rank();
        let layers = owned.iter().fold([usize::MAX, 0], |[low, high], c| {
            let at = c.voxel.index() / layer_len(dims);
            [low.min(at), high.max(at)]
        });
        // First and last layer of each rank's points; none if the first is greater than the last.
        let layers: Vec<[usize; 2]> = comm.all_gather("layers of points", layers)?;
        let indices_for = |other: usize| -> Vec<u32> {
            let is_visible = |c: &Candidate<D>| is_near_layers(c, dims, layers[other], reach);
            let numbered = (0..).zip(&owned);
            let visible = numbered.filter(|(_, c)| other != rank && is_visible(c));
            visible.map(|(i, _)| i).collect()
        };
        let sent_indices: Vec<Vec<u32>> = (0..comm.size()).map(indices_for).collect();
        let surface_of = |i: u32| surface.map_or(0, |surface| surface[i as usize]);
        let with_surface = |&i: &u32| (owned[i as usize], surface_of(i));
        let sent = (sent_indices.iter()).map(|indices| indices.iter().map(with_surface).collect());
        let mut received: Vec<Vec<(Candidate<D>, u32)>> =
            comm.all_to_all("points near layers", sent.collect())?;
        let owned = (0..).zip(owned);
        received[rank] = owned.map(|(i, c)| (c, surface_of(i))).collect();
        let mut start = 0;
        let ranges = received.iter().map(|points| {
            start += points.len();
            start - points.len()..start
        });
        let ranges: Vec<Range<usize>> = ranges.collect();
        let points = concatenate(received);
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.sort_by_key(|&i| points[i as usize].0.voxel);
        let mut sorted_index = vec![0; points.len()];
        (0..)
            .zip(&order)
            .for_each(|(sorted, &i)| sorted_index[i as usize] = sorted);
        let owned_indices = sorted_index[ranges[rank].clone()].to_vec();
        let sorted = || order.iter().map(|&i| i as usize);
        let candidates: Vec<Candidate<D>> = sorted().map(|i| points[i].0).collect();
        let adjacent = |indices: &mut dyn Iterator<Item = u32>, layers| -> Vec<u32> {
            let is_adjacent = |&i: &u32| is_near_layers(&candidates[i as usize], dims, layers, 1);
            indices.filter(is_adjacent).collect()
        };
        let sent = sent_indices.iter().zip(&layers).map(|(indices, &layers)| {
            adjacent(
                &mut indices.iter().map(|&i| owned_indices[i as usize]),
                layers,
            )
        });
        let received = ranges.iter().enumerate().map(|(other, range)| {
            let range = if other == rank { 0..0 } else { range.clone() };
            adjacent(&mut sorted_index[range].iter().copied(), layers[rank])
        });
        Ok(Self {
            sent_indices: sent.collect(),
            received_indices: received.collect(),
            surface: sorted().map(|i| points[i].1).collect(),
            is_owned: sorted().map(|i| ranges[rank].contains(&i)).collect(),
            grid,
            owned_indices,
            candidates,
        })
    }

    /// Returns the values of the owned points, in their original order.
    pub fn owned_values(&self, values: &[f32]) -> Vec<f32> {
        values_at(&self.owned_indices, values)
    }

    /// Returns the other ranks' values of the points of the halo next to this rank's layers, with the index of each
    /// point.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn adjacent_values(&self, what: &str, values: &[f32]) -> Result<Vec<(u32, f32)>> {
        let sent = (self.sent_indices.iter()).map(|indices| values_at(indices, values));
        let received: Vec<Vec<f32>> = self.grid.comm.all_to_all(what, sent.collect())?;
        let pairs = self.received_indices.iter().zip(received);
        Ok(pairs
            .flat_map(|(indices, values)| indices.iter().copied().zip(values))
            .collect())
    }
}

/// Returns `true` if a point is in some layers, or within `reach` layers of them.
fn is_near_layers<const D: usize>(
    c: &Candidate<D>,
    dims: [usize; D],
    [first, last]: [usize; 2],
    reach: usize,
) -> bool {
    let at = c.voxel.index() / layer_len(dims);
    first <= last && first <= at + reach && at <= last + reach
}

fn values_at(indices: &[u32], values: &[f32]) -> Vec<f32> {
    indices.iter().map(|&i| values[i as usize]).collect()
}

/// Blocks of space that cover the box.
struct BlockGrid<const D: usize> {
    dims: [usize; D],
}

impl<const D: usize> BlockGrid<D> {
    fn new(extent: [f64; D]) -> Self {
        Self {
            dims: extent.map(|e| (e / BLOCK_SIZE) as usize + 1),
        }
    }

    fn axis_index(&self, k: usize, x: f64) -> usize {
        ((x / BLOCK_SIZE) as usize).min(self.dims[k] - 1)
    }

    /// Returns the block that contains a position.
    fn block_of(&self, x: [f64; D]) -> usize {
        let blocks = Volume::new(self.dims, &[]);
        blocks.index(std::array::from_fn(|k| self.axis_index(k, x[k])))
    }

    /// Returns the layer of blocks that contains a point.
    fn layer_of(&self, point: &FeaturePoint<D>) -> usize {
        self.axis_index(D - 1, point.position[D - 1].into())
    }

    fn layer_range(&self, at: usize) -> Range<usize> {
        at * layer_len(self.dims)..(at + 1) * layer_len(self.dims)
    }

    /// Returns for each block `true` if it may be within `reach` of one of the positions.
    fn within_reach(&self, positions: &[[f64; D]], reach: f64) -> Vec<bool> {
        let mut marks = vec![false; self.dims.iter().product()];
        for &x in positions {
            marks[self.block_of(x)] = true;
        }
        for axis in 0..D {
            dilate(
                &mut marks,
                self.dims,
                axis,
                (reach / BLOCK_SIZE).ceil() as usize,
            );
        }
        marks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;
    use crate::feature::DetectionOptions;
    use crate::geometry::random::Random;
    use crate::image::SparseField;

    const DIMS: [usize; 3] = [60, 40, 90];

    /// Returns features at pseudo-random positions, a tenth of them at one place, in the order of
    /// their layers.
    fn random_features(count: usize) -> Features<3> {
        let mut random = Random::new(8);
        let mut marked: Vec<MarkedPoint<3>> = (0..count)
            .map(|i| {
                let random_position = DIMS.map(|n| random.range(0.0, (n - 1) as f64) as f32);
                let position = match i % 10 {
                    0 => [30.0, 20.0, 30.5],
                    _ => random_position,
                };
                let point = FeaturePoint {
                    position,
                    normal: [1.0, 0.0, 0.0],
                    strength: i as f32,
                };
                (point, (1 + (i % 7) as u32, i % 3 == 0))
            })
            .collect();
        marked.sort_by_key(|(point, _)| point.position[2].round() as i32);
        let mut features = Features {
            potential: SparseField::zero(DIMS, [1.0; 3]),
            ..Features::empty(DIMS, &DetectionOptions::default())
        };
        features.set_from_lists(vec![marked], None);
        features
    }

    fn marked_points(features: &Features<3>) -> Vec<MarkedPoint<3>> {
        (0..features.points.len())
            .map(|i| features.marked_point(i))
            .collect()
    }

    #[test]
    fn shares_cover_all_points_and_gather_restores_them() {
        for points in [0, 2, 500] {
            let all = random_features(points);
            for count in [1, 3, 5] {
                let parts = run_threads(count, |comm| {
                    let mut local = all.clone();
                    local.keep_share(comm);
                    local.keep_share(comm);
                    assert_eq!(local.point_counts(), all.point_counts());
                    let part = marked_points(&local);
                    local.gather(comm).unwrap();
                    assert!(
                        marked_points(&local) == marked_points(&all)
                            && local.global_counts.is_none()
                    );
                    part
                });
                assert!(parts.concat() == marked_points(&all));
            }
        }
    }

    #[test]
    fn points_near_returns_the_points_near_the_positions() {
        let all = random_features(2000);
        let mut random = Random::new(5);
        for (count, reach) in [(1, 3.0), (2, 0.0), (5, 20.0)] {
            let positions: Vec<Vec<[f64; 3]>> = (0..count)
                .map(|rank| match rank {
                    // One rank has no positions.
                    1 => Vec::new(),
                    _ => (0..3)
                        .map(|_| DIMS.map(|n| random.range(0.0, (n - 1) as f64)))
                        .collect(),
                })
                .collect();
            run_threads(count, |comm| {
                let mut local = all.clone();
                local.keep_share(comm);
                let positions = &positions[comm.rank()];
                let subset = local.points_near(positions, reach, comm).unwrap();
                let received: Vec<MarkedPoint<3>> =
                    subset.points.into_iter().zip(subset.marks).collect();
                let within = |radius: f64| {
                    marked_points(&all).into_iter().filter(move |(point, _)| {
                        let at = point.position.map(f64::from);
                        let is_near = |x: &[f64; 3]| (0..3).all(|k| (x[k] - at[k]).abs() <= radius);
                        positions.iter().any(is_near)
                    })
                };
                // All points within reach are received, none that is far away, and their order is
                // kept.
                assert!(within(reach).all(|point| received.contains(&point)));
                let nearby: Vec<_> = within(reach + 2.0 * BLOCK_SIZE).collect();
                let mut order = nearby.iter();
                assert!(
                    received
                        .iter()
                        .all(|point| order.any(|other| other == point))
                );
                assert!(count > 2 || comm.rank() == 1 || received.len() < 2000);
            });
        }
    }

    #[test]
    fn sorting_shares_matches_sorting_on_one_rank() {
        let all = random_features(700);
        let mut sorted = all.clone();
        let grid = SharedGrid::of_one_process(DIMS);
        sorted.sort_points(grid).unwrap();
        assert!(marked_points(&sorted) != marked_points(&all));
        for count in [2, 3, 7] {
            let parts = run_threads(count, |comm| {
                let mut local = all.clone();
                local.keep_share(comm);
                local.sort_points(SharedGrid::new(DIMS, comm)).unwrap();
                marked_points(&local)
            });
            assert!(parts.iter().filter(|part| !part.is_empty()).count() > 1);
            assert!(parts.concat() == marked_points(&sorted));
        }
    }
}
