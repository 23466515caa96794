//! A sampled function that is zero nearly everywhere, such as a potential with a few thin valleys.
//! It is stored in bricks, and only where it is not zero.
//!
//! A brick holds the samples of its cells and the taps beyond them, so that interpolation needs one
//! brick only. The interpolation equals that of [`ScalarField`] bit by bit. For each brick a mask
//! marks the small blocks that have a tap that is not zero, because most atoms near a valley are
//! not in it.

use super::bricks::{BRICK_CELLS, MissFlag, brick_counts};
use super::field::{ScalarField, Taps, box_extent, interpolate};
use crate::comm::{Comm, SelfComm, partition_range};
use crate::error::Result;
use crate::files::codec::codec_fields;
use crate::geometry::grid_index::{index_at, offset_of, strides};
use crate::geometry::morphology;
use crate::parallel::prelude::*;
use std::ops::Range;

/// Samples along an edge of a brick: one before its cells, and two after them.
const BRICK_SAMPLES: usize = BRICK_CELLS + 3;
/// Cells along an edge of a block. The blocks of a brick, 4^3 in 3-D, have one bit each.
const BLOCK_CELLS: usize = 2;
const BRICK_BLOCKS: usize = BRICK_CELLS / BLOCK_CELLS;
/// Slot of a brick in which the function is zero.
const ZERO_BRICK: u32 = u32::MAX;
/// Slot of a brick that is not stored on this rank; another rank may store it.
const UNKNOWN_BRICK: u32 = ZERO_BRICK - 1;
/// Memory, in bytes, of the samples that are computed at a time, unless one layer of bricks takes
/// more.
const MAX_BUFFER_BYTES: usize = 1 << 26;
/// Largest number of layers of bricks that are computed at a time.
const MAX_BRICK_LAYERS: usize = 4;

/// Samples of a scalar function over a box in lattice space that is zero nearly everywhere.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseField<const D: usize> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// Lattice-space distance between samples along each axis.
    pub step: [f64; D],
    /// For each brick, x fastest, its slot among the stored bricks, or [`ZERO_BRICK`] or
    /// [`UNKNOWN_BRICK`].
    pub(crate) slots: Vec<u32>,
    /// For each stored brick, the blocks in which the function is not zero, one bit per block.
    pub(crate) masks: Vec<u64>,
    /// Samples of the stored bricks, x fastest in each.
    pub(crate) samples: Vec<f32>,
    /// `true` if each rank stores a part of the bricks.
    pub(crate) is_distributed: bool,
    /// Set if a value was requested in a brick that is not stored on this rank.
    pub(crate) miss_flag: MissFlag,
}

/// Returns the number of parts in which samples are computed, one after the other along the last
/// axis, and the layers of bricks in each part.
fn part_layout<const D: usize>(dims: [usize; D]) -> (usize, usize) {
    let layer: usize = dims[..D - 1].iter().product();
    let layers_in_buffer = MAX_BUFFER_BYTES / 4 / layer.max(1);
    let layers_per_part = (layers_in_buffer.saturating_sub(BRICK_SAMPLES - BRICK_CELLS)
        / BRICK_CELLS)
        .clamp(1, MAX_BRICK_LAYERS);
    (
        brick_counts(dims)[D - 1].div_ceil(layers_per_part),
        layers_per_part,
    )
}

/// Returns the layers of samples that a range of layers of bricks needs.
fn sample_layers<const D: usize>(dims: [usize; D], bricks: Range<usize>) -> Range<usize> {
    (bricks.start * BRICK_CELLS).saturating_sub(1)..(bricks.end * BRICK_CELLS + 2).min(dims[D - 1])
}

/// Returns the number of samples in a brick.
const fn brick_len(dimensions: usize) -> usize {
    BRICK_SAMPLES.pow(dimensions as u32)
}

/// Bricks to be stored: the index in the box and the block mask of each. The samples of all bricks
/// are in one array, because tens of thousands of small arrays would fragment the memory.
#[derive(Default)]
struct BrickSet {
    bricks: Vec<(usize, u64)>,
    samples: Vec<f32>,
}

