//! One triangulation by several runs of TetGen at once, each of a part of the points.
//!
//! Space is cut into slabs. The points of a slab and of a halo round it are triangulated. A tetrahedron
//! whose circumsphere, as far as points can be in it at all, lies in slab and halo is one of the whole's:
//! it is *certified*. Where all at the slab's own points are, the slab keeps those whose first point (by
//! number) is its own; else the halo is widened (as Peterka, Morozov and Phillips 2014 do by blocks). Ties of
//! cospherical points TetGen breaks by the points' numbers, which come in the same order in each part.
//!
//! So the tetrahedra are those of a single run. So that they are in the same order, too, both are put into
//! [`sort_canonical`].

use std::ops::Range;
use std::panic::resume_unwind;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicU32, AtomicUsize};
use std::thread;

use crate::parallel::prelude::*;

use super::global_points::{GlobalPoints, INITIAL_HALO, MAX_HALO_TRIES};
use super::{OUTSIDE, TetgenOutput};
use crate::comm;
use crate::error::Result;
use crate::geometry::counting_sort::sort_by_group_into;
use crate::geometry::{cross, dot, sub};

/// The neighbour is kept by another slab.
const IN_OTHER_SLAB: u32 = OUTSIDE - 1;
/// The rounding of a circumcentre, in distances, where its sphere's radius is the distance: it grows with
/// the square of the radius. (2e-16 times what a flat tetrahedron makes of it, and room.)
const ROUNDING_TOLERANCE: f64 = 1e-9;
/// Points whose tetrahedra are put in order together.
const SORT_CHUNK: usize = 4096;

/// What `run` answers for all points, from its answers for `count` parts, so many of them `at_once`; with
/// neighbours, in no order. None if this way does not lead there: points that do not fill a box, or are too uneven.
///
/// # Errors
/// Those of `run`.
pub fn triangulate_in_parts<R>(
    points: &[[f64; 3]],
    count: usize,
    at_once: usize,
    run: &R,
) -> Result<Option<TetgenOutput>>
where
    R: Fn(&[[f64; 3]]) -> Result<TetgenOutput> + Sync,
{
    let Some(slabs) = PointSlabs::new(points, count) else {
        return Ok(None);
    };
    let mut parts: Vec<Option<TetgenOutput>> = Vec::with_capacity(count);
    let own = |own: Range<usize>, give: &mut dyn FnMut(Option<TetgenOutput>)| {
        for part in slabs.triangulate_slabs(own, at_once, run) {
            give(part?);
        }
        Ok(())
    };
    comm::distribute("slabs of points", count, own, &mut |part| parts.push(part))?;
    let parts: Option<Vec<TetgenOutput>> = parts.into_iter().collect();
    Ok(parts.and_then(|parts| match concatenate(parts) {
        (all, 0) => Some(all),
        _ => None,
    }))
}

/// The tetrahedra whose first point is in some of the stretches between `cuts` across an axis, as `run` answers for
/// parts of these, so many of them `at_once`; with neighbours among them, in no order. None if this way does not lead
/// there, or leaves out a point. Parts have about as many points as `limits` say, or are a stretch. Of the `whole` no
/// points need be there but those in the stretches, or no farther from these than [`GlobalPoints::max_halo`].
///
/// # Errors
/// Those of `run`.
pub fn tets_in_intervals<R>(
    points: &[[f64; 3]],
    whole: GlobalPoints,
    axis: usize,
    cuts: &[f64],
    stretches: Range<usize>,
    at_once: usize,
    limits: [usize; 2],
    run: &R,
) -> Result<Option<TetgenOutput>>
where
    R: Fn(&[[f64; 3]]) -> Result<TetgenOutput> + Sync,
{
    let mut slabs = PointSlabs {
        axis,
        ..PointSlabs::single(points, whole)
    };
    // Stretches in parts, so that all are at work.
    let mut own = 0..0;
    let [least, most] = limits;
    let at_once_each = at_once.div_ceil(stretches.len().max(1));
    for stretch in 0..=cuts.len() {
        if stretch == stretches.start {
            own.start = slabs.cuts.len();
        }
        if stretches.contains(&stretch) {
            let from = stretch
                .checked_sub(1)
                .map_or(f64::NEG_INFINITY, |i| cuts[i]);
            let to = cuts.get(stretch).copied().unwrap_or(f64::INFINITY);
            let along = points.iter().map(|p| p[axis]);
            let mut along: Vec<f64> = along.filter(|x| from <= *x && *x < to).collect();
            let count = along.len();
            let parts = at_once_each.min(count / least).max(count.div_ceil(most));
            for part in 1..parts {
                let (_, cut, _) =
                    along.select_nth_unstable_by(part * count / parts, f64::total_cmp);
                slabs.cuts.push(*cut);
            }
            own.end = slabs.cuts.len() + 1;
        }
        slabs.cuts.extend(cuts.get(stretch));
    }
    if !slabs.cuts.windows(2).all(|two| two[0] < two[1]) {
        return Ok(None);
    }
    let parts: Result<Option<Vec<TetgenOutput>>> = (slabs
        .triangulate_slabs(own.clone(), at_once, run)
        .into_iter())
    .collect();
    let parts = parts?.filter(|parts| parts.len() == own.len());
    Ok(parts.map(|parts| concatenate(parts).0))
}

