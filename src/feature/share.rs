//! Points of features where ranks share them: each has those of some layers of the image, and is told of those that are
//! near to what it works on.

use super::volume::Volume;
use super::windows::layer;
use super::{FeaturePoint, Features};
use crate::error::Result;
use crate::geometry::marks::dilate;
use crate::parallel::prelude::*;
use crate::ranks::{Group, joined, share_of};
use std::cmp::Ordering;
use std::ops::Range;

/// Edge of the blocks of space of which ranks ask one another, in lattice units.
const BLOCK: f64 = 16.0;

/// Some points of features, in the order of samples.
#[derive(Debug, Clone, PartialEq)]
pub struct NearPoints<const D: usize> {
    /// Where they are.
    pub points: Vec<FeaturePoint<D>>,
    /// For each of them the number of its sheet, and whether it lies on a horizon.
    pub marks: Vec<(u32, bool)>,
}

/// How many points all ranks have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OfAll {
    /// Points of features ...
    pub points: usize,
    /// ... and those of them that lie on horizons.
    pub on_horizon: usize,
}

/// A point, the number of its sheet, and whether it lies on a horizon.
type Whole<const D: usize> = (FeaturePoint<D>, (u32, bool));

impl<const D: usize> Features<D> {
    /// How many points there are, of all ranks.
    pub(crate) fn of_all(&self) -> OfAll {
        self.in_shares.unwrap_or_else(|| OfAll {
            points: self.points.len(),
            on_horizon: self.on_horizon.iter().filter(|on| **on).count(),
        })
    }

    /// Keeps this rank's share of the points that all have.
    pub(crate) fn share(&mut self, group: &dyn Group) {
        if self.in_shares.is_some() {
            return;
        }
        self.in_shares = Some(self.of_all());
        let own = share_of(self.points.len(), group.rank(), group.count());
        keep(&mut self.points, own.clone());
        keep(&mut self.sheet, own.clone());
        keep(&mut self.on_horizon, own.clone());
        if let Some(spacing) = &mut self.spacing {
            keep(spacing, own);
        }
    }