codec_fields! {
    BrickSet as BrickSet { bricks, samples }
}

impl<const D: usize> SparseField<D> {
    /// Creates a field that is zero everywhere.
    pub fn zero(dims: [usize; D], step: [f64; D]) -> Self {
        Self {
            dims,
            step,
            slots: vec![ZERO_BRICK; brick_counts(dims).iter().product()],
            masks: Vec::new(),
            samples: Vec::new(),
            is_distributed: false,
            miss_flag: MissFlag::default(),
        }
    }

    /// Creates a field from samples that are computed some layers along the last axis at a time,
    /// distributed over the ranks of `comm`: each rank computes and stores a part of the layers.
    /// `fill_layers` replaces the content of its buffer by the samples of a range of layers. It is
    /// called for some layers twice.
    pub fn from_layers(
        dims: [usize; D],
        step: [f64; D],
        comm: &dyn Comm,
        fill_layers: impl Fn(Range<usize>, &mut Vec<f32>) + Sync,
    ) -> Self {
        let (parts, layers_per_part) = part_layout(dims);
        let owned_parts = partition_range(parts, comm.rank(), comm.size());
        let count = brick_counts(dims)[D - 1];
        let brick_sets: Vec<BrickSet> = owned_parts
            .clone()
            .into_par_iter()
            .map_init(Vec::new, |samples, part| {
                let [first, end] = [
                    part * layers_per_part,
                    ((part + 1) * layers_per_part).min(count),
                ];
                let Range {
                    start: first_layer,
                    end: end_layer,
                } = sample_layers(dims, first..end);
                fill_layers(first_layer..end_layer, samples);
                let slab = LayerSlab {
                    dims,
                    first_layer,
                    end_layer,
                    samples,
                };
                slab.nonzero_bricks(first..end)
            })
            .collect();
        let mut field = Self::zero(dims, step);
        field.insert_all(brick_sets);
        field.is_distributed = comm.size() > 1;
        let bricks_per_layer = field.slots.len() / count;
        let owned_bricks = owned_parts.start * layers_per_part * bricks_per_layer
            ..owned_parts.end * layers_per_part * bricks_per_layer;
        for (brick, slot) in field.slots.iter_mut().enumerate() {
            if !owned_bricks.contains(&brick) {
                *slot = UNKNOWN_BRICK;
            }
        }
        field
    }

    /// Returns the layers of samples that one of `count` ranks computes in
    /// [`Self::from_layers`].
    pub fn rank_layers(dims: [usize; D], rank: usize, count: usize) -> Range<usize> {
        let (parts, layers_per_part) = part_layout(dims);
        let owned = partition_range(parts, rank, count);
        if owned.is_empty() {
            0..0
        } else {
            sample_layers(
                dims,
                owned.start * layers_per_part..owned.end * layers_per_part,
            )
        }
    }

    /// Stores bricks in the order of parts. The field must not store any before.
    fn insert_all(&mut self, brick_sets: Vec<BrickSet>) {
        self.samples = vec![0.0; brick_sets.iter().map(|part| part.samples.len()).sum()];
        let (mut remaining, mut slices) =
            (&mut self.samples[..], Vec::with_capacity(brick_sets.len()));
        for part in &brick_sets {
            let (slice, tail) = remaining.split_at_mut(part.samples.len());
            slices.push(slice);
            remaining = tail;
            for &(brick, mask) in &part.bricks {
                self.slots[brick] = self.masks.len() as u32;
                self.masks.push(mask);
            }
        }
        let parts = brick_sets.into_par_iter().zip(slices);
        parts.for_each(|(part, slice)| slice.copy_from_slice(&part.samples));
    }

    /// Returns the global field on all ranks, from a field that is distributed over `comm`.
    ///
    /// # Errors
    /// Returns the errors of the other ranks.
    pub(crate) fn all_gather(&self, comm: &dyn Comm) -> Result<Self> {
        let owned = (0..self.slots.len()).filter(|&brick| self.slots[brick] < UNKNOWN_BRICK);
        let gathered = comm.all_gather("bricks of a potential", self.select_bricks(owned))?;
        let mut global = Self::zero(self.dims, self.step);
        global.insert_all(gathered);
        Ok(global)
    }