/// The parts' tetrahedra one after the other, with neighbours across; and how many faces have lead to none of them, where
/// neighbours are outside.
fn concatenate(parts: Vec<TetgenOutput>) -> (TetgenOutput, usize) {
    let count = parts.iter().map(|part| part.tets.len()).sum();
    let mut all = TetgenOutput {
        status: parts.first().map_or(0, |part| part.status),
        tets: Vec::with_capacity(count),
        neighbors: Vec::with_capacity(count),
    };
    // Faces beyond which another part goes on.
    let mut open: Vec<([u32; 3], u32, usize)> = Vec::new();
    // What has been copied goes.
    for part in parts {
        let first = all.tets.len() as u32;
        let open_of = |(t, (tet, around)): (usize, (&[u32; 4], &[u32; 4]))| {
            let (tet, around) = (*tet, *around);
            let ends = (0..4).filter(move |&k| around[k] == IN_OTHER_SLAB);
            ends.map(move |k| {
                let mut face = [1, 2, 3].map(|j| tet[(k + j) % 4]);
                face.sort_unstable();
                (face, first + t as u32, k)
            })
        };
        let cells = part.tets.par_iter().zip(&part.neighbors).enumerate();
        open.par_extend(cells.flat_map_iter(open_of));
        let moved = |n: u32| match n {
            IN_OTHER_SLAB | OUTSIDE => OUTSIDE,
            own => first + own,
        };
        all.tets.extend_from_slice(&part.tets);
        let around = part.neighbors.par_iter();
        all.neighbors
            .par_extend(around.map(|around| around.map(moved)));
    }
    open.par_sort_unstable();
    let mut alone = 0;
    let mut rest = &open[..];
    while let [(face, a, k), after @ ..] = rest {
        rest = after;
        match after {
            [(other, b, l), after @ ..] if face == other => {
                all.neighbors[*a as usize][*k] = *b;
                all.neighbors[*b as usize][*l] = *a;
                rest = after;
            }
            _ => alone += 1,
        }
    }
    (all, alone)
}

/// Space, cut across its longest axis so that each slab has as many points.
struct PointSlabs<'a> {
    points: &'a [[f64; 3]],
    global: GlobalPoints,
    axis: usize,
    /// Where one slab ends and the next begins.
    cuts: Vec<f64>,
    /// Of points, if they stood regularly.
    mean_distance: f64,
}

impl<'a> PointSlabs<'a> {
    /// One.
    fn single(points: &'a [[f64; 3]], global: GlobalPoints) -> Self {
        let size = sub(global.high, global.low);
        Self {
            points,
            axis: (0..3).fold(0, |best, k| if size[k] >= size[best] { k } else { best }),
            cuts: Vec::new(),
            mean_distance: global.mean_distance(),
            global,
        }
    }

