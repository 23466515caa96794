//! Merges pieces into surfaces by their votes.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use super::continuation_votes::Vote;
use super::facets::FacetComplex;
use crate::geometry::eigen::{SymmetricMatrix, eigenvalues, eigenvector};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{dot, norm};

/// Smallest number of ridges that can unite two surfaces which are not fragments.
const MIN_RIDGES: u32 = 4;
/// Pieces whose rim is shorter than this number of ridges are fragments.
const MIN_PIECE_RIM: u32 = 4 * MIN_RIDGES;

/// Smallest flatness of a flat piece: the mean squared cosine between its facets' normals and its
/// plane's normal, weighted by area.
const MIN_FLATNESS: f64 = 0.93;
/// Smallest cosine between the planes of two flat pieces of one surface (35 degrees), whatever
/// single ridges say. Where two faults cross, detection blurs both, and ridges lead from one to the
/// other.
const MIN_PLANE_COSINE: f64 = 0.82;

/// The orientation of a piece: the sum over its facets of n n^T / |n|, where n is the facet's
/// normal with the length of its area.
#[derive(Debug, Clone, Copy)]
pub struct PieceOrientation<const D: usize>(SymmetricMatrix<D>);

impl<const D: usize> PieceOrientation<D> {
    /// Returns the orientation of each of `count` pieces. `piece` holds the piece of each facet.
    pub fn from_pieces(facets: &FacetComplex<D>, piece: &[u32], count: usize) -> Vec<Self> {
        let mut orientations = vec![Self([[0.0; D]; D]); count];
        for (f, &p) in piece.iter().enumerate() {
            let n = facets.normal(f);
            let size = norm(n);
            if size > 0.0 {
                orientations[p as usize].add(&Self(outer_product(n, n.map(|c| c / size))));
            }
        }
        orientations
    }

    fn add(&mut self, other: &Self) {
        for (row, other_row) in self.0.iter_mut().zip(&other.0) {
            for (a, b) in row.iter_mut().zip(other_row) {
                *a += b;
            }
        }
    }

    /// Returns the normal of the piece if it is flat.
    fn normal(&self) -> Option<[f64; D]> {
        let trace: f64 = (0..D).map(|k| self.0[k][k]).sum();
        let values = eigenvalues(&self.0);
        let max_eigenvalue = values.iter().copied().fold(0.0, f64::max);
        (max_eigenvalue > MIN_FLATNESS * trace).then(|| eigenvector(&self.0, max_eigenvalue))
    }

    /// Returns `true` if both pieces are flat and lie in different planes.
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

/// The sum of all votes on two surfaces.
#[derive(Debug, Clone, Copy, Default)]
struct VoteSum {
    weight_for: u32,
    weight_against: u32,
    /// Number of votes for one surface.
    ridge_count: u32,
}

impl VoteSum {
    /// Returns the weight for one surface minus twice the weight against it.
    fn net_weight(self) -> i64 {
        i64::from(self.weight_for) - 2 * i64::from(self.weight_against)
    }

    /// Returns the longest rim of the smaller surface for which the number of ridges is enough.
    fn max_rim(self) -> u32 {
        match self.ridge_count {
            few @ 0..MIN_RIDGES => 4 * few,
            many => many.saturating_mul(10),
        }
    }

    /// Returns `true` if there are enough ridges to unite surfaces `a` and `b`.
    fn has_enough_ridges(self, a: u32, b: u32, rims: &[u32]) -> bool {
        self.ridge_count > 0 && rims[a as usize].min(rims[b as usize]) <= self.max_rim()
    }
}

/// Two surfaces, the smaller number first, with their net weight. The best pair is the greatest.
type QueuedPair = (i64, Reverse<(u32, u32)>);

/// Pairs of surfaces that may be united.
///
/// A surface that grows may have very many neighbours, so not all of its pairs can be checked each
/// time. The queue only checks pairs whose votes have changed, pairs whose shorter rim has become
/// short enough, and pairs that were refused because of their orientation.
struct PairQueue {
    queue: BinaryHeap<QueuedPair>,
    /// For each surface, its pairs with too few ridges: the rim length to which the shorter rim
    /// must shrink, and the other surface. Outdated entries are detected when their turn comes.
    deferred: Vec<BTreeSet<(u32, u32)>>,
    /// For each surface, the surfaces that were refused because of their orientation.
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

    /// Queues a pair, or defers it until a rim is shorter.
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

