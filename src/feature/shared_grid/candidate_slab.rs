//! Candidates in slabs of layers: each rank holds the candidates of some layers along the last
//! axis, its *owned* layers, and of a *halo* of neighbouring layers on either side, as wide as the
//! operations on candidates look.
//!
//! All candidates together are in the order of samples, and a rank holds one contiguous run of
//! them. So the index of a candidate in the run, plus the global index of the run's first
//! candidate, identifies it on all ranks.

use super::SharedGrid;
use crate::comm::{concatenate, partition_range};
use crate::error::Result;
use crate::feature::candidate::Candidate;
use crate::feature::windows::layer_len;
use crate::files::codec::Codec;
use std::ops::Range;

/// The candidates of one rank, with those of its halo.
pub struct CandidateSlab<'g, const D: usize> {
    /// The grid of samples, whose layers ranks share.
    pub grid: SharedGrid<'g, D>,
    /// Owned candidates and those of the halo, in the order of samples.
    pub candidates: Vec<Candidate<D>>,
    /// Indices of the owned candidates in `candidates`.
    pub owned: Range<usize>,
    /// Global index of the first of `candidates`.
    first_index: usize,
    /// For each rank, its owned layers and its halo; empty if it owns no layer.
    visible_layers: Vec<Range<usize>>,
    /// Layers that this rank owns, and those of them that no other rank sees.
    owned_layers: Range<usize>,
    inner_layers: Range<usize>,
}