    /// Returns the bricks of a distributed field that are within `reach` of some positions along
    /// each axis. [Access](Self::miss_flag) to other bricks gives zero and sets the flag.
    ///
    /// # Errors
    /// Returns the errors of the other ranks.
    pub(crate) fn gather_neighbourhood(
        &self,
        positions: &[[f64; D]],
        reach: f64,
        comm: &dyn Comm,
    ) -> Result<Self> {
        let counts = brick_counts(self.dims);
        let needed = morphology::bricks_near(positions, reach, counts, BRICK_CELLS, self.step);
        let (parts, layers_per_part) = part_layout(self.dims);
        let bricks_per_layer = needed.len() / counts[D - 1];
        let requested = (0..comm.size()).map(|rank| -> Vec<usize> {
            let owned = partition_range(parts, rank, comm.size());
            let last = (owned.end * layers_per_part * bricks_per_layer).min(needed.len());
            let owned = (owned.start * layers_per_part * bricks_per_layer).min(last)..last;
            owned.filter(|&brick| needed[brick]).collect()
        });
        let available = |requested: &[usize]| -> Vec<usize> {
            let is_stored = |brick: &usize| self.slots[*brick] < UNKNOWN_BRICK;
            requested.iter().copied().filter(is_stored).collect()
        };
        let places = ["bricks that are wanted", "bricks of a potential"];
        let select = |requested: &Vec<usize>| self.select_bricks(available(requested).into_iter());
        let (own, set) = comm.fetch(places, requested.collect(), select)?;
        let mut local = Self::zero(self.dims, self.step);
        for (slot, is_needed) in local.slots.iter_mut().zip(needed) {
            if !is_needed {
                *slot = UNKNOWN_BRICK;
            }
        }
        let owned = available(&own);
        let count = owned.len() + set.iter().map(|set| set.bricks.len()).sum::<usize>();
        local.masks.reserve_exact(count);
        local.samples.reserve_exact(count * brick_len(D));
        for (rank, set) in set.into_iter().enumerate() {
            if rank == comm.rank() {
                for &brick in &owned {
                    let slot = self.slots[brick];
                    local.insert(brick, self.masks[slot as usize], self.brick_samples(slot));
                }
            }
            for (&(brick, mask), samples) in set.bricks.iter().zip(set.samples.chunks(brick_len(D)))
            {
                local.insert(brick, mask, samples);
            }
        }
        Ok(local)
    }

    /// Returns the given stored bricks.
    fn select_bricks(&self, numbers: impl Iterator<Item = usize>) -> BrickSet {
        let mut set = BrickSet::default();
        for brick in numbers {
            let slot = self.slots[brick];
            set.bricks.push((brick, self.masks[slot as usize]));
            set.samples.extend_from_slice(self.brick_samples(slot));
        }
        set
    }

    /// Returns `true` if a value was requested in a brick that is not stored on this rank.
    pub(crate) fn has_missed(&self) -> bool {
        self.miss_flag.is_set()
    }

    /// Creates a sparse field from a dense one.
    pub fn from_field(field: &ScalarField<D>) -> Self {
        let layer: usize = field.dims[..D - 1].iter().product();
        let part = |layers: Range<usize>, samples: &mut Vec<f32>| {
            samples.clear();
            samples.extend_from_slice(&field.samples[layers.start * layer..layers.end * layer]);
        };
        Self::from_layers(field.dims, field.step, &SelfComm, part)
    }

    fn insert(&mut self, brick: usize, mask: u64, samples: &[f32]) {
        self.slots[brick] = self.masks.len() as u32;
        self.masks.push(mask);
        self.samples.extend_from_slice(samples);
    }