    /// None if the points cannot be cut so often.
    fn new(points: &'a [[f64; 3]], count: usize) -> Option<Self> {
        let uncut = Self::single(points, GlobalPoints::from_points(points));
        let axis = uncut.axis;
        let mut along: Vec<f64> = points.iter().map(|p| p[axis]).collect();
        let cuts: Vec<f64> = (1..count)
            .map(|i| {
                *along
                    .select_nth_unstable_by(i * points.len() / count, f64::total_cmp)
                    .1
            })
            .collect();
        let apart = cuts.windows(2).all(|two| two[0] < two[1])
            && cuts.first().is_none_or(|&cut| uncut.global.low[axis] < cut);
        apart.then_some(Self { cuts, ..uncut })
    }

    /// Those of some slabs, in their order, so many of them at once; fewer where one leads nowhere.
    fn triangulate_slabs<R>(
        &self,
        slabs: Range<usize>,
        at_once: usize,
        run: &R,
    ) -> Vec<Result<Option<TetgenOutput>>>
    where
        R: Fn(&[[f64; 3]]) -> Result<TetgenOutput> + Sync,
    {
        let (end, next) = (slabs.end, &AtomicUsize::new(slabs.start));
        // Each thread takes the next slab, until one leads nowhere.
        let work = move || {
            let mut done = Vec::new();
            loop {
                let slab = next.fetch_add(1, Relaxed);
                if slab >= end {
                    return done;
                }
                let part = self.triangulate_slab(slab, run);
                if !matches!(part, Ok(Some(_))) {
                    next.store(end, Relaxed);
                }
                done.push((slab, part));
            }
        };
        let mut parts: Vec<(usize, Result<Option<TetgenOutput>>)> = thread::scope(|scope| {
            let at_work: Vec<_> = (0..at_once.min(slabs.len()))
                .map(|_| scope.spawn(work))
                .collect();
            let ended = at_work.into_iter().map(thread::ScopedJoinHandle::join);
            ended
                .flat_map(|parts| parts.unwrap_or_else(|panic| resume_unwind(panic)))
                .collect()
        });
        parts.sort_by_key(|part| part.0);
        parts.into_iter().map(|part| part.1).collect()
    }

    /// The tetrahedra that a slab keeps, with neighbours among them.
    fn triangulate_slab<R>(&self, slab: usize, run: &R) -> Result<Option<TetgenOutput>>
    where
        R: Fn(&[[f64; 3]]) -> Result<TetgenOutput>,
    {
        let from = slab
            .checked_sub(1)
            .map_or(f64::NEG_INFINITY, |i| self.cuts[i]);
        let to = self.cuts.get(slab).copied().unwrap_or(f64::INFINITY);
        for halo in
            (0..MAX_HALO_TRIES).map(|i| INITIAL_HALO * self.mean_distance * f64::from(1 << i))
        {
            let within = [from - halo, to + halo];
            let has = |&i: &u32| {
                let x = self.points[i as usize][self.axis];
                within[0] <= x && x <= within[1]
            };
            let members: Vec<u32> = (0..self.points.len() as u32).filter(has).collect();
            let points: Vec<[f64; 3]> = members.iter().map(|&i| self.points[i as usize]).collect();
            let answer = run(&points)?;
            if answer.status != 0 {
                return Ok(None);
            }
            if let Some(kept) = self.certified_tets(&answer, &members, [from, to], within) {
                return Ok(Some(kept));
            }
        }
        Ok(None)
    }

