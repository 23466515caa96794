//! Candidates in slabs: each rank has those of some layers along the last axis, its *own*, and of as many layers to
//! either side as what is done with them sees, its *halo*.
//!
//! What a rank has is one run of all candidates, which are in the order of samples: so a place in it, and the place
//! of its first among all, say which candidate is meant.

use super::candidate::Candidate;
use super::windows::layer_len;
use crate::comm::selection::{RadixKey, order_statistics};
use crate::comm::{Comm, concatenate, partition_range};
use crate::error::Result;
use crate::files::codec::Codec;
use std::ops::Range;

/// A rank's candidates.
pub struct CandidateSlab<'g, const D: usize> {
    /// Samples of the volume along each axis.
    pub dims: [usize; D],
    /// Its own and the halo's, in the order of samples.
    pub candidates: Vec<Candidate<D>>,
    /// Which are its own.
    pub owned: Range<usize>,
    /// Of the candidates of all ranks, the first that it has.
    first_index: usize,
    /// The layers that each rank sees: its own and its halo; none if it has none of its own.
    visible_layers: Vec<Range<usize>>,
    /// Own layers, and those that no other rank sees.
    owned_layers: Range<usize>,
    inner_layers: Range<usize>,
    comm: &'g dyn Comm,
}

impl<'g, const D: usize> CandidateSlab<'g, D> {
    /// Of these candidates, in the order of samples: of all those of these layers, which are this rank's share and
    /// come after the ranks' before it; or if there are none said, of all. The halo has so many layers.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn new(
        dims: [usize; D],
        candidates: Vec<Candidate<D>>,
        layers: Option<Range<usize>>,
        halo: usize,
        group: &'g dyn Comm,
    ) -> Result<Self> {
        let (rank, count) = (group.rank(), group.size());
        let (layers, candidates) = match layers {
            Some(layers) => (layers, candidates),
            None => {
                let layers = partition_range(dims[D - 1], rank, count);
                let own = candidates_in_layers(dims, candidates, &layers);
                (layers, own)
            }
        };
        let own = [layers.start, layers.end, candidates.len()];
        let all = group.all_gather("layers of candidates", own)?;
        let wide = |&[start, end, _]: &[usize; 3]| match start < end {
            true => start.saturating_sub(halo)..(end + halo).min(dims[D - 1]),
            false => 0..0,
        };
        let seen: Vec<Range<usize>> = all.iter().map(wide).collect();
        let part = |(to, seen): (usize, &Range<usize>)| match to == rank {
            true => Vec::new(),
            false => candidates[range_in_layers(dims, &candidates, seen)].to_vec(),
        };
        let parts = seen.iter().enumerate().map(part).collect();
        let mut parts: Vec<Vec<Candidate<D>>> = group.all_to_all("candidates beside", parts)?;
        let lower: usize = parts[..rank].iter().map(Vec::len).sum();
        let before: usize = all[..rank].iter().map(|[.., count]| count).sum();
        let own = lower..lower + candidates.len();
        parts[rank] = candidates;
        let others = |ranks: Range<usize>| seen[ranks].iter().filter(|seen| !seen.is_empty());
        let low = others(0..rank).map(|seen| seen.end).max();
        let high = others(rank + 1..count).map(|seen| seen.start).min();
        let inner = layers.start.max(low.unwrap_or(0))..layers.end.min(high.unwrap_or(layers.end));
        Ok(Self {
            dims,
            candidates: concatenate(parts),
            owned: own,
            first_index: before - lower,
            visible_layers: seen,
            owned_layers: layers,
            inner_layers: inner,
            comm: group,
        })
    }

    /// Of candidates in the order of samples, those of this rank's own layers.
    pub fn owned_candidates(&self, candidates: Vec<Candidate<D>>) -> Vec<Candidate<D>> {
        candidates_in_layers(self.dims, candidates, &self.owned_layers)
    }

    /// What its own candidates have, and those of the halo, of which other ranks tell.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn with_halo<T: Codec + Clone>(&self, what: &str, own: Vec<T>) -> Result<Vec<T>> {
        let before = |at: usize| count_before_layer(self.dims, &self.candidates, at);
        Ok(self.layers_with_halo(what, own, before)?.0)
    }

    /// What its own layers have, and those of the halo, of which other ranks tell, if there are so many `before` each layer
    /// in all; and how many there are before what it has then.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn layers_with_halo<T: Codec + Clone>(
        &self,
        what: &str,
        own: Vec<T>,
        before: impl Fn(usize) -> usize,
    ) -> Result<(Vec<T>, usize)> {
        let rank = self.comm.rank();
        let part = |(to, seen): (usize, &Range<usize>)| {
            let both = seen.start.max(self.owned_layers.start)..seen.end.min(self.owned_layers.end);
            if to == rank || both.is_empty() {
                return Vec::new();
            }
            let first = before(self.owned_layers.start);
            own[before(both.start) - first..before(both.end) - first].to_vec()
        };
        let parts = self.visible_layers.iter().enumerate().map(part).collect();
        let mut parts = self.comm.all_to_all(what, parts)?;
        parts[rank] = own;
        Ok((concatenate(parts), before(self.visible_layers[rank].start)))
    }

    /// Sums over the own candidates of all ranks, of those that have something, layer by layer: so they are the same
    /// for any number of ranks.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn sums_by_layer<const N: usize>(
        &self,
        what: &str,
        of: impl Fn(usize) -> Option<[f64; N]>,
    ) -> Result<[f64; N]> {
        let mut layers: Vec<[f64; N]> = Vec::new();
        let mut last = None;
        for i in self.owned.clone() {
            let Some(values) = of(i) else { continue };
            let at = Some(self.layer_of(i));
            if last != at {
                layers.push([0.0; N]);
                last = at;
            }
            if let Some(sums) = layers.last_mut() {
                *sums = std::array::from_fn(|k| sums[k] + values[k]);
            }
        }
        let all = self.comm.all_gather(what, layers)?.into_iter().flatten();
        Ok(all.fold([0.0; N], |sums, layer| {
            std::array::from_fn(|k| sums[k] + layer[k])
        }))
    }

    /// Own layers.
    pub fn owned_layers(&self) -> &Range<usize> {
        &self.owned_layers
    }

    /// Those who have the others.
    pub fn comm(&self) -> &'g dyn Comm {
        self.comm
    }

    /// The number of a candidate among those of all ranks.
    pub fn global_index(&self, i: usize) -> usize {
        self.first_index + i
    }

    /// The layer of a candidate.
    fn layer_of(&self, i: usize) -> usize {
        self.candidates[i].voxel.index() / layer_len(self.dims).max(1)
    }

    /// Whether no other rank sees this own candidate.
    pub fn is_inner(&self, i: usize) -> bool {
        self.comm.size() == 1 || self.inner_layers.contains(&self.layer_of(i))
    }

    /// Whether all samples round that of an own candidate are this rank's own.
    pub fn owns_neighbours(&self, i: usize) -> bool {
        let (at, own, count) = (self.layer_of(i), &self.owned_layers, self.dims[D - 1]);
        (at == 0 || own.contains(&(at - 1))) && (at + 1 == count || own.contains(&(at + 1)))
    }

    /// Tells the ranks that see them that these own candidates are meant; those of the halo that the others mean,
    /// unless no rank means any.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn exchange_marks(&self, what: &str, own: &[usize]) -> Result<Option<Vec<usize>>> {
        let some: Vec<bool> = self.comm.all_gather(what, !own.is_empty())?;
        if !some.contains(&true) {
            return Ok(None);
        }
        let mut to = vec![Vec::new(); self.comm.size()];
        let outer = own.iter().copied().filter(|&i| !self.is_inner(i));
        for i in outer {
            let at = self.layer_of(i);
            for (rank, seen) in self.visible_layers.iter().enumerate() {
                if rank != self.comm.rank() && seen.contains(&at) {
                    to[rank].push(self.global_index(i));
                }
            }
        }
        let told = self.comm.all_to_all(what, to)?;
        Ok(Some(
            (told
                .into_iter()
                .flatten()
                .map(|number| number - self.first_index))
            .collect(),
        ))
    }

    /// Sums over all ranks.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn global_sums<const N: usize>(&self, what: &str, own: [u64; N]) -> Result<[u64; N]> {
        let all: Vec<[u64; N]> = self.comm.all_gather(what, own)?;
        Ok(std::array::from_fn(|k| all.iter().map(|one| one[k]).sum()))
    }
}

