//! Points of features where ranks share them: each has those of some layers of the image, and is told of those that are
//! near to what it works on.

use super::volume::Volume;
use super::windows::layer_len;
use super::{FeaturePoint, Features};
use crate::comm::{Comm, concatenate, partition_range};
use crate::error::Result;
use crate::geometry::morphology::dilate;
use crate::parallel::prelude::*;
use std::cmp::Ordering;
use std::ops::Range;

/// Edge of the blocks of space of which ranks ask one another, in lattice units.
const BLOCK_SIZE: f64 = 16.0;

/// Some points of features, in the order of samples.
#[derive(Debug, Clone, PartialEq)]
pub struct PointSubset<const D: usize> {
    /// Where they are.
    pub points: Vec<FeaturePoint<D>>,
    /// For each of them the number of its sheet, and whether it lies on a horizon.
    pub marks: Vec<(u32, bool)>,
}

/// How many points all ranks have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PointCounts {
    /// Points of features ...
    pub points: usize,
    /// ... and those of them that lie on horizons.
    pub on_horizon: usize,
}

/// A point, the number of its sheet, and whether it lies on a horizon.
type MarkedPoint<const D: usize> = (FeaturePoint<D>, (u32, bool));

impl<const D: usize> Features<D> {
    /// How many points there are, of all ranks.
    pub(crate) fn point_counts(&self) -> PointCounts {
        self.global_counts.unwrap_or_else(|| PointCounts {
            points: self.points.len(),
            on_horizon: self.on_horizon.iter().filter(|on| **on).count(),
        })
    }

    /// Keeps this rank's share of the points that all have.
    pub(crate) fn keep_share(&mut self, group: &dyn Comm) {
        if self.global_counts.is_some() {
            return;
        }
        self.global_counts = Some(self.point_counts());
        let own = partition_range(self.points.len(), group.rank(), group.size());
        keep_range(&mut self.points, own.clone());
        keep_range(&mut self.surface, own.clone());
        keep_range(&mut self.on_horizon, own.clone());
        if let Some(spacing) = &mut self.spacing {
            keep_range(spacing, own);
        }
    }

    /// Has the points of all ranks.
    ///
    /// # Errors
    /// Those of the others.
    pub(crate) fn gather(&mut self, group: &dyn Comm) -> Result<()> {
        if self.global_counts.take().is_some() {
            let own = (0..self.points.len())
                .map(|i| self.marked_point(i))
                .collect();
            let told = group.all_gather("points of features", own)?;
            let spacing = self.spacing.take();
            let spacing = spacing.map(|own| group.all_gather("distances at points", own));
            self.set_from_lists(told, spacing.transpose()?);
        }
        Ok(())
    }

    /// Of the points of all ranks, those that may be no farther than `reach` from some positions.
    ///
    /// # Errors
    /// Those of the others.
    pub(crate) fn points_near(
        &self,
        positions: &[[f64; D]],
        reach: f64,
        group: &dyn Comm,
    ) -> Result<PointSubset<D>> {
        let blocks = BlockGrid::new(self.potential.extent());
        let wanted = blocks.within_reach(positions, reach);
        // A rank is asked for what it may have.
        let own = self.points.iter().map(|p| blocks.layer_of(p));
        let own = own.fold([usize::MAX, 0], |[low, high], at| {
            [low.min(at), high.max(at)]
        });
        let have: Vec<[usize; 2]> = group.all_gather("where points of features are", own)?;
        let asked = have.iter().map(|&[low, high]| -> Vec<u32> {
            let some =
                (low..=high.min(blocks.dims[D - 1] - 1)).flat_map(|at| blocks.layer_range(at));
            some.filter(|&block| wanted[block])
                .map(|block| block as u32)
                .collect()
        });
        let asked: Vec<Vec<u32>> = group.all_to_all("blocks of space", asked.collect())?;
        let told = asked.iter().map(|asked| -> Vec<MarkedPoint<D>> {
            if asked.is_empty() {
                return Vec::new();
            }
            let mut among = vec![false; wanted.len()];
            asked.iter().for_each(|&block| among[block as usize] = true);
            let own = self.points.par_iter().enumerate();
            let of_those = own.filter(|(_, p)| among[blocks.block_of(p.position.map(f64::from))]);
            of_those.map(|(i, _)| self.marked_point(i)).collect()
        });
        let (points, marks) = concatenate(group.all_to_all("points of features", told.collect())?)
            .into_iter()
            .unzip();
        Ok(PointSubset { points, marks })
    }

    /// Has these points instead of those of its share.
    pub(crate) fn replace_points(&mut self, near: PointSubset<D>) {
        self.points = near.points;
        (self.surface, self.on_horizon) = near.marks.into_iter().unzip();
        self.spacing = None;
    }

