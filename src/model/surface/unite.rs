//! From pieces and votes to surfaces.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use super::facets::Facets;
use super::pairs::Vote;
use crate::feature::symmetric::{Symmetric, eigenvalues, eigenvector};
use crate::geometry::sets::Sets;
use crate::geometry::{dot, norm};

/// Ridges without which only crumbs are united.
const ENOUGH: u32 = 4;
/// Pieces with a shorter rim are crumbs.
const CRUMB: u32 = 4 * ENOUGH;

/// Pieces are flat if so much of their area lies in one plane (the square of its cosine, averaged).
const FLAT: f64 = 0.93;
/// Flat pieces whose planes differ by more (35 degrees) are two surfaces, whatever single ridges say:
/// where two faults cross, detection blurs both, and ridges there lead from one to the other.
const BENT: f64 = 0.82;

/// Which way a piece faces: the sum over its facets of n nT / |n|, n normal to them and as long as
/// they are large.
#[derive(Debug, Clone, Copy)]
pub struct Facing<const D: usize>(Symmetric<D>);

impl<const D: usize> Facing<D> {
    /// Of each of `count` pieces; `piece` says which each facet belongs to.
    pub fn of_pieces(facets: &Facets<D>, piece: &[u32], count: usize) -> Vec<Self> {
        let mut all = vec![Self([[0.0; D]; D]); count];
        for (f, &p) in piece.iter().enumerate() {
            let n = facets.normal(f);
            let size = norm(n);
            if size > 0.0 {
                all[p as usize].add(&Self(outer(n, n.map(|c| c / size))));
            }
        }
        all
    }

    fn add(&mut self, other: &Self) {
        for (row, others) in self.0.iter_mut().zip(&other.0) {
            for (a, b) in row.iter_mut().zip(others) {
                *a += b;
            }
        }
    }

    /// The normal of a flat piece.
    fn normal(&self) -> Option<[f64; D]> {
        let all: f64 = (0..D).map(|k| self.0[k][k]).sum();
        let values = eigenvalues(&self.0);
        let most = values.iter().copied().fold(0.0, f64::max);
        (most > FLAT * all).then(|| eigenvector(&self.0, most))
    }

    /// Whether both are flat, and lie in planes that differ.
    fn differs(&self, other: &Self) -> bool {
        match (self.normal(), other.normal()) {
            (Some(m), Some(n)) => dot(m, n).abs() < BENT,
            _ => false,
        }
    }
}

fn outer<const D: usize>(a: [f64; D], b: [f64; D]) -> Symmetric<D> {
    a.map(|x| b.map(|y| x * y))
}

/// What all ridges between two surfaces say.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    favour: u32,
    against: u32,
    /// How many speak for it.
    ridges: u32,
}

impl Sum {
    /// By how much what is for it outweighs what is against it.
    fn net(self) -> i64 {
        i64::from(self.favour) - 2 * i64::from(self.against)
    }

    /// The longest rim of the smaller surface for which the ridges are enough.
    fn longest_rim(self) -> u32 {
        match self.ridges {
            few @ 0..ENOUGH => 4 * few,
            many => many.saturating_mul(10),
        }
    }

    /// Whether there are enough ridges to unite surfaces `a` and `b`.
    fn enough(self, a: u32, b: u32, rims: &[u32]) -> bool {
        self.ridges > 0 && rims[a as usize].min(rims[b as usize]) <= self.longest_rim()
    }
}

/// Two surfaces, the smaller number first, by what speaks for one; the best is the greatest.
type Pair = (i64, Reverse<(u32, u32)>);

/// Pairs of surfaces that may become one.
///
/// A surface that grows may have very many neighbours, so that not all of its pairs can be looked at
/// whenever it grows: only those whose votes have changed, those that its shorter rim lets pass now,
/// and those that were refused for how it faced.
struct Pairs {
    queue: BinaryHeap<Pair>,
    /// For each surface, its pairs with too few ridges: the length to which a rim must shrink, and the
    /// other surface. What is no more so is found out when its turn comes.
    waiting: Vec<BTreeSet<(u32, u32)>>,
    /// For each surface, others that face elsewhere.
    refused: Vec<BTreeSet<u32>>,
}

impl Pairs {
    fn new(count: usize) -> Self {
        Self {
            queue: BinaryHeap::new(),
            waiting: vec![BTreeSet::new(); count],
            refused: vec![BTreeSet::new(); count],
        }
    }

    /// Queues a pair, or lets it wait for a shorter rim.
    fn put(&mut self, votes: Sum, a: u32, b: u32, rims: &[u32]) {
        if votes.net() < 0 {
            return;
        }
        if votes.enough(a, b, rims) {
            self.queue
                .push((votes.net(), Reverse((a.min(b), a.max(b)))));
        } else {
            self.wait(votes, a, b);
        }
    }

    fn wait(&mut self, votes: Sum, a: u32, b: u32) {
        if votes.ridges > 0 {
            self.waiting[a as usize].insert((votes.longest_rim(), b));
            self.waiting[b as usize].insert((votes.longest_rim(), a));
        }
    }