    /// What the slab from one place to another keeps of the triangulation of `members`, all `within` some
    /// bounds; None if a tetrahedron at one of its points is not certified.
    fn certified_tets(
        &self,
        answer: &TetgenOutput,
        members: &[u32],
        [from, to]: [f64; 2],
        within: [f64; 2],
    ) -> Option<TetgenOutput> {
        let point = |local: u32| self.points[members[local as usize] as usize];
        let owns = |local: u32| {
            let x = point(local)[self.axis];
            from <= x && x < to
        };
        let mut number = vec![IN_OTHER_SLAB; answer.tets.len()];
        let mut used = vec![false; members.len()];
        let mut count = 0;
        for ((tet, neighbors), number) in answer.tets.iter().zip(&answer.neighbors).zip(&mut number)
        {
            let own = tet.map(owns);
            tet.iter().for_each(|&local| used[local as usize] = true);
            if !own.contains(&true) {
                continue;
            }
            let corners = tet.map(point);
            let hull_is_real = (0..4).all(|k| {
                let face = [1, 2, 3].map(|j| (k + j) % 4);
                neighbors[k] != OUTSIDE
                    || !face.iter().any(|&j| own[j])
                    || self.is_on_side(face.map(|j| corners[j]))
            });
            if !(hull_is_real && self.is_certified(corners, within)) {
                return None;
            }
            if owns(*tet.iter().min()?) {
                *number = count;
                count += 1;
            }
        }
        // A point that coincides with another is left out.
        if (0..members.len()).any(|i| !used[i] && owns(i as u32)) {
            return None;
        }
        let mine = |t: &usize| number[*t] != IN_OTHER_SLAB;
        let neighbor = |n: u32| match n {
            OUTSIDE => OUTSIDE,
            n => number[n as usize],
        };
        let all = 0..answer.tets.len();
        Some(TetgenOutput {
            status: answer.status,
            tets: (all.clone().filter(mine))
                .map(|t| answer.tets[t].map(|local| members[local as usize]))
                .collect(),
            neighbors: (all.filter(mine))
                .map(|t| answer.neighbors[t].map(neighbor))
                .collect(),
        })
    }

    /// Whether a face lies in one side of the box of all points, so that nothing is beyond.
    fn is_on_side(&self, face: [[f64; 3]; 3]) -> bool {
        (0..3).any(|k| {
            [self.global.low[k], self.global.high[k]]
                .iter()
                .any(|&side| face.iter().all(|p| p[k] == side))
        })
    }

    /// Whether all that could be in the circumsphere is `within` the bounds.
    fn is_certified(&self, [a, b, c, d]: [[f64; 3]; 4], within: [f64; 2]) -> bool {
        let [b, c, d] = [b, c, d].map(|p| sub(p, a));
        let [normal_b, normal_c, normal_d] = [cross(c, d), cross(d, b), cross(b, c)];
        let twice = 2.0 * dot(b, normal_b);
        let [b2, c2, d2] = [b, c, d].map(|p| dot(p, p));
        let middle: [f64; 3] = std::array::from_fn(|k| {
            (b2 * normal_b[k] + c2 * normal_c[k] + d2 * normal_d[k]) / twice
        });
        let radius2 = dot(middle, middle);
        let rounding = ROUNDING_TOLERANCE * radius2 / self.mean_distance;
        // In the box of all points the sphere is less wide where its middle is outside.
        let outside2: f64 = (0..3)
            .filter(|&k| k != self.axis)
            .map(|k| {
                let x = a[k] + middle[k];
                let [low, high] = [self.global.low[k], self.global.high[k]];
                (low - x).max(x - high).max(0.0).powi(2)
            })
            .sum();
        let reach =
            (radius2 - outside2).max(0.0).sqrt() + (rounding * radius2.sqrt()).sqrt() + rounding;
        let x = a[self.axis] + middle[self.axis];
        // Not so for what is no number.
        within[0] <= x - reach && x + reach <= within[1]
    }
}

/// Tetrahedra in an order that depends on nothing but themselves: each begins with its first point (by
/// number) and goes on with the first of the others, its turn unchanged; and so they follow one another.
pub fn sort_canonical(points: usize, answer: &mut TetgenOutput) {
    let TetgenOutput {
        tets, neighbors, ..
    } = answer;
    let with_neighbors = !neighbors.is_empty();
    let turns: Vec<[u8; 4]> = tets.par_iter().map(canonical_rotation).collect();
    let turned = |t: u32| turns[t as usize].map(|k| tets[t as usize][usize::from(k)]);
    // By the first point ...
    let first = |t: u32| turned(t)[0];
    let firsts: Vec<u32> = (0..tets.len() as u32).into_par_iter().map(first).collect();
    let (mut starts, mut sorted) = (Vec::new(), Vec::new());
    sort_by_group_into(points, &firsts, &mut starts, &mut sorted);
    drop(firsts);
    // ... and then by the others.
    let mut rest = sorted.as_mut_slice();
    let mut groups = Vec::with_capacity(points / SORT_CHUNK + 1);
    for first in (0..points).step_by(SORT_CHUNK) {
        let last = (first + SORT_CHUNK).min(points);
        let (own, after) = rest.split_at_mut((starts[last] - starts[first]) as usize);
        rest = after;
        groups.push((first..last, own));
    }
    groups.into_par_iter().for_each(|(nodes, own)| {
        let from = starts[nodes.start];
        for node in nodes {
            let place = (starts[node] - from) as usize..(starts[node + 1] - from) as usize;
            own[place].sort_unstable_by_key(|&t| turned(t));
        }
    });
    let new_tets = sorted.par_iter().map(|&t| turned(t)).collect();
    if with_neighbors {
        let place = tets.par_iter().map(|_| AtomicU32::new(0));
        let place: Vec<AtomicU32> = place.collect();
        let all = sorted.par_iter().enumerate();
        all.for_each(|(new, &old)| place[old as usize].store(new as u32, Relaxed));
        let moved = |&t: &u32| {
            turns[t as usize].map(|k| match neighbors[t as usize][usize::from(k)] {
                OUTSIDE => OUTSIDE,
                n => place[n as usize].load(Relaxed),
            })
        };
        *neighbors = sorted.par_iter().map(moved).collect();
    }
    *tets = new_tets;
}