    /// Has the points of all ranks.
    ///
    /// # Errors
    /// Those of the others.
    pub(crate) fn gather(&mut self, group: &dyn Group) -> Result<()> {
        if self.in_shares.take().is_some() {
            let own = (0..self.points.len()).map(|i| self.whole(i)).collect();
            let told = group.all("points of features", own)?;
            let spacing = self.spacing.take();
            let spacing = spacing.map(|own| group.all("distances at points", own));
            self.take(told, spacing.transpose()?);
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
        group: &dyn Group,
    ) -> Result<NearPoints<D>> {
        let blocks = Blocks::of(self.potential.extent());
        let wanted = blocks.round(positions, reach);
        // A rank is asked for what it may have.
        let own = self.points.iter().map(|p| blocks.layer(p));
        let own = own.fold([usize::MAX, 0], |[low, high], at| {
            [low.min(at), high.max(at)]
        });
        let have: Vec<[usize; 2]> = group.all("where points of features are", own)?;
        let asked = have.iter().map(|&[low, high]| -> Vec<u32> {
            let some = (low..=high.min(blocks.dims[D - 1] - 1)).flat_map(|at| blocks.of_layer(at));
            some.filter(|&block| wanted[block])
                .map(|block| block as u32)
                .collect()
        });
        let asked: Vec<Vec<u32>> = group.pass("blocks of space", asked.collect())?;
        let told = asked.iter().map(|asked| -> Vec<Whole<D>> {
            if asked.is_empty() {
                return Vec::new();
            }
            let mut among = vec![false; wanted.len()];
            asked.iter().for_each(|&block| among[block as usize] = true);
            let own = self.points.par_iter().enumerate();
            let of_those = own.filter(|(_, p)| among[blocks.at(p.position.map(f64::from))]);
            of_those.map(|(i, _)| self.whole(i)).collect()
        });
        let (points, marks) = joined(group.pass("points of features", told.collect())?)
            .into_iter()
            .unzip();
        Ok(NearPoints { points, marks })
    }

    /// Has these points instead of those of its share.
    pub(crate) fn put(&mut self, near: NearPoints<D>) {
        self.points = near.points;
        (self.sheet, self.on_horizon) = near.marks.into_iter().unzip();
        self.spacing = None;
    }

    /// Sorts points by where they are, last axis first; of shares, each rank has those that are in its layers then.
    ///
    /// # Errors
    /// Those of the others.
    pub(super) fn sort(&mut self, group: &dyn Group) -> Result<()> {
        if self.in_shares.is_some() {
            let (layers, step) = (self.potential.dims[D - 1], self.potential.step[D - 1]);
            // Where the layers of all but the last rank end.
            let ends = (1..group.count()).map(|rank| share_of(layers, rank, group.count()).start);
            let ends: Vec<f64> = ends.map(|end| end as f64).collect();
            let rank_of = |i: usize| {
                let at = f64::from(self.points[i].position[D - 1]) / step;
                ends.partition_point(|&end| at >= end)
            };
            let mut to = vec![Vec::new(); group.count()];
            (0..self.points.len()).for_each(|i| to[rank_of(i)].push(i));
            let whole = |to: &Vec<usize>| to.iter().map(|&i| self.whole(i)).collect();
            let told = group.pass("points of features", to.iter().map(whole).collect())?;
            let spacing = self.spacing.take().map(|own| {
                let to = to.iter().map(|to| ordered(to, &own));
                group.pass("distances at points", to.collect())
            });
            self.take(told, spacing.transpose()?);
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
        self.points = ordered(&order, &self.points);
        self.on_horizon = ordered(&order, &self.on_horizon);
        self.sheet = ordered(&order, &self.sheet);
        self.spacing = (self.spacing.take()).map(|spacing| ordered(&order, &spacing));
        Ok(())
    }

    fn whole(&self, i: usize) -> Whole<D> {
        (self.points[i], (self.sheet[i], self.on_horizon[i]))
    }

    fn take(&mut self, lists: Vec<Vec<Whole<D>>>, spacing: Option<Vec<Vec<f32>>>) {
        let (points, marks) = lists.into_iter().flatten().unzip();
        self.put(NearPoints { points, marks });
        self.spacing = spacing.map(|lists| lists.concat());
    }
}

fn keep<T>(values: &mut Vec<T>, own: Range<usize>) {
    values.truncate(own.end);
    values.drain(..own.start);
    values.shrink_to_fit();
}

fn ordered<T: Copy>(order: &[usize], values: &[T]) -> Vec<T> {
    order.iter().map(|&i| values[i]).collect()
}

/// The box in blocks.
struct Blocks<const D: usize> {
    dims: [usize; D],
}

impl<const D: usize> Blocks<D> {
    fn of(extent: [f64; D]) -> Self {
        Self {
            dims: extent.map(|e| (e / BLOCK) as usize + 1),
        }
    }

    fn along(&self, k: usize, x: f64) -> usize {
        ((x / BLOCK) as usize).min(self.dims[k] - 1)
    }

    /// The block of a position.
    fn at(&self, x: [f64; D]) -> usize {
        let blocks = Volume::new(self.dims, &[]);
        blocks.index(std::array::from_fn(|k| self.along(k, x[k])))
    }

    /// The layer of blocks of a point.
    fn layer(&self, point: &FeaturePoint<D>) -> usize {
        self.along(D - 1, point.position[D - 1].into())
    }

    fn of_layer(&self, at: usize) -> Range<usize> {
        at * layer(self.dims)..(at + 1) * layer(self.dims)
    }

    /// For each block whether it may be within `reach` of some positions.
    fn round(&self, positions: &[[f64; D]], reach: f64) -> Vec<bool> {
        let mut marks = vec![false; self.dims.iter().product()];
        for &x in positions {
            marks[self.at(x)] = true;
        }
        for axis in 0..D {
            dilate(&mut marks, self.dims, axis, (reach / BLOCK).ceil() as usize);
        }
        marks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::Detection;
    use crate::geometry::random::Random;
    use crate::image::Sparse;
    use crate::ranks::{Alone, shared};

    const DIMS: [usize; 3] = [60, 40, 90];

    /// Points here and there, some of them at one place, in the order of their layers.
    fn features(count: usize) -> Features<3> {
        let mut random = Random::new(8);
        let mut some: Vec<Whole<3>> = (0..count)
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
            potential: Sparse::zero(DIMS, [1.0; 3]),
            ..Features::none(DIMS, &Detection::default())
        };
        features.take(vec![some], None);
        features
    }

    fn of(features: &Features<3>) -> Vec<Whole<3>> {
        (0..features.points.len())
            .map(|i| features.whole(i))
            .collect()
    }

    #[test]
    fn shares_of_points_are_all_of_them_and_are_gathered_again() {
        for points in [0, 2, 500] {
            let all = features(points);
            for count in [1, 3, 5] {
                let parts = shared(count, |group| {
                    let mut own = all.clone();
                    own.share(group);
                    own.share(group);
                    assert_eq!(own.of_all(), all.of_all());
                    let part = of(&own);
                    own.gather(group).unwrap();
                    assert!(of(&own) == of(&all) && own.in_shares.is_none());
                    part
                });
                assert!(parts.concat() == of(&all));
            }
        }
    }

    #[test]
    fn each_is_told_of_the_points_near_its_positions() {
        let all = features(2000);
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
            shared(count, |group| {
                let mut own = all.clone();
                own.share(group);
                let positions = &positions[group.rank()];
                let near = own.points_near(positions, reach, group).unwrap();
                let told: Vec<Whole<3>> = near.points.into_iter().zip(near.marks).collect();
                let within = |far: f64| {
                    of(&all).into_iter().filter(move |(point, _)| {
                        let at = point.position.map(f64::from);
                        let is_near = |x: &[f64; 3]| (0..3).all(|k| (x[k] - at[k]).abs() <= far);
                        positions.iter().any(is_near)
                    })
                };
                // All that are near, none that is far, in their order.
                assert!(within(reach).all(|point| told.contains(&point)));
                let far: Vec<_> = within(reach + 2.0 * BLOCK).collect();
                let mut order = far.iter();
                assert!(told.iter().all(|point| order.any(|other| other == point)));
                assert!(count > 2 || group.rank() == 1 || told.len() < 2000);
            });
        }
    }

    #[test]
    fn points_of_shares_are_sorted_as_those_of_one() {
        let all = features(700);
        let mut sorted = all.clone();
        sorted.sort(&Alone).unwrap();
        assert!(of(&sorted) != of(&all));
        for count in [2, 3, 7] {
            let parts = shared(count, |group| {
                let mut own = all.clone();
                own.share(group);
                own.sort(group).unwrap();
                of(&own)
            });
            assert!(parts.iter().filter(|part| !part.is_empty()).count() > 1);
            assert!(parts.concat() == of(&sorted));
        }
    }
}