    fn refuse(&mut self, (_, Reverse((a, b))): Pair) {
        self.refused[a as usize].insert(b);
        self.refused[b as usize].insert(a);
    }

    /// Looks again at the pairs of surface `a`, which surface `b` has become part of.
    fn look_again(&mut self, a: u32, b: u32, near: &BTreeMap<u32, Sum>, rims: &[u32]) {
        // Those of b are pairs of a now, and have been put anew.
        self.waiting[b as usize].clear();
        self.refused[b as usize].clear();
        let mut again = std::mem::take(&mut self.refused[a as usize]);
        let waiting = &mut self.waiting[a as usize];
        while let Some(&(longest, c)) = waiting.last()
            && rims[a as usize] <= longest
        {
            waiting.pop_last();
            again.insert(c);
        }
        for c in again {
            if let Some(&votes) = near.get(&c) {
                self.put(votes, a, c, rims);
            }
        }
    }
}

/// Unites pieces that continue each other, best founded first, and gives the surface of each piece
/// and the number of surfaces.
///
/// Two surfaces become one if the weight for it is at least twice that against it, and enough ridges
/// are for it: four (of a crumb with fewer than 16 ridges at its rim, a quarter of these), and a
/// tenth of the smaller one's rim, lest a stray neck join two faults. `rims` is the length of each
/// piece's rim in ridges.
///
/// Nor do flat pieces that face elsewhere become one, as `facing` tells, unless one is a crumb.
///
/// What is against two pieces is against the surfaces that they become part of: so two faults that
/// cross stay two, though a third piece continues both.
pub fn unite<const D: usize>(
    rims: &[u32],
    facing: Vec<Facing<D>>,
    votes: &[Vote],
) -> (Vec<u32>, usize) {
    let (mut rims, mut facing) = (rims.to_vec(), facing);
    let mut sets = Sets::new(rims.len());
    let mut near: Vec<BTreeMap<u32, Sum>> = vec![BTreeMap::new(); rims.len()];
    for vote in votes {
        let [a, b] = vote.pieces;
        for (from, to) in [(a, b), (b, a)] {
            let sum = near[from as usize].entry(to).or_default();
            sum.favour += vote.favour;
            sum.against += vote.against;
            sum.ridges += u32::from(vote.favour > 0);
        }
    }
    let mut pairs = Pairs::new(rims.len());
    for a in 0..rims.len() as u32 {
        for (&b, &sum) in near[a as usize].range(a + 1..) {
            pairs.put(sum, a, b, &rims);
        }
    }
    while let Some(pair @ (net, Reverse((a, b)))) = pairs.queue.pop() {
        // What has changed since it was queued was queued again.
        let Some(&votes) = near[a as usize].get(&b).filter(|votes| votes.net() == net) else {
            continue;
        };
        if !votes.enough(a, b, &rims) {
            pairs.wait(votes, a, b);
            continue;
        }
        let crumb = rims[a as usize].min(rims[b as usize]) < CRUMB;
        if !crumb && facing[a as usize].differs(&facing[b as usize]) {
            pairs.refuse(pair);
            continue;
        }
        sets.unite(a, b);
        let [kept, gone] = [a, b].map(|i| i as usize);
        rims[kept] = (rims[kept] + rims[gone]).saturating_sub(2 * votes.ridges);
        near[kept].remove(&b);
        for (c, votes) in std::mem::take(&mut near[gone]) {
            near[c as usize].remove(&b);
            if c != a {
                for (from, to) in [(a, c), (c, a)] {
                    let sum = near[from as usize].entry(to).or_default();
                    sum.favour += votes.favour;
                    sum.against += votes.against;
                    sum.ridges += votes.ridges;
                }
                pairs.put(near[kept][&c], a, c, &rims);
            }
        }
        let other = facing[gone];
        facing[kept].add(&other);
        pairs.look_again(a, b, &near[kept], &rims);
    }
    sets.numbered()
}

#[cfg(test)]
mod tests {
    use super::super::pairs::FULL;
    use super::*;
    /// Votes of so many ridges for and against, in full weight.
    fn votes(list: &[(u32, u32, usize, usize)]) -> Vec<Vote> {
        let vote = |a, b, favour, against| Vote {
            pieces: [a, b],
            favour,
            against,
        };
        list.iter()
            .flat_map(|&(a, b, yes, no)| {
                let yes = std::iter::repeat_n(vote(a, b, FULL, 0), yes);
                yes.chain(std::iter::repeat_n(vote(a, b, 0, FULL), no))
            })
            .collect()
    }

    /// Pieces that face everywhere.
    fn unknown(count: usize) -> Vec<Facing<3>> {
        vec![Facing([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]); count]
    }

