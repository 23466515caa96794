//! From pieces and votes to surfaces.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use super::continuation_votes::Vote;
use super::facets::FacetComplex;
use crate::feature::eigen::{SymmetricMatrix, eigenvalues, eigenvector};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{dot, norm};

/// Ridges without which only crumbs are united.
const MIN_RIDGES: u32 = 4;
/// Pieces with a shorter rim are crumbs.
const MIN_PIECE_RIM: u32 = 4 * MIN_RIDGES;

/// Pieces are flat if so much of their area lies in one plane (the square of its cosine, averaged).
const MIN_FLATNESS: f64 = 0.93;
/// Flat pieces whose planes differ by more (35 degrees) are two surfaces, whatever single ridges say:
/// where two faults cross, detection blurs both, and ridges there lead from one to the other.
const MIN_PLANE_COSINE: f64 = 0.82;

/// Which way a piece faces: the sum over its facets of n nT / |n|, n normal to them and as long as
/// they are large.
#[derive(Debug, Clone, Copy)]
pub struct PieceOrientation<const D: usize>(SymmetricMatrix<D>);

impl<const D: usize> PieceOrientation<D> {
    /// Of each of `count` pieces; `piece` says which each facet belongs to.
    pub fn from_pieces(facets: &FacetComplex<D>, piece: &[u32], count: usize) -> Vec<Self> {
        let mut all = vec![Self([[0.0; D]; D]); count];
        for (f, &p) in piece.iter().enumerate() {
            let n = facets.normal(f);
            let size = norm(n);
            if size > 0.0 {
                all[p as usize].add(&Self(outer_product(n, n.map(|c| c / size))));
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
        (most > MIN_FLATNESS * all).then(|| eigenvector(&self.0, most))
    }

    /// Whether both are flat, and lie in planes that differ.
    fn differs(&self, other: &Self) -> bool {
        match (self.normal(), other.normal()) {
            (Some(m), Some(n)) => dot(m, n).abs() < MIN_PLANE_COSINE,
            _ => false,
        }
    }
}

fn outer_product<const D: usize>(a: [f64; D], b: [f64; D]) -> SymmetricMatrix<D> {
    a.map(|x| b.map(|y| x * y))
}

/// What all ridges between two surfaces say.
#[derive(Debug, Clone, Copy, Default)]
struct VoteSum {
    weight_for: u32,
    weight_against: u32,
    /// How many speak for it.
    ridge_count: u32,
}

impl VoteSum {
    /// By how much what is for it outweighs what is against it.
    fn net_weight(self) -> i64 {
        i64::from(self.weight_for) - 2 * i64::from(self.weight_against)
    }

    /// The longest rim of the smaller surface for which the ridges are enough.
    fn max_rim(self) -> u32 {
        match self.ridge_count {
            few @ 0..MIN_RIDGES => 4 * few,
            many => many.saturating_mul(10),
        }
    }

    /// Whether there are enough ridges to unite surfaces `a` and `b`.
    fn has_enough_ridges(self, a: u32, b: u32, rims: &[u32]) -> bool {
        self.ridge_count > 0 && rims[a as usize].min(rims[b as usize]) <= self.max_rim()
    }
}

/// Two surfaces, the smaller number first, by what speaks for one; the best is the greatest.
type QueuedPair = (i64, Reverse<(u32, u32)>);

/// Pairs of surfaces that may become one.
///
/// A surface that grows may have very many neighbours, so that not all of its pairs can be looked at
/// whenever it grows: only those whose votes have changed, those that its shorter rim lets pass now,
/// and those that were refused for how it faced.
struct PairQueue {
    queue: BinaryHeap<QueuedPair>,
    /// For each surface, its pairs with too few ridges: the length to which a rim must shrink, and the
    /// other surface. What is no more so is found out when its turn comes.
    deferred: Vec<BTreeSet<(u32, u32)>>,
    /// For each surface, others that face elsewhere.
    refused: Vec<BTreeSet<u32>>,
}

impl PairQueue {
    fn new(count: usize) -> Self {
        Self {
            queue: BinaryHeap::new(),
            deferred: vec![BTreeSet::new(); count],
            refused: vec![BTreeSet::new(); count],
        }
    }

    /// Queues a pair, or lets it wait for a shorter rim.
    fn insert(&mut self, votes: VoteSum, a: u32, b: u32, rims: &[u32]) {
        if votes.net_weight() < 0 {
            return;
        }
        if votes.has_enough_ridges(a, b, rims) {
            self.queue
                .push((votes.net_weight(), Reverse((a.min(b), a.max(b)))));
        } else {
            self.defer(votes, a, b);
        }
    }

    fn defer(&mut self, votes: VoteSum, a: u32, b: u32) {
        if votes.ridge_count > 0 {
            self.deferred[a as usize].insert((votes.max_rim(), b));
            self.deferred[b as usize].insert((votes.max_rim(), a));
        }
    }

    fn refuse(&mut self, (_, Reverse((a, b))): QueuedPair) {
        self.refused[a as usize].insert(b);
        self.refused[b as usize].insert(a);
    }

    /// Looks again at the pairs of surface `a`, which surface `b` has become part of.
    fn reconsider(&mut self, a: u32, b: u32, near: &BTreeMap<u32, VoteSum>, rims: &[u32]) {
        // Those of b are pairs of a now, and have been put anew.
        self.deferred[b as usize].clear();
        self.refused[b as usize].clear();
        let mut again = std::mem::take(&mut self.refused[a as usize]);
        let waiting = &mut self.deferred[a as usize];
        while let Some(&(longest, c)) = waiting.last()
            && rims[a as usize] <= longest
        {
            waiting.pop_last();
            again.insert(c);
        }
        for c in again {
            if let Some(&votes) = near.get(&c) {
                self.insert(votes, a, c, rims);
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
pub fn merge_pieces<const D: usize>(
    rims: &[u32],
    facing: Vec<PieceOrientation<D>>,
    votes: &[Vote],
) -> (Vec<u32>, usize) {
    let (mut rims, mut facing) = (rims.to_vec(), facing);
    let mut sets = UnionFind::new(rims.len());
    let mut near: Vec<BTreeMap<u32, VoteSum>> = vec![BTreeMap::new(); rims.len()];
    for vote in votes {
        let [a, b] = vote.pieces;
        for (from, to) in [(a, b), (b, a)] {
            let sum = near[from as usize].entry(to).or_default();
            sum.weight_for += vote.weight_for;
            sum.weight_against += vote.weight_against;
            sum.ridge_count += u32::from(vote.weight_for > 0);
        }
    }
    let mut pairs = PairQueue::new(rims.len());
    for a in 0..rims.len() as u32 {
        for (&b, &sum) in near[a as usize].range(a + 1..) {
            pairs.insert(sum, a, b, &rims);
        }
    }
    while let Some(pair @ (net, Reverse((a, b)))) = pairs.queue.pop() {
        // What has changed since it was queued was queued again.
        let Some(&votes) = near[a as usize]
            .get(&b)
            .filter(|votes| votes.net_weight() == net)
        else {
            continue;
        };
        if !votes.has_enough_ridges(a, b, &rims) {
            pairs.defer(votes, a, b);
            continue;
        }
        let crumb = rims[a as usize].min(rims[b as usize]) < MIN_PIECE_RIM;
        if !crumb && facing[a as usize].differs(&facing[b as usize]) {
            pairs.refuse(pair);
            continue;
        }
        sets.unite(a, b);
        let [kept, gone] = [a, b].map(|i| i as usize);
        rims[kept] = (rims[kept] + rims[gone]).saturating_sub(2 * votes.ridge_count);
        near[kept].remove(&b);
        for (c, votes) in std::mem::take(&mut near[gone]) {
            near[c as usize].remove(&b);
            if c != a {
                for (from, to) in [(a, c), (c, a)] {
                    let sum = near[from as usize].entry(to).or_default();
                    sum.weight_for += votes.weight_for;
                    sum.weight_against += votes.weight_against;
                    sum.ridge_count += votes.ridge_count;
                }
                pairs.insert(near[kept][&c], a, c, &rims);
            }
        }
        let other = facing[gone];
        facing[kept].add(&other);
        pairs.reconsider(a, b, &near[kept], &rims);
    }
    sets.into_labels()
}

#[cfg(test)]
mod tests {
    use super::super::continuation_votes::FULL_WEIGHT;
    use super::*;
    /// Votes of so many ridges for and against, in full weight.
    fn votes(list: &[(u32, u32, usize, usize)]) -> Vec<Vote> {
        let vote = |a, b, favour, against| Vote {
            pieces: [a, b],
            weight_for: favour,
            weight_against: against,
        };
        list.iter()
            .flat_map(|&(a, b, yes, no)| {
                let yes = std::iter::repeat_n(vote(a, b, FULL_WEIGHT, 0), yes);
                yes.chain(std::iter::repeat_n(vote(a, b, 0, FULL_WEIGHT), no))
            })
            .collect()
    }

    /// Pieces that face everywhere.
    fn unknown_orientations(count: usize) -> Vec<PieceOrientation<3>> {
        vec![PieceOrientation([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]); count]
    }

    #[test]
    fn flat_pieces_of_other_planes_stay_apart() {
        let facing = |n: [f64; 3]| PieceOrientation(outer_product(n, n));
        let yes = votes(&[(0, 1, 9, 0)]);
        let count =
            |n, rim| merge_pieces(&[40, rim], vec![facing([1.0, 0.0, 0.0]), facing(n)], &yes).1;
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
            merge_pieces(&[40; 4], unknown_orientations(4), &votes(&list)),
            (vec![0, 1, 0, 1], 2)
        );
    }

    #[test]
    fn a_piece_that_continues_two_which_meet_joins_the_better_one() {
        let list = [(0, 1, 9, 0), (0, 2, 6, 0), (1, 2, 0, 5)];
        assert_eq!(
            merge_pieces(&[40; 3], unknown_orientations(3), &votes(&list)),
            (vec![0, 0, 1], 2)
        );
    }

    /// What [`unite`] says it does, word for word: all pairs are looked at again after each union.
    fn merge_naively(
        rims: &[u32],
        facing: Vec<PieceOrientation<3>>,
        votes: &[Vote],
    ) -> (Vec<u32>, usize) {
        let (mut rims, mut facing, mut sets) = (rims.to_vec(), facing, UnionFind::new(rims.len()));
        let mut sums: BTreeMap<(u32, u32), VoteSum> = BTreeMap::new();
        for vote in votes {
            let sum = sums.entry(vote.pieces.into()).or_default();
            sum.weight_for += vote.weight_for;
            sum.weight_against += vote.weight_against;
            sum.ridge_count += u32::from(vote.weight_for > 0);
        }
        loop {
            let may = |(&(a, b), &sum): (&(u32, u32), &VoteSum)| {
                let [p, q] = [a, b].map(|i| i as usize);
                let small = rims[p].min(rims[q]);
                let enough = MIN_RIDGES
                    .min(small.div_ceil(4))
                    .max(small.div_ceil(10))
                    .max(1);
                let apart = small >= MIN_PIECE_RIM && facing[p].differs(&facing[q]);
                (sum.ridge_count >= enough && sum.net_weight() >= 0 && !apart)
                    .then_some((sum.net_weight(), Reverse((a, b))))
            };
            let Some((_, Reverse((a, b)))) = sums.iter().filter_map(may).max() else {
                return sets.into_labels();
            };
            sets.unite(a, b);
            let [kept, gone] = [a, b].map(|i| i as usize);
            let votes = sums.remove(&(a, b)).unwrap_or_default();
            for ((p, q), votes) in std::mem::take(&mut sums) {
                let [p, q] = [p, q].map(|i| if i == b { a } else { i });
                let sum = sums.entry((p.min(q), p.max(q))).or_default();
                sum.weight_for += votes.weight_for;
                sum.weight_against += votes.weight_against;
                sum.ridge_count += votes.ridge_count;
            }
            let other = facing[gone];
            facing[kept].add(&other);
            rims[kept] = (rims[kept] + rims[gone]).saturating_sub(2 * votes.ridge_count);
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
            let facing: Vec<PieceOrientation<3>> = (0..count)
                .map(|_| {
                    let n: [f64; 3] = std::array::from_fn(|_| f64::from(random(3)));
                    let round = f64::from(random(2));
                    let mut all = outer_product(n, n);
                    (0..3).for_each(|k| all[k][k] += round);
                    PieceOrientation(all)
                })
                .collect();
            let votes: Vec<Vote> = (0..6 * count)
                .filter_map(|_| {
                    let (a, b) = (random(count), random(1 + round % 40).min(count - 1));
                    let against = random(4) == 0;
                    (a != b).then_some(Vote {
                        pieces: [a.min(b), a.max(b)],
                        weight_for: if against { 0 } else { 1 + random(FULL_WEIGHT) },
                        weight_against: if against { FULL_WEIGHT / 2 } else { 0 },
                    })
                })
                .collect();
            let got = merge_pieces(&rims, facing.clone(), &votes);
            assert_eq!(got, merge_naively(&rims, facing, &votes), "{round}");
            united += count as usize - got.1;
        }
        assert!(united > 1000, "{united}");
    }

    #[test]
    fn large_pieces_need_more_than_a_ridge_and_crumbs_do_not() {
        let one = votes(&[(0, 1, 1, 0)]);
        assert_eq!(merge_pieces(&[40, 40], unknown_orientations(2), &one).1, 2);
        assert_eq!(merge_pieces(&[40, 3], unknown_orientations(2), &one).1, 1);
    }
}