    /// Returns a field whose samples are `op` of the samples of this field and another one over the
    /// same box. It is zero where both fields are zero.
    pub fn combine(&self, other: &Self, op: impl Fn(f32, f32) -> f32) -> Self {
        let mut result = Self::zero(self.dims, self.step);
        result.is_distributed = self.is_distributed || other.is_distributed;
        let zeros = vec![0.0; brick_len(D)];
        for brick in 0..self.slots.len() {
            let [a, b] = [self, other].map(|field| field.slots[brick]);
            if a >= UNKNOWN_BRICK && b >= UNKNOWN_BRICK {
                result.slots[brick] = a.min(b);
                continue;
            }
            let samples_of = |field: &Self, slot: u32| match slot {
                ZERO_BRICK | UNKNOWN_BRICK => zeros.clone(),
                slot => field.brick_samples(slot).to_vec(),
            };
            let (a, b) = (samples_of(self, a), samples_of(other, b));
            let samples: Vec<f32> = a.iter().zip(&b).map(|(a, b)| op(*a, *b)).collect();
            result.insert(brick, block_mask::<D>(&samples), &samples);
        }
        result
    }

    /// Returns the dense field with all samples.
    pub fn to_dense(&self) -> ScalarField<D> {
        let mut samples = vec![0.0; self.dims.iter().product()];
        let bricks = brick_counts(self.dims);
        for (number, slot) in self
            .slots
            .iter()
            .enumerate()
            .filter(|b| *b.1 < UNKNOWN_BRICK)
        {
            let first = brick_corner(number, bricks);
            for (i, value) in self.brick_samples(*slot).iter().enumerate() {
                let at = index_at([BRICK_SAMPLES; D], i);
                let inside = (0..D).all(|k| (1..=self.dims[k]).contains(&(first[k] + at[k])));
                if inside {
                    let index = std::array::from_fn(|k| first[k] + at[k] - 1);
                    samples[offset_of(self.dims, index)] = *value;
                }
            }
        }
        ScalarField {
            dims: self.dims,
            step: self.step,
            samples,
        }
    }

    /// Returns `true` if the field is zero everywhere.
    pub fn is_zero(&self) -> bool {
        self.masks.iter().all(|mask| *mask == 0)
    }

    /// Returns the far corner of the box; the near corner is the origin.
    pub fn extent(&self) -> [f64; D] {
        box_extent(self.dims, self.step)
    }

    /// Returns the interpolated value at a position in lattice space.
    pub fn value(&self, position: [f64; D]) -> f64 {
        self.value_and_gradient(position).0
    }

    /// Returns the interpolated value and its exact gradient at a position in lattice space, as
    /// [`ScalarField::value_and_gradient`] does.
    pub fn value_and_gradient(&self, position: [f64; D]) -> (f64, [f64; D]) {
        self.nonzero_value_and_gradient(position)
            .unwrap_or((0.0, [0.0; D]))
    }

    /// Returns the interpolated value and its exact gradient, or `None` if every tap is zero.
    #[inline]
    pub fn nonzero_value_and_gradient(&self, position: [f64; D]) -> Option<(f64, [f64; D])> {
        let (mut brick, mut block) = (0, 0);
        let mut cell_in_brick = [0; D];
        for k in (0..D).rev() {
            let cells = self.dims[k].saturating_sub(1).max(1);
            // The conversion turns negative numbers into zero.
            let cell = ((position[k] / self.step[k]) as usize).min(cells - 1);
            cell_in_brick[k] = cell % BRICK_CELLS;
            brick = brick * cells.div_ceil(BRICK_CELLS) + cell / BRICK_CELLS;
            block = block * BRICK_BLOCKS + cell_in_brick[k] / BLOCK_CELLS;
        }
        let slot = self.slots[brick];
        if slot >= UNKNOWN_BRICK {
            if slot == UNKNOWN_BRICK {
                self.miss_flag.set();
            }
            return None;
        }
        if self.masks[slot as usize] >> block & 1 == 0 {
            return None;
        }
        let samples = self.brick_samples(slot);
        let strides = strides([BRICK_SAMPLES; D]);
        let taps: [Taps; D] = std::array::from_fn(|k| {
            let mut taps = Taps::new(position[k], self.dims[k], self.step[k], 0);
            taps.offsets = std::array::from_fn(|tap| (cell_in_brick[k] + tap) * strides[k]);
            taps
        });
        let base = samples[taps.iter().map(|t| t.offsets[1]).sum::<usize>()];
        let line = |start: usize| -> [f32; 4] {
            let line = &samples[start + cell_in_brick[0]..][..4];
            [line[0], line[1], line[2], line[3]].map(|sample| sample - base)
        };
        Some(interpolate(&taps, base, line))
    }