    /// Sorts points by where they are, last axis first; of shares, each rank has those that are in its layers then.
    ///
    /// # Errors
    /// Those of the others.
    pub(super) fn sort_points(&mut self, group: &dyn Comm) -> Result<()> {
        if self.global_counts.is_some() {
            let (layers, step) = (self.potential.dims[D - 1], self.potential.step[D - 1]);
            // Where the layers of all but the last rank end.
            let ends =
                (1..group.size()).map(|rank| partition_range(layers, rank, group.size()).start);
            let ends: Vec<f64> = ends.map(|end| end as f64).collect();
            let rank_of = |i: usize| {
                let at = f64::from(self.points[i].position[D - 1]) / step;
                ends.partition_point(|&end| at >= end)
            };
            let mut to = vec![Vec::new(); group.size()];
            (0..self.points.len()).for_each(|i| to[rank_of(i)].push(i));
            let whole = |to: &Vec<usize>| to.iter().map(|&i| self.marked_point(i)).collect();
            let told = group.all_to_all("points of features", to.iter().map(whole).collect())?;
            let spacing = self.spacing.take().map(|own| {
                let to = to.iter().map(|to| permute(to, &own));
                group.all_to_all("distances at points", to.collect())
            });
            self.set_from_lists(told, spacing.transpose()?);
        }
        // Of two at one place the one on a fault is first, as where they come from one rank.
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

fn keep_range<T>(values: &mut Vec<T>, own: Range<usize>) {
    values.truncate(own.end);
    values.drain(..own.start);
    values.shrink_to_fit();
}

fn permute<T: Copy>(order: &[usize], values: &[T]) -> Vec<T> {
    order.iter().map(|&i| values[i]).collect()
}

/// The box in blocks.
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

    /// The block of a position.
    fn block_of(&self, x: [f64; D]) -> usize {
        let blocks = Volume::new(self.dims, &[]);
        blocks.index(std::array::from_fn(|k| self.axis_index(k, x[k])))
    }

    /// The layer of blocks of a point.
    fn layer_of(&self, point: &FeaturePoint<D>) -> usize {
        self.axis_index(D - 1, point.position[D - 1].into())
    }

    fn layer_range(&self, at: usize) -> Range<usize> {
        at * layer_len(self.dims)..(at + 1) * layer_len(self.dims)
    }

    /// For each block whether it may be within `reach` of some positions.
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
    use crate::comm::{SelfComm, run_threads};
    use crate::feature::DetectionOptions;
    use crate::geometry::random::Random;
    use crate::image::SparseField;

    const DIMS: [usize; 3] = [60, 40, 90];

    /// Points here and there, some of them at one place, in the order of their layers.
    fn random_features(count: usize) -> Features<3> {
        let mut random = Random::new(8);
        let mut some: Vec<MarkedPoint<3>> = (0..count)
            .map(|i| {
                let far = DIMS.map(|n| random.range(0.0, (n - 1) as f64) as f32);
                let position = match i % 10 {
                    0 => [30.0, 20.0, 30.5],
                    _ => far,
                };
                let point = FeaturePoint {
                    position,
                    normal: [1.0, 0.0, 0.0],
                    strength: i as f32,
                };
                (point, (1 + (i % 7) as u32, i % 3 == 0))
            })
            .collect();
        some.sort_by_key(|(point, _)| point.position[2].round() as i32);
        let mut features = Features {
            potential: SparseField::zero(DIMS, [1.0; 3]),
            ..Features::empty(DIMS, &DetectionOptions::default())
        };
        features.set_from_lists(vec![some], None);
        features
    }

    fn marked_points(features: &Features<3>) -> Vec<MarkedPoint<3>> {
        (0..features.points.len())
            .map(|i| features.marked_point(i))
            .collect()
    }

    #[test]
    fn shares_of_points_are_all_of_them_and_are_gathered_again() {
        for points in [0, 2, 500] {
            let all = random_features(points);
            for count in [1, 3, 5] {
                let parts = run_threads(count, |group| {
                    let mut own = all.clone();
                    own.keep_share(group);
                    own.keep_share(group);
                    assert_eq!(own.point_counts(), all.point_counts());
                    let part = marked_points(&own);
                    own.gather(group).unwrap();
                    assert!(
                        marked_points(&own) == marked_points(&all) && own.global_counts.is_none()
                    );
                    part
                });
                assert!(parts.concat() == marked_points(&all));
            }
        }
    }

    #[test]
    fn each_is_told_of_the_points_near_its_positions() {
        let all = random_features(2000);
        let mut random = Random::new(5);
        for (count, reach) in [(1, 3.0), (2, 0.0), (5, 20.0)] {
            let positions: Vec<Vec<[f64; 3]>> = (0..count)
                .map(|rank| match rank {
                    // One has none.
                    1 => Vec::new(),
                    _ => (0..3)
                        .map(|_| DIMS.map(|n| random.range(0.0, (n - 1) as f64)))
                        .collect(),
                })
                .collect();
            run_threads(count, |group| {
                let mut own = all.clone();
                own.keep_share(group);
                let positions = &positions[group.rank()];
                let near = own.points_near(positions, reach, group).unwrap();
                let told: Vec<MarkedPoint<3>> = near.points.into_iter().zip(near.marks).collect();
                let within = |far: f64| {
                    marked_points(&all).into_iter().filter(move |(point, _)| {
                        let at = point.position.map(f64::from);
                        let is_near = |x: &[f64; 3]| (0..3).all(|k| (x[k] - at[k]).abs() <= far);
                        positions.iter().any(is_near)
                    })
                };
                // All that are near, none that is far, in their order.
                assert!(within(reach).all(|point| told.contains(&point)));
                let far: Vec<_> = within(reach + 2.0 * BLOCK_SIZE).collect();
                let mut order = far.iter();
                assert!(told.iter().all(|point| order.any(|other| other == point)));
                assert!(count > 2 || group.rank() == 1 || told.len() < 2000);
            });
        }
    }

    #[test]
    fn points_of_shares_are_sorted_as_those_of_one() {
        let all = random_features(700);
        let mut sorted = all.clone();
        sorted.sort_points(&SelfComm).unwrap();
        assert!(marked_points(&sorted) != marked_points(&all));
        for count in [2, 3, 7] {
            let parts = run_threads(count, |group| {
                let mut own = all.clone();
                own.keep_share(group);
                own.sort_points(group).unwrap();
                marked_points(&own)
            });
            assert!(parts.iter().filter(|part| !part.is_empty()).count() > 1);
            assert!(parts.concat() == marked_points(&sorted));
        }
    }
}