/// The even permutation after which the least number is first and the least of the others second.
fn canonical_rotation(tet: &[u32; 4]) -> [u8; 4] {
    const ROTATIONS: [[u8; 4]; 4] = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]];
    let least = (0..4).min_by_key(|&k| tet[k]).unwrap_or(0);
    let [a, b, c, d] = ROTATIONS[least];
    let others = [[b, c, d], [c, d, b], [d, b, c]];
    let [b, c, d] = others
        .into_iter()
        .min_by_key(|others| tet[usize::from(others[0])])
        .unwrap_or([b, c, d]);
    [a, b, c, d]
}

#[cfg(test)]
mod tests {
    use super::super::ffi;
    use super::*;
    use crate::geometry::random::Random;

    /// Points of a cubic lattice with both ends of each axis, moved by up to `noise` within the box.
    fn lattice(dims: [usize; 3], noise: f64, place: impl Fn(f64) -> f64) -> Vec<[f64; 3]> {
        let mut random = Random::new(7);
        let mut points = Vec::new();
        for x in 0..dims[0] {
            for y in 0..dims[1] {
                for z in 0..dims[2] {
                    let at = [x, y, z];
                    points.push(std::array::from_fn(|k| {
                        let moved = noise * (random.draw() - 0.5);
                        let end = at[k] == 0 || at[k] == dims[k] - 1;
                        place(at[k] as f64 + if end { 0.0 } else { moved })
                    }));
                }
            }
        }
        points
    }

    fn triangulate_whole(points: &[[f64; 3]]) -> TetgenOutput {
        let mut answer = ffi::run(points, true);
        sort_canonical(points.len(), &mut answer);
        answer
    }

    #[test]
    fn parts_give_the_tetrahedra_of_the_whole() {
        let run = |points: &[[f64; 3]]| Ok(ffi::run(points, true));
        let scenes = [
            // In general position, cospherical everywhere, and of uneven distances.
            lattice([30, 14, 12], 0.9, |x| x),
            lattice([30, 10, 9], 0.0, |x| x),
            lattice([12, 11, 34], 0.5, |x| x + 0.02 * x * x),
        ];
        for (scene, points) in scenes.iter().enumerate() {
            let single = triangulate_whole(points);
            for count in [1, 2, 3, 5] {
                let mut parts = triangulate_in_parts(points, count, count.min(3), &run)
                    .unwrap()
                    .unwrap();
                sort_canonical(points.len(), &mut parts);
                assert!(parts.tets == single.tets, "scene {scene}, {count} parts");
                assert!(
                    parts.neighbors == single.neighbors,
                    "scene {scene}, {count} parts"
                );
            }
        }
    }