    /// Checks the pairs of surface `a` again after surface `b` was merged into it.
    fn reconsider(
        &mut self,
        a: u32,
        b: u32,
        neighbour_votes: &BTreeMap<u32, VoteSum>,
        rims: &[u32],
    ) {
        // The pairs of b are pairs of a now and have been inserted again.
        self.deferred[b as usize].clear();
        self.refused[b as usize].clear();
        let mut candidates = std::mem::take(&mut self.refused[a as usize]);
        let deferred = &mut self.deferred[a as usize];
        while let Some(&(max_rim, c)) = deferred.last()
            && rims[a as usize] <= max_rim
        {
            deferred.pop_last();
            candidates.insert(c);
        }
        for c in candidates {
            if let Some(&votes) = neighbour_votes.get(&c) {
                self.insert(votes, a, c, rims);
            }
        }
    }
}

/// Unites pieces that continue each other, those with the largest net weight first. Returns the
/// surface of each piece and the number of surfaces.
///
/// Two surfaces are united if the weight for it is at least twice that against it, and if enough
/// ridges are for it. Enough means at least four ridges (for a fragment with fewer than 16 ridges
/// at its rim, a quarter of these), and a tenth of the smaller surface's rim, so that a narrow neck
/// does not join two faults. `rims` is the length of each piece's rim in ridges.
///
/// Flat pieces with different `orientations` are not united, unless one is a fragment.
///
/// Votes against two pieces also count against the surfaces that contain them. So two faults that
/// cross stay two surfaces, even if a third piece continues both.
pub fn merge_pieces<const D: usize>(
    rims: &[u32],
    orientations: Vec<PieceOrientation<D>>,
    votes: &[Vote],
) -> (Vec<u32>, usize) {
    let (mut rims, mut orientations) = (rims.to_vec(), orientations);
    let mut sets = UnionFind::new(rims.len());
    let mut neighbour_votes: Vec<BTreeMap<u32, VoteSum>> = vec![BTreeMap::new(); rims.len()];
    for vote in votes {
        let [a, b] = vote.pieces;
        for (surface, other) in [(a, b), (b, a)] {
            let sum = neighbour_votes[surface as usize].entry(other).or_default();
            sum.weight_for += vote.weight_for;
            sum.weight_against += vote.weight_against;
            sum.ridge_count += u32::from(vote.weight_for > 0);
        }
    }
    let mut pairs = PairQueue::new(rims.len());
    for a in 0..rims.len() as u32 {
        for (&b, &sum) in neighbour_votes[a as usize].range(a + 1..) {
            pairs.insert(sum, a, b, &rims);
        }
    }
    while let Some(pair @ (net, Reverse((a, b)))) = pairs.queue.pop() {
        // If the votes have changed since then, the pair was queued again.
        let Some(&votes) = neighbour_votes[a as usize]
            .get(&b)
            .filter(|votes| votes.net_weight() == net)
        else {
            continue;
        };
        if !votes.has_enough_ridges(a, b, &rims) {
            pairs.defer(votes, a, b);
            continue;
        }
        let is_fragment = rims[a as usize].min(rims[b as usize]) < MIN_PIECE_RIM;
        if !is_fragment && orientations[a as usize].differs(&orientations[b as usize]) {
            pairs.refuse(pair);
            continue;
        }
        sets.unite(a, b);
        let [kept, removed] = [a, b].map(|i| i as usize);
        rims[kept] = (rims[kept] + rims[removed]).saturating_sub(2 * votes.ridge_count);
        neighbour_votes[kept].remove(&b);
        for (c, votes) in std::mem::take(&mut neighbour_votes[removed]) {
            neighbour_votes[c as usize].remove(&b);
            if c != a {
                for (surface, other) in [(a, c), (c, a)] {
                    let sum = neighbour_votes[surface as usize].entry(other).or_default();
                    sum.weight_for += votes.weight_for;
                    sum.weight_against += votes.weight_against;
                    sum.ridge_count += votes.ridge_count;
                }
                pairs.insert(neighbour_votes[kept][&c], a, c, &rims);
            }
        }
        let orientation = orientations[removed];
        orientations[kept].add(&orientation);
        pairs.reconsider(a, b, &neighbour_votes[kept], &rims);
    }
    sets.into_labels()
}

#[cfg(test)]
mod tests {
    use super::super::continuation_votes::FULL_WEIGHT;
    use super::*;
    /// Returns votes with full weight; `list` holds two pieces and the numbers of ridges for and
    /// against uniting them.
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

    /// Returns the orientations of pieces that are not flat.
    fn unknown_orientations(count: usize) -> Vec<PieceOrientation<3>> {
        vec![PieceOrientation([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]); count]
    }