impl<'g, const D: usize> CandidateSlab<'g, D> {
    /// Distributes candidates, which are in the order of samples, with a halo of `halo` layers.
    ///
    /// With `layers`, the candidates are those of these layers, which this rank owns; layers of
    /// lower ranks come first. Without, every rank passes all candidates, and the layers are
    /// divided evenly.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn new(
        grid: SharedGrid<'g, D>,
        candidates: Vec<Candidate<D>>,
        layers: Option<Range<usize>>,
        halo: usize,
    ) -> Result<Self> {
        let SharedGrid { dims, comm } = grid;
        let (rank, count) = (comm.rank(), comm.size());
        let (layers, candidates) = match layers {
            Some(layers) => (layers, candidates),
            None => {
                let layers = partition_range(dims[D - 1], rank, count);
                let owned = candidates_in_layers(dims, candidates, &layers);
                (layers, owned)
            }
        };
        let summary = [layers.start, layers.end, candidates.len()];
        let summaries = comm.all_gather("layers of candidates", summary)?;
        let with_halo = |&[start, end, _]: &[usize; 3]| {
            if start < end {
                start.saturating_sub(halo)..(end + halo).min(dims[D - 1])
            } else {
                0..0
            }
        };
        let visible_layers: Vec<Range<usize>> = summaries.iter().map(with_halo).collect();
        let candidates_for_rank = |(target, visible): (usize, &Range<usize>)| {
            if target == rank {
                Vec::new()
            } else {
                candidates[range_in_layers(dims, &candidates, visible)].to_vec()
            }
        };
        let sent = visible_layers
            .iter()
            .enumerate()
            .map(candidates_for_rank)
            .collect();
        let mut received: Vec<Vec<Candidate<D>>> = comm.all_to_all("candidates of halos", sent)?;
        let received_below: usize = received[..rank].iter().map(Vec::len).sum();
        let owned_below: usize = summaries[..rank].iter().map(|[.., count]| count).sum();
        let owned = received_below..received_below + candidates.len();
        received[rank] = candidates;
        let visible_to = |ranks: Range<usize>| {
            visible_layers[ranks]
                .iter()
                .filter(|layers| !layers.is_empty())
        };
        let below_end = visible_to(0..rank).map(|visible| visible.end).max();
        let above_start = visible_to(rank + 1..count)
            .map(|visible| visible.start)
            .min();
        let inner_layers = layers.start.max(below_end.unwrap_or(0))
            ..layers.end.min(above_start.unwrap_or(layers.end));
        Ok(Self {
            grid,
            candidates: concatenate(received),
            owned,
            first_index: owned_below - received_below,
            visible_layers,
            owned_layers: layers,
            inner_layers,
        })
    }

    /// Returns those of candidates in the order of samples that are in the layers that this rank
    /// owns.
    pub fn owned_candidates(&self, candidates: Vec<Candidate<D>>) -> Vec<Candidate<D>> {
        candidates_in_layers(self.grid.dims, candidates, &self.owned_layers)
    }

    /// Returns a value for each of `candidates`: those of the owned candidates are given, those of
    /// the halo come from other ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn with_halo<T: Codec + Clone>(&self, what: &str, owned_values: Vec<T>) -> Result<Vec<T>> {
        let count_before =
            |layer: usize| count_before_layer(self.grid.dims, &self.candidates, layer);
        Ok(self.layers_with_halo(what, owned_values, count_before)?.0)
    }

    /// Returns the values of the visible layers, and the number of values before them: those of
    /// owned layers are given, those of the halo come from other ranks. `count_before` returns the
    /// number of values in all layers before a layer.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn layers_with_halo<T: Codec + Clone>(
        &self,
        what: &str,
        owned_values: Vec<T>,
        count_before: impl Fn(usize) -> usize,
    ) -> Result<(Vec<T>, usize)> {
        let comm = self.grid.comm;
        let rank = comm.rank();
        let values_for_rank = |(target, visible): (usize, &Range<usize>)| {
            let shared =
                visible.start.max(self.owned_layers.start)..visible.end.min(self.owned_layers.end);
            if target == rank || shared.is_empty() {
                return Vec::new();
            }
            let first = count_before(self.owned_layers.start);
            owned_values[count_before(shared.start) - first..count_before(shared.end) - first]
                .to_vec()
        };
        let sent = self
            .visible_layers
            .iter()
            .enumerate()
            .map(values_for_rank)
            .collect();
        let mut received = comm.all_to_all(what, sent)?;
        received[rank] = owned_values;
        Ok((
            concatenate(received),
            count_before(self.visible_layers[rank].start),
        ))
    }

    /// Sums values over the owned candidates of all ranks. Candidates for which `values_of` returns
    /// `None` do not count. The sum is taken layer by layer, so that it is bitwise the same for any
    /// number of ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn sums_by_layer<const N: usize>(
        &self,
        what: &str,
        values_of: impl Fn(usize) -> Option<[f64; N]>,
    ) -> Result<[f64; N]> {
        let mut layer_sums: Vec<[f64; N]> = Vec::new();
        let mut last = None;
        for i in self.owned.clone() {
            let Some(values) = values_of(i) else { continue };
            let layer = Some(self.layer_of(i));
            if last != layer {
                layer_sums.push([0.0; N]);
                last = layer;
            }
            if let Some(sums) = layer_sums.last_mut() {
                *sums = std::array::from_fn(|k| sums[k] + values[k]);
            }
        }
        let all_sums = self.grid.concatenated(what, layer_sums)?;
        Ok(all_sums.into_iter().fold([0.0; N], |sums, layer| {
            std::array::from_fn(|k| sums[k] + layer[k])
        }))
    }

    /// Returns the layers that this rank owns.
    pub fn owned_layers(&self) -> &Range<usize> {
        &self.owned_layers
    }

    /// Returns the index of a candidate among those of all ranks.
    pub fn global_index(&self, i: usize) -> usize {
        self.first_index + i
    }

    /// Returns the layer of a candidate.
    fn layer_of(&self, i: usize) -> usize {
        self.candidates[i].voxel.index() / layer_len(self.grid.dims).max(1)
    }

    /// Returns `true` if no other rank sees this owned candidate.
    pub fn is_inner(&self, i: usize) -> bool {
        !self.grid.is_shared() || self.inner_layers.contains(&self.layer_of(i))
    }

    /// Returns `true` if this rank owns all samples that neighbour the sample of an owned
    /// candidate.
    pub fn owns_neighbours(&self, i: usize) -> bool {
        let (layer, owned) = (self.layer_of(i), &self.owned_layers);
        let layer_count = self.grid.dims[D - 1];
        (layer == 0 || owned.contains(&(layer - 1)))
            && (layer + 1 == layer_count || owned.contains(&(layer + 1)))
    }

    /// Sends the indices of marked owned candidates to the ranks that see them, and returns the
    /// indices of the halo's candidates that other ranks marked. Returns `None` if no rank marked
    /// any.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn exchange_marks(&self, what: &str, marked: &[usize]) -> Result<Option<Vec<usize>>> {
        if !self.grid.any(what, !marked.is_empty())? {
            return Ok(None);
        }
        let comm = self.grid.comm;
        let mut sent = vec![Vec::new(); comm.size()];
        let outer = marked.iter().copied().filter(|&i| !self.is_inner(i));
        for i in outer {
            let layer = self.layer_of(i);
            for (rank, visible) in self.visible_layers.iter().enumerate() {
                if rank != comm.rank() && visible.contains(&layer) {
                    sent[rank].push(self.global_index(i));
                }
            }
        }
        let received = comm.all_to_all(what, sent)?;
        Ok(Some(
            (received
                .into_iter()
                .flatten()
                .map(|number| number - self.first_index))
            .collect(),
        ))
    }
}

/// Returns the indices of those of candidates in the order of samples that are in these layers.
fn range_in_layers<const D: usize>(
    dims: [usize; D],
    candidates: &[Candidate<D>],
    layers: &Range<usize>,
) -> Range<usize> {
    let count_before = |layer| count_before_layer(dims, candidates, layer);
    if layers.is_empty() {
        0..0
    } else {
        count_before(layers.start)..count_before(layers.end)
    }
}

/// Returns the number of those of candidates in the order of samples that come before a layer.
fn count_before_layer<const D: usize>(
    dims: [usize; D],
    candidates: &[Candidate<D>],
    layer: usize,
) -> usize {
    let first = layer * layer_len(dims);
    candidates.partition_point(|c| c.voxel.index() < first)
}