/// Which of candidates in the order of samples are of these layers.
fn range_in_layers<const D: usize>(
    dims: [usize; D],
    candidates: &[Candidate<D>],
    layers: &Range<usize>,
) -> Range<usize> {
    let before = |at| count_before_layer(dims, candidates, at);
    match layers.is_empty() {
        true => 0..0,
        false => before(layers.start)..before(layers.end),
    }
}

/// How many of candidates in the order of samples come before a layer.
fn count_before_layer<const D: usize>(
    dims: [usize; D],
    candidates: &[Candidate<D>],
    at: usize,
) -> usize {
    let first = at * layer_len(dims);
    candidates.partition_point(|c| c.voxel.index() < first)
}

/// Of candidates in the order of samples, those of these layers.
fn candidates_in_layers<const D: usize>(
    dims: [usize; D],
    mut candidates: Vec<Candidate<D>>,
    layers: &Range<usize>,
) -> Vec<Candidate<D>> {
    let own = range_in_layers(dims, &candidates, layers);
    candidates.truncate(own.end);
    candidates.drain(..own.start);
    candidates
}

/// Of the values of a group, the one of a rank (0: the least) among all, in the total order; `None` if there is none.
/// `rank_of` is told how many there are.
///
/// # Errors
/// Those of the others.
pub fn select_nth<V: RadixKey + Send + Sync>(
    what: &str,
    mut own: Vec<V>,
    rank_of: impl Fn(usize) -> usize,
    group: &dyn Comm,
) -> Result<Option<f64>> {
    let count: usize = group.all_gather(what, own.len())?.iter().sum();
    if count == 0 {
        return Ok(None);
    }
    let rank = rank_of(count).min(count - 1);
    if group.size() == 1 {
        let found = own
            .select_nth_unstable_by_key(rank, |value| value.to_key())
            .1;
        return Ok(Some(V::from_key(found.to_key())));
    }
    let found = order_statistics(&[own.iter().copied()], &[|_| [rank]], group)?;
    Ok(found.into_iter().flatten().next())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{SelfComm, run_threads};

    /// Candidates here and there: none in every fifth layer.
    fn random_candidates(dims: [usize; 3]) -> Vec<Candidate<3>> {
        let place = |n: usize| [n * 7 % dims[0], n * 5 % dims[1], n * 3 % dims[2]];
        let mut all: Vec<Candidate<3>> = (0..300)
            .map(place)
            .filter(|at| at[2] % 5 != 0)
            .map(|at| Candidate::new(dims, at, 0, 0.0, [1.0, 0.0, 0.0], 1.0))
            .collect();
        all.sort_by_key(|c| c.voxel);
        all
    }

    #[test]
    fn the_value_of_a_rank_is_found_among_those_of_all() {
        let mut all = vec![
            3.5,
            -1.0,
            0.0,
            -0.0,
            7.25,
            f64::MIN_POSITIVE,
            3.5,
            -8.5,
            1e300,
        ];
        for count in [1, 2, 4, 11] {
            for rank in 0..=all.len() {
                let found = run_threads(count, |group| {
                    let own = partition_range(all.len(), group.rank(), count);
                    let rank_of = |number: usize| {
                        assert_eq!(number, all.len());
                        rank
                    };
                    select_nth("values", all[own].to_vec(), rank_of, group).unwrap()
                });
                let mut sorted = all.clone();
                sorted.sort_by(f64::total_cmp);
                let wanted = sorted[rank.min(all.len() - 1)];
                let is_it =
                    |found: Option<f64>| found.is_some_and(|f| f.to_bits() == wanted.to_bits());
                assert!(found.into_iter().all(is_it), "{count} {rank}");
            }
        }
        all.clear();
        let none = run_threads(2, |group| {
            select_nth("values", Vec::<f64>::new(), |n| n, group).unwrap()
        });
        assert_eq!(none, [None, None]);
    }

    #[test]
    fn each_rank_has_its_own_and_those_beside_it_and_says_which_it_means() {
        let dims = [11, 9, 23];
        let all = random_candidates(dims);
        let area = dims[0] * dims[1];
        for (count, halo) in [(1, 4), (2, 3), (3, 9), (5, 2), (30, 6)] {
            let seen = run_threads(count, |group| {
                let own = partition_range(dims[2], group.rank(), count);
                let of_own = |c: &&Candidate<3>| own.contains(&(c.voxel.index() / area));
                let given = all.iter().filter(of_own).copied().collect();
                let cut = CandidateSlab::new(dims, all.clone(), None, halo, group).unwrap();
                let slab = CandidateSlab::new(dims, given, Some(own.clone()), halo, group).unwrap();
                assert_eq!(slab.candidates.len(), cut.candidates.len());
                assert!(
                    own.is_empty()
                        || (slab.first_index, &slab.owned) == (cut.first_index, &cut.owned)
                );
                let wide = own.start.saturating_sub(halo)..own.end + halo;
                for (i, c) in slab.candidates.iter().enumerate() {
                    assert_eq!(c.voxel, all[slab.global_index(i)].voxel);
                    let at = c.voxel.index() / area;
                    assert!(wide.contains(&at) && slab.owned.contains(&i) == own.contains(&at));
                }
                // Every third of all is meant.
                let meant: Vec<usize> = slab
                    .owned
                    .clone()
                    .filter(|&i| slab.global_index(i).is_multiple_of(3))
                    .collect();
                let told = slab.exchange_marks("every third", &meant).unwrap().unwrap();
                let halo = (0..slab.candidates.len()).filter(|i| !slab.owned.contains(i));
                assert!(
                    halo.filter(|&i| slab.global_index(i).is_multiple_of(3))
                        .eq(told)
                );
                assert_eq!(slab.exchange_marks("none", &[]).unwrap(), None);
                // Of each layer as many as its number.
                let before = |at: usize| at * at.saturating_sub(1) / 2;
                let of = |layers: Range<usize>| -> Vec<usize> {
                    layers.flat_map(|at| vec![at; at]).collect()
                };
                let some = slab
                    .layers_with_halo("layers", of(own.clone()), before)
                    .unwrap();
                let seen = match own.is_empty() {
                    true => 0..0,
                    false => wide.start..wide.end.min(dims[2]),
                };
                assert_eq!(some, (of(seen.clone()), before(seen.start)));
                let numbers = slab.owned.clone().map(|i| slab.global_index(i)).collect();
                let numbers = slab.with_halo("numbers", numbers).unwrap();
                assert!(
                    numbers
                        .into_iter()
                        .eq((0..slab.candidates.len()).map(|i| slab.global_index(i)))
                );
                let of = |i: usize| Some([1.0 / (1.0 + slab.global_index(i) as f64)]);
                let sum = slab.sums_by_layer("sums", of).unwrap();
                let whole = CandidateSlab::new(dims, all.clone(), None, 0, &SelfComm).unwrap();
                let of = |i: usize| Some([1.0 / (1.0 + i as f64)]);
                assert_eq!(sum, whole.sums_by_layer("sums", of).unwrap());
                assert_eq!(
                    slab.owned_candidates(slab.candidates.clone()).len(),
                    own.len().min(1) * slab.owned.len()
                );
                slab.global_sums("own", [slab.owned.len() as u64]).unwrap()
            });
            assert!(seen.into_iter().all(|sum| sum == [all.len() as u64]));
        }
    }
}