    #[test]
    fn flat_pieces_of_other_planes_stay_apart() {
        let facing = |n: [f64; 3]| Facing(outer(n, n));
        let yes = votes(&[(0, 1, 9, 0)]);
        let count = |n, rim| unite(&[40, rim], vec![facing([1.0, 0.0, 0.0]), facing(n)], &yes).1;
        assert_eq!(count([0.9, 0.436, 0.0], 40), 1);
        assert_eq!(count([0.6, 0.8, 0.0], 40), 2);
        assert_eq!(count([0.6, 0.8, 0.0], 10), 1, "a crumb");
    }

    #[test]
    fn four_quadrants_of_a_crossing_become_two_surfaces() {
        // 0 - 2 and 1 - 3 are straight; a stray ridge joins 0 to 1.
        let list = [
            (0, 2, 9, 0),
            (1, 3, 8, 0),
            (0, 1, 1, 0),
            (0, 1, 0, 8),
            (0, 3, 0, 9),
            (1, 2, 0, 9),
            (2, 3, 0, 9),
        ];
        assert_eq!(
            unite(&[40; 4], unknown(4), &votes(&list)),
            (vec![0, 1, 0, 1], 2)
        );
    }

    #[test]
    fn a_piece_that_continues_two_which_meet_joins_the_better_one() {
        let list = [(0, 1, 9, 0), (0, 2, 6, 0), (1, 2, 0, 5)];
        assert_eq!(
            unite(&[40; 3], unknown(3), &votes(&list)),
            (vec![0, 0, 1], 2)
        );
    }

    /// What [`unite`] says it does, word for word: all pairs are looked at again after each union.
    fn plainly(rims: &[u32], facing: Vec<Facing<3>>, votes: &[Vote]) -> (Vec<u32>, usize) {
        let (mut rims, mut facing, mut sets) = (rims.to_vec(), facing, Sets::new(rims.len()));
        let mut sums: BTreeMap<(u32, u32), Sum> = BTreeMap::new();
        for vote in votes {
            let sum = sums.entry(vote.pieces.into()).or_default();
            sum.favour += vote.favour;
            sum.against += vote.against;
            sum.ridges += u32::from(vote.favour > 0);
        }
        loop {
            let may = |(&(a, b), &sum): (&(u32, u32), &Sum)| {
                let [p, q] = [a, b].map(|i| i as usize);
                let small = rims[p].min(rims[q]);
                let enough = ENOUGH.min(small.div_ceil(4)).max(small.div_ceil(10)).max(1);
                let apart = small >= CRUMB && facing[p].differs(&facing[q]);
                (sum.ridges >= enough && sum.net() >= 0 && !apart)
                    .then_some((sum.net(), Reverse((a, b))))
            };
            let Some((_, Reverse((a, b)))) = sums.iter().filter_map(may).max() else {
                return sets.numbered();
            };
            sets.unite(a, b);
            let [kept, gone] = [a, b].map(|i| i as usize);
            let votes = sums.remove(&(a, b)).unwrap_or_default();
            for ((p, q), votes) in std::mem::take(&mut sums) {
                let [p, q] = [p, q].map(|i| if i == b { a } else { i });
                let sum = sums.entry((p.min(q), p.max(q))).or_default();
                sum.favour += votes.favour;
                sum.against += votes.against;
                sum.ridges += votes.ridges;
            }
            let other = facing[gone];
            facing[kept].add(&other);
            rims[kept] = (rims[kept] + rims[gone]).saturating_sub(2 * votes.ridges);
        }
    }

    #[test]
    fn no_pair_is_forgotten_however_surfaces_grow() {
        let mut state = 5u32;
        let mut random = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        let mut united = 0;
        for round in 0..300 {
            let count = 30 + random(20);
            let rims: Vec<u32> = (0..count).map(|_| 1 + random(60)).collect();
            let facing: Vec<Facing<3>> = (0..count)
                .map(|_| {
                    let n: [f64; 3] = std::array::from_fn(|_| f64::from(random(3)));
                    let round = f64::from(random(2));
                    let mut all = outer(n, n);
                    (0..3).for_each(|k| all[k][k] += round);
                    Facing(all)
                })
                .collect();
            let votes: Vec<Vote> = (0..6 * count)
                .filter_map(|_| {
                    let (a, b) = (random(count), random(1 + round % 40).min(count - 1));
                    let against = random(4) == 0;
                    (a != b).then_some(Vote {
                        pieces: [a.min(b), a.max(b)],
                        favour: if against { 0 } else { 1 + random(FULL) },
                        against: if against { FULL / 2 } else { 0 },
                    })
                })
                .collect();
            let got = unite(&rims, facing.clone(), &votes);
            assert_eq!(got, plainly(&rims, facing, &votes), "{round}");
            united += count as usize - got.1;
        }
        assert!(united > 1000, "{united}");
    }

    #[test]
    fn large_pieces_need_more_than_a_ridge_and_crumbs_do_not() {
        let one = votes(&[(0, 1, 1, 0)]);
        assert_eq!(unite(&[40, 40], unknown(2), &one).1, 2);
        assert_eq!(unite(&[40, 3], unknown(2), &one).1, 1);
    }
}