    #[inline]
    fn brick_samples(&self, slot: u32) -> &[f32] {
        &self.samples[slot as usize * brick_len(D)..][..brick_len(D)]
    }
}

/// Returns the first cell of a brick. The second sample of the brick along each axis is at that
/// cell.
fn brick_corner<const D: usize>(number: usize, bricks: [usize; D]) -> [usize; D] {
    index_at(bricks, number).map(|brick| brick * BRICK_CELLS)
}

/// Returns the blocks of a brick along one axis that use its sample `j` as a tap.
fn tapped_blocks(j: usize) -> Range<usize> {
    j.saturating_sub(3) / BLOCK_CELLS..j.min(BRICK_CELLS - 1) / BLOCK_CELLS + 1
}

/// Returns the mask of the blocks of a brick that have a tap that is not zero.
fn block_mask<const D: usize>(samples: &[f32]) -> u64 {
    let mut mask = 0u64;
    for (row, line) in samples.chunks(BRICK_SAMPLES).enumerate() {
        let mut blocks = 0u64;
        for (j, _) in line.iter().enumerate().filter(|s| *s.1 != 0.0) {
            tapped_blocks(j).for_each(|block| blocks |= 1 << block);
        }
        if blocks == 0 {
            continue;
        }
        let (mut rest, mut shift) = (row, BRICK_BLOCKS);
        for _ in 1..D {
            let inner = blocks;
            blocks = tapped_blocks(rest % BRICK_SAMPLES)
                .fold(0, |mask, block| mask | inner << (block * shift));
            rest /= BRICK_SAMPLES;
            shift *= BRICK_BLOCKS;
        }
        mask |= blocks;
    }
    mask
}

/// Consecutive layers of samples along the last axis.
struct LayerSlab<'a, const D: usize> {
    /// Dimensions of the whole box.
    dims: [usize; D],
    first_layer: usize,
    end_layer: usize,
    samples: &'a [f32],
}