    #[test]
    fn stretches_have_the_tetrahedra_of_the_whole_in_its_order() {
        let run = |points: &[[f64; 3]]| Ok(ffi::run(points, true));
        let points = lattice([60, 14, 12], 0.9, |x| x);
        let (single, whole) = (
            triangulate_whole(&points),
            GlobalPoints::from_points(&points),
        );
        let cuts = [15.0, 29.3, 45.0];
        let stretch =
            |tet: &[u32; 4]| cuts.partition_point(|cut| *cut <= points[tet[0] as usize][0]);
        for own in [0..1, 1..3, 2..4, 0..4, 2..2_usize] {
            let limits = [500, 1500];
            // No others are at hand.
            let ends = [
                own.start
                    .checked_sub(1)
                    .map_or(f64::NEG_INFINITY, |i| cuts[i]),
                cuts.get(own.end.max(1) - 1)
                    .copied()
                    .unwrap_or(f64::INFINITY),
            ];
            let near = |&n: &usize| {
                let x = points[n][0];
                ends[0] - whole.max_halo() <= x && x <= ends[1] + whole.max_halo()
            };
            let numbers: Vec<usize> = (0..points.len()).filter(near).collect();
            let some: Vec<[f64; 3]> = numbers.iter().map(|&n| points[n]).collect();
            let some = tets_in_intervals(&some, whole, 0, &cuts, own.clone(), 3, limits, &run);
            let mut some = some.unwrap().unwrap();
            some.tets
                .iter_mut()
                .for_each(|tet| *tet = tet.map(|n| numbers[n as usize] as u32));
            sort_canonical(points.len(), &mut some);
            let chosen: Vec<usize> = (0..single.tets.len())
                .filter(|&t| own.contains(&stretch(&single.tets[t])))
                .collect();
            assert!(
                some.tets.iter().eq(chosen.iter().map(|&t| &single.tets[t])),
                "{own:?}"
            );
            for (around, &t) in some.neighbors.iter().zip(&chosen) {
                let wanted = single.neighbors[t].map(|n| match n {
                    OUTSIDE => OUTSIDE,
                    n => chosen
                        .binary_search(&(n as usize))
                        .map_or(OUTSIDE, |n| n as u32),
                });
                assert_eq!(*around, wanted, "{own:?}");
            }
        }
        // Two points at one place: only the whole says so.
        let mut twice = points.clone();
        twice.push(points[1000]);
        let at = points[1000][0];
        let (cuts, whole) = ([at - 4.0, at + 4.0], GlobalPoints::from_points(&twice));
        let some = tets_in_intervals(&twice, whole, 0, &cuts, 1..2, 1, [500, 9999], &run);
        assert!(some.unwrap().is_none());
    }

    #[test]
    fn points_that_do_not_fill_a_box_are_left_to_a_single_run() {
        let run = |points: &[[f64; 3]]| Ok(ffi::run(points, true));
        let mut random = Random::new(3);
        let ball: Vec<[f64; 3]> =
            std::iter::repeat_with(|| std::array::from_fn(|_| 2.0 * random.draw() - 1.0))
                .filter(|p| dot(*p, *p) < 1.0)
                .take(3000)
                .collect();
        assert!(triangulate_in_parts(&ball, 2, 2, &run).unwrap().is_none());
    }

    #[test]
    fn order_keeps_tetrahedra_and_neighbours() {
        let points = lattice([9, 8, 7], 0.7, |x| x);
        let before = ffi::run(&points, true);
        let after = triangulate_whole(&points);
        let sorted = |tets: &[[u32; 4]]| {
            let mut all: Vec<[u32; 4]> = tets.to_vec();
            all.iter_mut().for_each(|t| t.sort_unstable());
            all.sort_unstable();
            all
        };
        assert_eq!(sorted(&before.tets), sorted(&after.tets));
        assert!(after.tets.is_sorted());
        for (t, tet) in after.tets.iter().enumerate() {
            let [a, b, c, d] = tet.map(|i| points[i as usize]);
            assert!(dot(cross(sub(b, a), sub(c, a)), sub(d, a)) > 0.0);
            for (k, &n) in after.neighbors[t]
                .iter()
                .enumerate()
                .filter(|n| *n.1 != OUTSIDE)
            {
                let shared = [1, 2, 3].map(|j| tet[(k + j) % 4]);
                assert!(
                    shared
                        .iter()
                        .all(|node| after.tets[n as usize].contains(node))
                );
                assert!(after.neighbors[n as usize].contains(&(t as u32)));
            }
        }
    }
}
