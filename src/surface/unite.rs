//! From pieces and votes to surfaces.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use super::facets::Sets;
use super::pairs::{FULL, Vote};

/// Ridges, in full weight, without which only crumbs are united.
const ENOUGH: u32 = 3;
/// A piece whose rim has fewer ridges is a crumb.
const CRUMB: u32 = 16;

/// Unites pieces that continue each other, best founded first, and gives the surface of each piece
/// and the number of surfaces.
///
/// Two surfaces become one if ridges of twice the weight speak for it as against it, and enough do:
/// three in full weight, and a tenth of the smaller one's rim, lest a stray neck join two faults; an
/// eighth of the rim of a crumb. `rims` is the length of each piece's rim in ridges.
///
/// What is against two pieces is against the surfaces that they become part of: so two faults that
/// cross stay two, though a third piece continues both.
pub fn unite(rims: &[u32], votes: &[Vote]) -> (Vec<u32>, usize) {
    let mut rims = rims.to_vec();
    let mut sets = Sets::new(rims.len());
    let mut near: Vec<BTreeMap<u32, [u32; 2]>> = vec![BTreeMap::new(); rims.len()];
    for vote in votes {
        let [a, b] = vote.pieces;
        for (from, to) in [(a, b), (b, a)] {
            let sum = near[from as usize].entry(to).or_default();
            sum[0] += vote.favour;
            sum[1] += vote.against;
        }
    }
    let rank = |[for_it, against]: [u32; 2], a: u32, b: u32, rims: &[u32]| {
        let small = rims[a as usize].min(rims[b as usize]);
        let enough = match small {
            // A crumb has little to say.
            0..CRUMB => 8 * for_it >= small * FULL,
            _ => for_it >= ENOUGH.max(small.div_ceil(10)) * FULL,
        };
        let net = i64::from(for_it) - 2 * i64::from(against);
        (enough && net >= 0).then_some((net, Reverse((a.min(b), a.max(b)))))
    };
    let mut queue: BinaryHeap<_> = (0..rims.len() as u32)
        .flat_map(|a| {
            near[a as usize]
                .range(a + 1..)
                .map(move |(&b, &n)| (a, b, n))
        })
        .filter_map(|(a, b, n)| rank(n, a, b, &rims))
        .collect();
    while let Some((net, Reverse((a, b)))) = queue.pop() {
        let now = near[a as usize].get(&b).copied();
        // What has changed since it was queued was queued again.
        let Some(votes) = now.filter(|&n| rank(n, a, b, &rims) == Some((net, Reverse((a, b)))))
        else {
            continue;
        };
        sets.unite(a, b);
        let [kept, gone] = [a, b].map(|i| i as usize);
        near[kept].remove(&b);
        for (c, votes) in std::mem::take(&mut near[gone]) {
            near[c as usize].remove(&b);
            if c != a {
                for (from, to) in [(a, c), (c, a)] {
                    let sum = near[from as usize].entry(to).or_default();
                    sum[0] += votes[0];
                    sum[1] += votes[1];
                }
            }
        }
        rims[kept] = (rims[kept] + rims[gone]).saturating_sub(2 * votes[0] / FULL);
        let again = near[kept]
            .iter()
            .filter_map(|(&c, &n)| rank(n, a, c, &rims));
        queue.extend(again);
    }
    sets.numbered()
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Votes of so many ridges for and against, in full weight.
    fn votes(list: &[(u32, u32, u32, u32)]) -> Vec<Vote> {
        let vote = |&(a, b, favour, against): &(u32, u32, u32, u32)| Vote {
            pieces: [a, b],
            favour: favour * FULL,
            against: against * FULL,
        };
        list.iter().map(vote).collect()
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
        assert_eq!(unite(&[40; 4], &votes(&list)), (vec![0, 1, 0, 1], 2));
    }

    #[test]
    fn a_piece_that_continues_two_which_meet_joins_the_better_one() {
        let list = [(0, 1, 9, 0), (0, 2, 6, 0), (1, 2, 0, 5)];
        assert_eq!(unite(&[40; 3], &votes(&list)), (vec![0, 0, 1], 2));
    }

    #[test]
    fn large_pieces_need_more_than_a_ridge_and_crumbs_do_not() {
        let one = votes(&[(0, 1, 1, 0)]);
        assert_eq!(unite(&[40, 40], &one).1, 2);
        assert_eq!(unite(&[40, 3], &one).1, 1);
    }
}