impl<const D: usize> LayerSlab<'_, D> {
    /// Returns the bricks of a range of layers of bricks that are not zero.
    fn nonzero_bricks(&self, layers: Range<usize>) -> BrickSet {
        let mut counts = brick_counts(self.dims);
        counts[D - 1] = layers.len();
        let occupied = self.occupied_bricks(counts, layers.start);
        let first_brick = layers.start * counts[..D - 1].iter().product::<usize>();
        let mut set = BrickSet::default();
        for (number, _) in occupied.iter().enumerate().filter(|b| *b.1) {
            let mut first = brick_corner(number, counts);
            first[D - 1] += layers.start * BRICK_CELLS;
            let start = set.samples.len();
            self.append_brick(first, &mut set.samples);
            match block_mask::<D>(&set.samples[start..]) {
                0 => set.samples.truncate(start),
                mask => set.bricks.push((first_brick + number, mask)),
            }
        }
        set
    }

    /// Returns a flag per brick of a grid of `counts` bricks, beginning with layer `first` of
    /// bricks: `true` if the brick has a sample that is not zero.
    fn occupied_bricks(&self, counts: [usize; D], first: usize) -> Vec<bool> {
        // The bricks along an axis that hold a sample, numbered within the grid.
        let bricks_holding = |at: usize, k: usize| {
            let skipped = if k == D - 1 { first } else { 0 };
            let low = at.saturating_sub(BRICK_SAMPLES - 2).div_ceil(BRICK_CELLS);
            let high = ((at + 1) / BRICK_CELLS).min(skipped + counts[k] - 1);
            low.max(skipped) - skipped..high + 1 - skipped
        };
        let mut occupied = vec![false; counts.iter().product()];
        let mut row_occupied = vec![false; counts[0]];
        for (row, line) in self.samples.chunks_exact(self.dims[0].max(1)).enumerate() {
            let mut any = false;
            for (part, cells) in line.chunks(BRICK_CELLS).enumerate() {
                if cells.iter().all(|&b| b == 0.0) {
                    continue;
                }
                any = true;
                for (n, _) in cells.iter().enumerate().filter(|s| *s.1 != 0.0) {
                    row_occupied[bricks_holding(part * BRICK_CELLS + n, 0)].fill(true);
                }
            }
            if !any {
                continue;
            }
            let mut starts = vec![0];
            let (mut rest, mut stride) = (row, counts[0]);
            for k in 1..D {
                let at = if k == D - 1 {
                    rest + self.first_layer
                } else {
                    rest % self.dims[k]
                };
                rest /= self.dims[k];
                let bricks = bricks_holding(at, k);
                starts = starts
                    .iter()
                    .flat_map(|start| bricks.clone().map(move |b| start + b * stride))
                    .collect();
                stride *= counts[k];
            }
            for start in starts {
                let row = occupied[start..start + counts[0]].iter_mut();
                row.zip(&row_occupied)
                    .for_each(|(flag, occupied_in_row)| *flag |= occupied_in_row);
            }
            row_occupied.fill(false);
        }
        occupied
    }

    /// Appends the samples of the brick whose first cell is `first`. Beyond the box the outermost
    /// samples repeat.
    fn append_brick(&self, first: [usize; D], samples: &mut Vec<f32>) {
        let sample = |j: usize, k: usize| (first[k] + j).saturating_sub(1).min(self.dims[k] - 1);
        let strides = strides(self.dims);
        for row in 0..brick_len(D) / BRICK_SAMPLES {
            let in_brick = index_at([BRICK_SAMPLES; D], row * BRICK_SAMPLES);
            let offset = |k: usize| match sample(in_brick[k], k) {
                at if k < D - 1 => at * strides[k],
                at => {
                    let layer = at.clamp(self.first_layer, self.end_layer - 1);
                    (layer - self.first_layer) * strides[k]
                }
            };
            let start: usize = (1..D).map(offset).sum();
            samples.extend((0..BRICK_SAMPLES).map(|j| self.samples[start + sample(j, 0)]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    /// A bent valley three samples wide, and one single sample that is not zero.
    fn valley<const D: usize>(dims: [usize; D], step: [f64; D]) -> ScalarField<D> {
        let mut field = ScalarField::from_fn(dims, step, |x| {
            let distance = x[0] / step[0] - 9.0 - 0.02 * (x[1] / step[1] - 7.0).powi(2);
            -(1.0 - 0.5 * distance.abs()).max(0.0)
        });
        let last = field.samples.len() - 1;
        field.samples[last] = -0.3;
        field
    }

    fn check_against_dense<const D: usize>(dims: [usize; D], step: [f64; D]) {
        let field = valley(dims, step);
        let sparse = SparseField::from_field(&field);
        assert_eq!(sparse.to_dense(), field);
        let extent = field.extent();
        assert_eq!(sparse.extent(), extent);
        let mut random = Random::new(3);
        let mut skipped = 0;
        for n in 0..20_000 {
            // One third of the positions lies on samples; of the others some lie on the sides and
            // some outside.
            let x: [f64; D] = std::array::from_fn(|k| {
                let x = random.range(-0.1, 1.1) * extent[k];
                match n % 3 {
                    0 => (x / step[k]).round() * step[k],
                    1 => x.clamp(0.0, extent[k]),
                    _ => x,
                }
            });
            let truth = field.value_and_gradient(x);
            match sparse.nonzero_value_and_gradient(x) {
                Some(found) => assert_eq!(found, truth, "{x:?}"),
                None => {
                    skipped += 1;
                    assert_eq!(truth, (0.0, [0.0; D]), "{x:?}");
                }
            }
        }
        assert!(skipped > 4_000, "{skipped}");
    }

    #[test]
    fn sparse_field_equals_its_dense_source() {
        check_against_dense([41, 30, 25], [1.0, 0.5, 2.0]);
        check_against_dense([33, 17, 70], [1.0; 3]);
        check_against_dense([60, 43], [1.0, 0.25]);
        check_against_dense([41, 30, 1], [1.0; 3]);
    }

    #[test]
    fn zero_bricks_take_no_memory() {
        let sparse = SparseField::from_field(&valley([120, 110, 100], [1.0; 3]));
        let stored_share = sparse.samples.len() as f64 / (120.0 * 110.0 * 100.0);
        assert!(stored_share < 0.6, "{stored_share}");
        let zero = SparseField::<3>::zero([30, 20, 10], [1.0; 3]);
        assert!(zero.is_zero() && !sparse.is_zero());
        assert_eq!(zero, SparseField::from_field(&zero.to_dense()));
    }

    #[test]
    fn distributed_parts_make_up_the_global_field() {
        use crate::comm::run_threads;

        // The layers are so large that there are several parts.
        let dims = [61, 50, 290];
        let field = valley(dims, [1.0; 3]);
        let global = SparseField::from_field(&field);
        let layer = dims[0] * dims[1];
        let make = |layers: Range<usize>, samples: &mut Vec<f32>| {
            samples.clear();
            samples.extend(&field.samples[layers.start * layer..layers.end * layer]);
        };
        for count in [1, 2, 3, 7] {
            let shares = run_threads(count, |comm| {
                let owned = SparseField::from_layers(dims, [1.0; 3], comm, make);
                assert_eq!(owned.is_distributed, count > 1);
                assert!(owned.all_gather(comm).unwrap() == global);
                let twice = owned
                    .combine(&owned, |a, b| a + b)
                    .all_gather(comm)
                    .unwrap();
                assert!(twice == global.combine(&global, |a, b| a + b));
                let mut random = Random::new(comm.rank() as u64);
                let middle = random.range(0.0, 280.0);
                let mut position = || {
                    let x = [random.range(0.0, 60.0), random.range(0.0, 49.0)];
                    [x[0], x[1], middle + random.range(0.0, 9.0)]
                };
                let positions: Vec<[f64; 3]> = (0..400).map(|_| position()).collect();
                let local = owned.gather_neighbourhood(&positions, 3.0, comm).unwrap();
                for x in &positions {
                    let x = x.map(|x| (x + 2.9).max(0.0));
                    assert_eq!(local.value_and_gradient(x), global.value_and_gradient(x));
                }
                assert!(!local.has_missed());
                local.value([30.0, 30.0, if middle > 150.0 { 3.0 } else { 285.0 }]);
                assert!(local.has_missed());
                owned.samples.len()
            });
            assert_eq!(
                shares.iter().sum::<usize>(),
                global.samples.len(),
                "{count}"
            );
        }
    }

    #[test]
    fn two_fields_are_combined_sample_by_sample() {
        let dims = [37, 29, 22];
        let first = valley(dims, [1.0; 3]);
        let second =
            ScalarField::from_fn(dims, [1.0; 3], |x| -(1.5 - (x[2] - 12.0).abs()).max(0.0));
        let deepest = |a: f32, b: f32| (0.5 * a).min(0.8 * b);
        let combined =
            SparseField::from_field(&first).combine(&SparseField::from_field(&second), deepest);
        let samples = first.samples.iter().zip(&second.samples);
        let samples = samples.map(|(a, b)| deepest(*a, *b)).collect();
        let truth = ScalarField { samples, ..first };
        assert_eq!(combined.to_dense(), truth);
        for n in 0..5_000 {
            let x = std::array::from_fn(|k| f64::from(n * (7919 + 31 * k as u32) % 997) / 40.0);
            assert_eq!(combined.value_and_gradient(x), truth.value_and_gradient(x));
        }
    }
}