    #[test]
    fn flat_pieces_in_different_planes_stay_separate() {
        let orientation = |n: [f64; 3]| PieceOrientation(outer_product(n, n));
        let votes_for = votes(&[(0, 1, 9, 0)]);
        let count = |n, rim| {
            merge_pieces(
                &[40, rim],
                vec![orientation([1.0, 0.0, 0.0]), orientation(n)],
                &votes_for,
            )
            .1
        };
        assert_eq!(count([0.9, 0.436, 0.0], 40), 1);
        assert_eq!(count([0.6, 0.8, 0.0], 40), 2);
        assert_eq!(count([0.6, 0.8, 0.0], 10), 1, "a fragment");
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
    fn a_piece_that_continues_two_surfaces_joins_the_better_one() {
        let list = [(0, 1, 9, 0), (0, 2, 6, 0), (1, 2, 0, 5)];
        assert_eq!(
            merge_pieces(&[40; 3], unknown_orientations(3), &votes(&list)),
            (vec![0, 0, 1], 2)
        );
    }

    /// Implements the rules of [`merge_pieces`] directly: checks all pairs again after each union.
    fn merge_naively(
        rims: &[u32],
        orientations: Vec<PieceOrientation<3>>,
        votes: &[Vote],
    ) -> (Vec<u32>, usize) {
        let (mut rims, mut orientations, mut sets) =
            (rims.to_vec(), orientations, UnionFind::new(rims.len()));
        let mut sums: BTreeMap<(u32, u32), VoteSum> = BTreeMap::new();
        for vote in votes {
            let sum = sums.entry(vote.pieces.into()).or_default();
            sum.weight_for += vote.weight_for;
            sum.weight_against += vote.weight_against;
            sum.ridge_count += u32::from(vote.weight_for > 0);
        }
        loop {
            let candidate = |(&(a, b), &sum): (&(u32, u32), &VoteSum)| {
                let [p, q] = [a, b].map(|i| i as usize);
                let min_rim = rims[p].min(rims[q]);
                let min_ridges = MIN_RIDGES
                    .min(min_rim.div_ceil(4))
                    .max(min_rim.div_ceil(10))
                    .max(1);
                let is_separate =
                    min_rim >= MIN_PIECE_RIM && orientations[p].differs(&orientations[q]);
                (sum.ridge_count >= min_ridges && sum.net_weight() >= 0 && !is_separate)
                    .then_some((sum.net_weight(), Reverse((a, b))))
            };
            let Some((_, Reverse((a, b)))) = sums.iter().filter_map(candidate).max() else {
                return sets.into_labels();
            };
            sets.unite(a, b);
            let [kept, removed] = [a, b].map(|i| i as usize);
            let votes = sums.remove(&(a, b)).unwrap_or_default();
            for ((p, q), votes) in std::mem::take(&mut sums) {
                let [p, q] = [p, q].map(|i| if i == b { a } else { i });
                let sum = sums.entry((p.min(q), p.max(q))).or_default();
                sum.weight_for += votes.weight_for;
                sum.weight_against += votes.weight_against;
                sum.ridge_count += votes.ridge_count;
            }
            let orientation = orientations[removed];
            orientations[kept].add(&orientation);
            rims[kept] = (rims[kept] + rims[removed]).saturating_sub(2 * votes.ridge_count);
        }
    }

    #[test]
    fn the_queue_agrees_with_a_naive_merge() {
        let mut state = 5u32;
        let mut random = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        let mut merged_count = 0;
        for round in 0..300 {
            let count = 30 + random(20);
            let rims: Vec<u32> = (0..count).map(|_| 1 + random(60)).collect();
            let orientations: Vec<PieceOrientation<3>> = (0..count)
                .map(|_| {
                    let n: [f64; 3] = std::array::from_fn(|_| f64::from(random(3)));
                    let isotropic = f64::from(random(2));
                    let mut matrix = outer_product(n, n);
                    (0..3).for_each(|k| matrix[k][k] += isotropic);
                    PieceOrientation(matrix)
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
            let merged = merge_pieces(&rims, orientations.clone(), &votes);
            assert_eq!(
                merged,
                merge_naively(&rims, orientations, &votes),
                "{round}"
            );
            merged_count += count as usize - merged.1;
        }
        assert!(merged_count > 1000, "{merged_count}");
    }

    #[test]
    fn large_pieces_need_more_than_a_ridge_and_fragments_do_not() {
        let single_vote = votes(&[(0, 1, 1, 0)]);
        assert_eq!(
            merge_pieces(&[40, 40], unknown_orientations(2), &single_vote).1,
            2
        );
        assert_eq!(
            merge_pieces(&[40, 3], unknown_orientations(2), &single_vote).1,
            1
        );
    }
}