/// Returns those of candidates in the order of samples that are in these layers.
fn candidates_in_layers<const D: usize>(
    dims: [usize; D],
    mut candidates: Vec<Candidate<D>>,
    layers: &Range<usize>,
) -> Vec<Candidate<D>> {
    let range = range_in_layers(dims, &candidates, layers);
    candidates.truncate(range.end);
    candidates.drain(..range.start);
    candidates
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;

    /// Returns pseudo-random candidates; every fifth layer has none.
    fn random_candidates(dims: [usize; 3]) -> Vec<Candidate<3>> {
        let place = |n: usize| [n * 7 % dims[0], n * 5 % dims[1], n * 3 % dims[2]];
        let mut candidates: Vec<Candidate<3>> = (0..300)
            .map(place)
            .filter(|at| at[2] % 5 != 0)
            .map(|at| Candidate::new(dims, at, 0, 0.0, [1.0, 0.0, 0.0], 1.0))
            .collect();
        candidates.sort_by_key(|c| c.voxel);
        candidates
    }

    #[test]
    fn slabs_have_owned_and_halo_candidates_and_exchange_marks() {
        let dims = [11, 9, 23];
        let all = random_candidates(dims);
        let area = dims[0] * dims[1];
        for (count, halo) in [(1, 4), (2, 3), (3, 9), (5, 2), (30, 6)] {
            let sums = run_threads(count, |comm| {
                let owned = partition_range(dims[2], comm.rank(), count);
                let is_owned = |c: &&Candidate<3>| owned.contains(&(c.voxel.index() / area));
                let owned_candidates = all.iter().filter(is_owned).copied().collect();
                let grid = SharedGrid::new(dims, comm);
                let from_all = CandidateSlab::new(grid, all.clone(), None, halo).unwrap();
                let slab =
                    CandidateSlab::new(grid, owned_candidates, Some(owned.clone()), halo).unwrap();
                assert_eq!(slab.candidates.len(), from_all.candidates.len());
                assert!(
                    owned.is_empty()
                        || (slab.first_index, &slab.owned)
                            == (from_all.first_index, &from_all.owned)
                );
                let with_halo = owned.start.saturating_sub(halo)..owned.end + halo;
                for (i, c) in slab.candidates.iter().enumerate() {
                    assert_eq!(c.voxel, all[slab.global_index(i)].voxel);
                    let layer = c.voxel.index() / area;
                    assert!(
                        with_halo.contains(&layer)
                            && slab.owned.contains(&i) == owned.contains(&layer)
                    );
                }
                // Every third of all candidates is marked.
                let marked: Vec<usize> = slab
                    .owned
                    .clone()
                    .filter(|&i| slab.global_index(i).is_multiple_of(3))
                    .collect();
                let received = slab
                    .exchange_marks("every third", &marked)
                    .unwrap()
                    .unwrap();
                let halo = (0..slab.candidates.len()).filter(|i| !slab.owned.contains(i));
                assert!(
                    halo.filter(|&i| slab.global_index(i).is_multiple_of(3))
                        .eq(received)
                );
                assert_eq!(slab.exchange_marks("none", &[]).unwrap(), None);
                // Each layer has as many values as its index.
                let count_before = |layer: usize| layer * layer.saturating_sub(1) / 2;
                let values_of = |layers: Range<usize>| -> Vec<usize> {
                    layers.flat_map(|at| vec![at; at]).collect()
                };
                let values = slab
                    .layers_with_halo("layers", values_of(owned.clone()), count_before)
                    .unwrap();
                let visible = if owned.is_empty() {
                    0..0
                } else {
                    with_halo.start..with_halo.end.min(dims[2])
                };
                assert_eq!(
                    values,
                    (values_of(visible.clone()), count_before(visible.start))
                );
                let numbers = slab.owned.clone().map(|i| slab.global_index(i)).collect();
                let numbers = slab.with_halo("numbers", numbers).unwrap();
                assert!(
                    numbers
                        .into_iter()
                        .eq((0..slab.candidates.len()).map(|i| slab.global_index(i)))
                );
                let term = |i: usize| Some([1.0 / (1.0 + slab.global_index(i) as f64)]);
                let sum = slab.sums_by_layer("sums", term).unwrap();
                let single = SharedGrid::of_one_process(dims);
                let single = CandidateSlab::new(single, all.clone(), None, 0).unwrap();
                let term = |i: usize| Some([1.0 / (1.0 + i as f64)]);
                assert_eq!(sum, single.sums_by_layer("sums", term).unwrap());
                assert_eq!(
                    slab.owned_candidates(slab.candidates.clone()).len(),
                    owned.len().min(1) * slab.owned.len()
                );
                grid.sum("own", [slab.owned.len()]).unwrap()
            });
            assert!(sums.into_iter().all(|sum| sum == [all.len()]));
        }
    }
}
