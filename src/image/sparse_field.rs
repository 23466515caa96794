//! A sampled function that is zero nearly everywhere, as a potential with a few thin valleys is: kept in
//! bricks, only where it is something.
//!
//! A brick holds the samples of its cells and the taps beyond them, so that interpolation, which is that of
//! [`ScalarField`] to the last bit, looks into one brick only. Which of a brick's small blocks have any tap that
//! is not zero is known, too: most atoms near a valley are not in it.

use super::field::{ScalarField, Taps, interpolate};
use crate::comm::{Comm, partition_range};
use crate::error::Result;
use crate::files::codec::{Codec, codec_fields};
use crate::geometry::morphology;
use crate::parallel::prelude::*;
use std::io::{self, Write};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// Cells along an edge of a brick.
const BRICK_CELLS: usize = 8;
/// Samples along an edge of a brick: one before its cells, and two after them.
const BRICK_SAMPLES: usize = BRICK_CELLS + 3;
/// Cells along an edge of a block, and blocks along an edge of a brick: 4^3 blocks have a bit each.
const BLOCK_CELLS: usize = 2;
const BRICK_BLOCKS: usize = BRICK_CELLS / BLOCK_CELLS;
/// A brick in which the function is zero.
const ZERO_BRICK: u32 = u32::MAX;
/// A brick of which nothing is known here: another rank may have it.
const UNKNOWN_BRICK: u32 = ZERO_BRICK - 1;
/// Bytes of samples that are made at a time, unless a layer of bricks takes more ...
const MAX_BUFFER_BYTES: usize = 1 << 26;
/// ... and most layers of bricks.
const MAX_BRICK_LAYERS: usize = 4;

/// Samples of a scalar function over the lattice-space box that is zero nearly everywhere.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseField<const D: usize> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// Lattice-space distance between samples along each axis.
    pub step: [f64; D],
    /// For each brick, x fastest, its number among those that are kept.
    pub(crate) slots: Vec<u32>,
    /// Of each kept brick, the blocks in which the function is not zero.
    pub(crate) masks: Vec<u64>,
    /// The samples of the kept bricks, x fastest in each.
    pub(crate) samples: Vec<f32>,
    /// Whether each rank has a share of the bricks.
    pub(crate) is_distributed: bool,
    /// Whether it was asked for where nothing is known.
    pub(crate) miss_flag: MissFlag,
}

/// Whether something was missed; no property of a function.
#[derive(Debug, Default)]
pub(crate) struct MissFlag(AtomicBool);

impl MissFlag {
    /// It was.
    pub(crate) fn set(&self) {
        self.0.store(true, Relaxed);
    }

    /// Whether it was.
    pub(crate) fn is_set(&self) -> bool {
        self.0.load(Relaxed)
    }
}

impl Clone for MissFlag {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl PartialEq for MissFlag {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Codec for MissFlag {
    fn encode(&self, _: &mut dyn Write) -> io::Result<()> {
        Ok(())
    }

    fn decode(_: &mut &[u8]) -> Option<Self> {
        Some(Self::default())
    }
}

/// Bricks along each axis.
fn brick_counts<const D: usize>(dims: [usize; D]) -> [usize; D] {
    dims.map(|n| n.saturating_sub(1).max(1).div_ceil(BRICK_CELLS))
}

/// How many parts samples are made in, one after the other along the last axis, and layers of bricks of each.
fn part_layout<const D: usize>(dims: [usize; D]) -> (usize, usize) {
    let layer: usize = dims[..D - 1].iter().product();
    let held = MAX_BUFFER_BYTES / 4 / layer.max(1);
    let together =
        (held.saturating_sub(BRICK_SAMPLES - BRICK_CELLS) / BRICK_CELLS).clamp(1, MAX_BRICK_LAYERS);
    (brick_counts(dims)[D - 1].div_ceil(together), together)
}

/// The layers of samples that some layers of bricks have.
fn sample_layers<const D: usize>(dims: [usize; D], bricks: Range<usize>) -> Range<usize> {
    (bricks.start * BRICK_CELLS).saturating_sub(1)..(bricks.end * BRICK_CELLS + 2).min(dims[D - 1])
}

/// Samples of a brick.
const fn brick_len(dimensions: usize) -> usize {
    BRICK_SAMPLES.pow(dimensions as u32)
}

/// Bricks that are to be kept: the number of each in the box and its blocks; their samples one after the
/// other, for small arrays by the ten thousand would leave memory in pieces.
#[derive(Default)]
struct BrickSet {
    bricks: Vec<(usize, u64)>,
    samples: Vec<f32>,
}

codec_fields! {
    BrickSet as BrickSet { bricks, samples }
}

impl<const D: usize> SparseField<D> {
    /// Zero everywhere.
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

    /// Of samples that are made some layers along the last axis at a time: `make` fills in those of a
    /// range of layers, whatever was there before. It is asked for some layers twice.
    pub fn from_layers(
        dims: [usize; D],
        step: [f64; D],
        make: impl Fn(Range<usize>, &mut Vec<f32>) + Sync,
    ) -> Self {
        let (parts, _) = part_layout(dims);
        Self::from_parts(dims, step, 0..parts, make)
    }

    /// The same, of which each of a group makes, and has, a share.
    pub fn from_layers_distributed(
        dims: [usize; D],
        step: [f64; D],
        group: &dyn Comm,
        make: impl Fn(Range<usize>, &mut Vec<f32>) + Sync,
    ) -> Self {
        let (parts, together) = part_layout(dims);
        let own = partition_range(parts, group.rank(), group.size());
        let mut some = Self::from_parts(dims, step, own.clone(), make);
        let layer = some.slots.len() / brick_counts(dims)[D - 1];
        let own = own.start * together * layer..own.end * together * layer;
        for (brick, slot) in some.slots.iter_mut().enumerate() {
            if !own.contains(&brick) {
                *slot = UNKNOWN_BRICK;
            }
        }
        some.is_distributed = true;
        some
    }

    /// The layers of samples that one of `count` is asked for where each makes a share.
    pub fn rank_layers(dims: [usize; D], rank: usize, count: usize) -> Range<usize> {
        let (parts, together) = part_layout(dims);
        let own = partition_range(parts, rank, count);
        match own.is_empty() {
            true => 0..0,
            false => sample_layers(dims, own.start * together..own.end * together),
        }
    }

    fn from_parts(
        dims: [usize; D],
        step: [f64; D],
        parts: Range<usize>,
        make: impl Fn(Range<usize>, &mut Vec<f32>) + Sync,
    ) -> Self {
        let count = brick_counts(dims)[D - 1];
        let (_, together) = self::part_layout(dims);
        let kept: Vec<BrickSet> = parts
            .into_par_iter()
            .map_init(Vec::new, |samples, part| {
                let [first, end] = [part * together, ((part + 1) * together).min(count)];
                let Range {
                    start: from,
                    end: to,
                } = sample_layers(dims, first..end);
                make(from..to, samples);
                let slab = LayerSlab {
                    dims,
                    first_layer: from,
                    end_layer: to,
                    samples,
                };
                slab.nonzero_bricks(first..end)
            })
            .collect();
        let mut all = Self::zero(dims, step);
        all.insert_all(kept);
        all
    }

    /// Keeps bricks, in the order of parts, of which none has any.
    fn insert_all(&mut self, kept: Vec<BrickSet>) {
        self.samples = vec![0.0; kept.iter().map(|part| part.samples.len()).sum()];
        let (mut rest, mut rooms) = (&mut self.samples[..], Vec::with_capacity(kept.len()));
        for part in &kept {
            let (room, others) = rest.split_at_mut(part.samples.len());
            rooms.push(room);
            rest = others;
            for &(brick, mask) in &part.bricks {
                self.slots[brick] = self.masks.len() as u32;
                self.masks.push(mask);
            }
        }
        let parts = kept.into_par_iter().zip(rooms);
        parts.for_each(|(part, room)| room.copy_from_slice(&part.samples));
    }

    /// Of a function of which each of a group has a share, all.
    ///
    /// # Errors
    /// Those of the others.
    pub(crate) fn all_gather(&self, group: &dyn Comm) -> Result<Self> {
        let own = (0..self.slots.len()).filter(|&brick| self.slots[brick] < UNKNOWN_BRICK);
        let all = group.all_gather("bricks of a potential", self.select_bricks(own))?;
        let mut whole = Self::zero(self.dims, self.step);
        whole.insert_all(all);
        Ok(whole)
    }

    /// Of a function of which each of a group has a share, what is no farther than `reach` from some positions along each
    /// axis; what is [asked for](Self::miss_flag) elsewhere is zero.
    ///
    /// # Errors
    /// Those of the others.
    pub(crate) fn gather_neighbourhood(
        &self,
        positions: &[[f64; D]],
        reach: f64,
        group: &dyn Comm,
    ) -> Result<Self> {
        let along = brick_counts(self.dims);
        let wanted = morphology::bricks_near(positions, reach, along, (BRICK_CELLS, self.step));
        let (parts, together) = part_layout(self.dims);
        let layer = wanted.len() / along[D - 1];
        let asked = (0..group.size()).map(|rank| {
            let own = partition_range(parts, rank, group.size());
            let end = (own.end * together * layer).min(wanted.len());
            let own = (own.start * together * layer).min(end)..end;
            own.filter(|&brick| wanted[brick]).collect()
        });
        let asked: Vec<Vec<usize>> = group.all_to_all("bricks that are wanted", asked.collect())?;
        let kept = |asked: &[usize]| -> Vec<usize> {
            let kept = |brick: &usize| self.slots[*brick] < UNKNOWN_BRICK;
            asked.iter().copied().filter(kept).collect()
        };
        let told = asked
            .iter()
            .enumerate()
            .map(|(rank, asked)| match rank == group.rank() {
                true => BrickSet::default(),
                false => self.select_bricks(kept(asked).into_iter()),
            });
        let told = group.all_to_all("bricks of a potential", told.collect())?;
        let mut near = Self::zero(self.dims, self.step);
        for (slot, wanted) in near.slots.iter_mut().zip(wanted) {
            if !wanted {
                *slot = UNKNOWN_BRICK;
            }
        }
        // What is here need not be passed on, nor held once more on the way.
        let own = kept(&asked[group.rank()]);
        let count = own.len() + told.iter().map(|told| told.bricks.len()).sum::<usize>();
        near.masks.reserve_exact(count);
        near.samples.reserve_exact(count * brick_len(D));
        for (rank, told) in told.into_iter().enumerate() {
            if rank == group.rank() {
                for &brick in &own {
                    let slot = self.slots[brick];
                    near.insert(brick, self.masks[slot as usize], self.brick_samples(slot));
                }
            }
            for (&(brick, mask), samples) in
                told.bricks.iter().zip(told.samples.chunks(brick_len(D)))
            {
                near.insert(brick, mask, samples);
            }
        }
        Ok(near)
    }

    /// Some of the bricks that are kept.
    fn select_bricks(&self, numbers: impl Iterator<Item = usize>) -> BrickSet {
        let mut some = BrickSet::default();
        for brick in numbers {
            let slot = self.slots[brick];
            some.bricks.push((brick, self.masks[slot as usize]));
            some.samples.extend_from_slice(self.brick_samples(slot));
        }
        some
    }

    /// Whether it was asked for where nothing is known here.
    pub(crate) fn has_missed(&self) -> bool {
        self.miss_flag.is_set()
    }

    /// Of samples that are all there.
    pub fn from_field(field: &ScalarField<D>) -> Self {
        let layer: usize = field.dims[..D - 1].iter().product();
        let part = |layers: Range<usize>, samples: &mut Vec<f32>| {
            samples.clear();
            samples.extend_from_slice(&field.samples[layers.start * layer..layers.end * layer]);
        };
        Self::from_layers(field.dims, field.step, part)
    }

    fn insert(&mut self, brick: usize, mask: u64, samples: &[f32]) {
        self.slots[brick] = self.masks.len() as u32;
        self.masks.push(mask);
        self.samples.extend_from_slice(samples);
    }

    /// `with` of the samples of this and another function of the same box; zero where both are.
    pub fn combine(&self, other: &Self, with: impl Fn(f32, f32) -> f32) -> Self {
        let mut all = Self::zero(self.dims, self.step);
        all.is_distributed = self.is_distributed || other.is_distributed;
        let nothing = vec![0.0; brick_len(D)];
        for brick in 0..self.slots.len() {
            let [a, b] = [self, other].map(|one| one.slots[brick]);
            if a >= UNKNOWN_BRICK && b >= UNKNOWN_BRICK {
                all.slots[brick] = a.min(b);
                continue;
            }
            let part = |one: &Self, slot: u32| match slot {
                ZERO_BRICK | UNKNOWN_BRICK => nothing.clone(),
                slot => one.brick_samples(slot).to_vec(),
            };
            let (a, b) = (part(self, a), part(other, b));
            let samples: Vec<f32> = a.iter().zip(&b).map(|(a, b)| with(*a, *b)).collect();
            all.insert(brick, block_mask::<D>(&samples), &samples);
        }
        all
    }

    /// All samples.
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
                let at: [usize; D] = sample_offset(i);
                let inside = (0..D).all(|k| (1..=self.dims[k]).contains(&(first[k] + at[k])));
                if inside {
                    let to = (0..D)
                        .rev()
                        .fold(0, |to, k| to * self.dims[k] + first[k] + at[k] - 1);
                    samples[to] = *value;
                }
            }
        }
        ScalarField {
            dims: self.dims,
            step: self.step,
            samples,
        }
    }

    /// Whether it is zero everywhere.
    pub fn is_zero(&self) -> bool {
        self.masks.iter().all(|mask| *mask == 0)
    }

    /// The far corner of the box; the near one is the origin.
    pub fn extent(&self) -> [f64; D] {
        std::array::from_fn(|k| (self.dims[k].max(1) - 1) as f64 * self.step[k])
    }

    /// The interpolated value at a position in lattice space.
    pub fn value(&self, position: [f64; D]) -> f64 {
        self.value_and_gradient(position).0
    }

    /// The interpolated value and its exact gradient at a position in lattice space, as
    /// [`ScalarField::value_and_gradient`] has them.
    pub fn value_and_gradient(&self, position: [f64; D]) -> (f64, [f64; D]) {
        self.nonzero_value_and_gradient(position)
            .unwrap_or((0.0, [0.0; D]))
    }

    /// The same, or `None` where every tap is zero.
    #[inline]
    pub fn nonzero_value_and_gradient(&self, position: [f64; D]) -> Option<(f64, [f64; D])> {
        let (mut brick, mut block) = (0, 0);
        let mut within = [0; D];
        for k in (0..D).rev() {
            let cells = self.dims[k].saturating_sub(1).max(1);
            // Below zero it becomes zero.
            let cell = ((position[k] / self.step[k]) as usize).min(cells - 1);
            within[k] = cell % BRICK_CELLS;
            brick = brick * cells.div_ceil(BRICK_CELLS) + cell / BRICK_CELLS;
            block = block * BRICK_BLOCKS + within[k] / BLOCK_CELLS;
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
        let mut stride = 1;
        let taps: [Taps; D] = std::array::from_fn(|k| {
            let mut taps = Taps::new(position[k], self.dims[k], self.step[k], 0);
            taps.offsets = std::array::from_fn(|tap| (within[k] + tap) * stride);
            stride *= BRICK_SAMPLES;
            taps
        });
        let base = samples[taps.iter().map(|t| t.offsets[1]).sum::<usize>()];
        let line = |start: usize| -> [f32; 4] {
            let line = &samples[start + within[0]..][..4];
            [line[0], line[1], line[2], line[3]].map(|sample| sample - base)
        };
        Some(interpolate(&taps, base, line))
    }

    #[inline]
    fn brick_samples(&self, slot: u32) -> &[f32] {
        &self.samples[slot as usize * brick_len(D)..][..brick_len(D)]
    }
}

/// The first cell of a brick, which is where its second sample stands.
fn brick_corner<const D: usize>(number: usize, bricks: [usize; D]) -> [usize; D] {
    let mut rest = number;
    std::array::from_fn(|k| {
        let brick = rest % bricks[k];
        rest /= bricks[k];
        brick * BRICK_CELLS
    })
}

/// Where the `i`th sample of a brick stands in it.
fn sample_offset<const D: usize>(i: usize) -> [usize; D] {
    let mut rest = i;
    std::array::from_fn(|_| {
        let at = rest % BRICK_SAMPLES;
        rest /= BRICK_SAMPLES;
        at
    })
}

/// The blocks of a brick along one axis that have its sample `j` as a tap.
fn tapped_blocks(j: usize) -> Range<usize> {
    j.saturating_sub(3) / BLOCK_CELLS..j.min(BRICK_CELLS - 1) / BLOCK_CELLS + 1
}

/// The blocks of a brick in which its samples are not all zero.
fn block_mask<const D: usize>(samples: &[f32]) -> u64 {
    let mut mask = 0u64;
    for (row, line) in samples.chunks(BRICK_SAMPLES).enumerate() {
        let mut along = 0u64;
        for (j, _) in line.iter().enumerate().filter(|s| *s.1 != 0.0) {
            tapped_blocks(j).for_each(|block| along |= 1 << block);
        }
        if along == 0 {
            continue;
        }
        let (mut rest, mut shift) = (row, BRICK_BLOCKS);
        for _ in 1..D {
            let wide = along;
            along = tapped_blocks(rest % BRICK_SAMPLES)
                .fold(0, |all, block| all | wide << (block * shift));
            rest /= BRICK_SAMPLES;
            shift *= BRICK_BLOCKS;
        }
        mask |= along;
    }
    mask
}

/// Some layers of samples along the last axis.
struct LayerSlab<'a, const D: usize> {
    /// Of the whole box.
    dims: [usize; D],
    first_layer: usize,
    end_layer: usize,
    samples: &'a [f32],
}

impl<const D: usize> LayerSlab<'_, D> {
    /// The bricks of some layers of these that are not zero.
    fn nonzero_bricks(&self, layers: Range<usize>) -> BrickSet {
        let mut some = brick_counts(self.dims);
        some[D - 1] = layers.len();
        let occupied = self.occupied_bricks(some, layers.start);
        let below = layers.start * some[..D - 1].iter().product::<usize>();
        let mut kept = BrickSet::default();
        for (number, _) in occupied.iter().enumerate().filter(|b| *b.1) {
            let mut first = brick_corner(number, some);
            first[D - 1] += layers.start * BRICK_CELLS;
            let before = kept.samples.len();
            self.append_brick(first, &mut kept.samples);
            match block_mask::<D>(&kept.samples[before..]) {
                0 => kept.samples.truncate(before),
                mask => kept.bricks.push((below + number, mask)),
            }
        }
        kept
    }

    /// Which of `some` bricks, from a layer of bricks on, have a sample that is not zero.
    fn occupied_bricks(&self, some: [usize; D], first: usize) -> Vec<bool> {
        // The bricks along an axis that hold a sample, of those there are.
        let holding = |at: usize, k: usize| {
            let skipped = if k == D - 1 { first } else { 0 };
            let low = at.saturating_sub(BRICK_SAMPLES - 2).div_ceil(BRICK_CELLS);
            let high = ((at + 1) / BRICK_CELLS).min(skipped + some[k] - 1);
            low.max(skipped) - skipped..high + 1 - skipped
        };
        let mut occupied = vec![false; some.iter().product()];
        let mut along = vec![false; some[0]];
        for (row, line) in self.samples.chunks_exact(self.dims[0].max(1)).enumerate() {
            let mut any = false;
            for (part, eight) in line.chunks(BRICK_CELLS).enumerate() {
                if eight.iter().all(|&b| b == 0.0) {
                    continue;
                }
                any = true;
                for (n, _) in eight.iter().enumerate().filter(|s| *s.1 != 0.0) {
                    along[holding(part * BRICK_CELLS + n, 0)].fill(true);
                }
            }
            if !any {
                continue;
            }
            let mut starts = vec![0];
            let (mut rest, mut stride) = (row, some[0]);
            for k in 1..D {
                let at = match k == D - 1 {
                    true => rest + self.first_layer,
                    false => rest % self.dims[k],
                };
                rest /= self.dims[k];
                let beside = holding(at, k);
                starts = starts
                    .iter()
                    .flat_map(|start| beside.clone().map(move |b| start + b * stride))
                    .collect();
                stride *= some[k];
            }
            for start in starts {
                let row = occupied[start..start + some[0]].iter_mut();
                row.zip(&along).for_each(|(all, one)| *all |= one);
            }
            along.fill(false);
        }
        occupied
    }

    /// Adds the samples of the brick whose first cell this is; beyond the box its outermost ones repeat.
    fn append_brick(&self, first: [usize; D], samples: &mut Vec<f32>) {
        let sample = |j: usize, k: usize| (first[k] + j).saturating_sub(1).min(self.dims[k] - 1);
        for row in 0..brick_len(D) / BRICK_SAMPLES {
            let (mut rest, mut start, mut stride) = (row, 0, self.dims[0]);
            for k in 1..D {
                let at = sample(rest % BRICK_SAMPLES, k);
                start += stride
                    * match k == D - 1 {
                        true => at.clamp(self.first_layer, self.end_layer - 1) - self.first_layer,
                        false => at,
                    };
                rest /= BRICK_SAMPLES;
                stride *= self.dims[k];
            }
            samples.extend((0..BRICK_SAMPLES).map(|j| self.samples[start + sample(j, 0)]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    /// A bent valley three samples wide, and a single sample that is not zero.
    fn valley<const D: usize>(dims: [usize; D], step: [f64; D]) -> ScalarField<D> {
        let mut field = ScalarField::from_fn(dims, step, |x| {
            let bent = x[0] / step[0] - 9.0 - 0.02 * (x[1] / step[1] - 7.0).powi(2);
            -(1.0 - 0.5 * bent.abs()).max(0.0)
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
            // Some lie on samples, some on sides, some outside.
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
    fn it_is_the_field_it_was_made_of() {
        check_against_dense([41, 30, 25], [1.0, 0.5, 2.0]);
        check_against_dense([33, 17, 70], [1.0; 3]);
        check_against_dense([60, 43], [1.0, 0.25]);
        check_against_dense([41, 30, 1], [1.0; 3]);
    }

    #[test]
    fn what_is_zero_takes_no_room() {
        let sparse = SparseField::from_field(&valley([120, 110, 100], [1.0; 3]));
        let kept = sparse.samples.len() as f64 / (120.0 * 110.0 * 100.0);
        assert!(kept < 0.6, "{kept}");
        let zero = SparseField::<3>::zero([30, 20, 10], [1.0; 3]);
        assert!(zero.is_zero() && !sparse.is_zero());
        assert_eq!(zero, SparseField::from_field(&zero.to_dense()));
    }

    #[test]
    fn shares_are_the_whole_and_each_has_what_it_wants() {
        use crate::comm::run_threads;

        // Layers so large that there are several parts.
        let dims = [61, 50, 290];
        let field = valley(dims, [1.0; 3]);
        let whole = SparseField::from_field(&field);
        let layer = dims[0] * dims[1];
        let make = |layers: Range<usize>, samples: &mut Vec<f32>| {
            samples.clear();
            samples.extend(&field.samples[layers.start * layer..layers.end * layer]);
        };
        for count in [1, 2, 3, 7] {
            let shares = run_threads(count, |group| {
                let own = SparseField::from_layers_distributed(dims, [1.0; 3], group, make);
                assert!(own.is_distributed && own.all_gather(group).unwrap() == whole);
                let twice = own.combine(&own, |a, b| a + b).all_gather(group).unwrap();
                assert!(twice == whole.combine(&whole, |a, b| a + b));
                let mut random = Random::new(group.rank() as u64);
                let middle = random.range(0.0, 280.0);
                let mut place = || {
                    let x = [random.range(0.0, 60.0), random.range(0.0, 49.0)];
                    [x[0], x[1], middle + random.range(0.0, 9.0)]
                };
                let positions: Vec<[f64; 3]> = (0..400).map(|_| place()).collect();
                let near = own.gather_neighbourhood(&positions, 3.0, group).unwrap();
                for x in &positions {
                    let x = x.map(|x| (x + 2.9).max(0.0));
                    assert_eq!(near.value_and_gradient(x), whole.value_and_gradient(x));
                }
                assert!(!near.has_missed());
                near.value([30.0, 30.0, if middle > 150.0 { 3.0 } else { 285.0 }]);
                assert!(near.has_missed());
                own.samples.len()
            });
            assert_eq!(shares.iter().sum::<usize>(), whole.samples.len(), "{count}");
        }
    }

    #[test]
    fn two_are_combined_sample_by_sample() {
        let dims = [37, 29, 22];
        let one = valley(dims, [1.0; 3]);
        let other = ScalarField::from_fn(dims, [1.0; 3], |x| -(1.5 - (x[2] - 12.0).abs()).max(0.0));
        let deepest = |a: f32, b: f32| (0.5 * a).min(0.8 * b);
        let both = SparseField::from_field(&one).combine(&SparseField::from_field(&other), deepest);
        let samples = one.samples.iter().zip(&other.samples);
        let samples = samples.map(|(a, b)| deepest(*a, *b)).collect();
        let truth = ScalarField { samples, ..one };
        assert_eq!(both.to_dense(), truth);
        for n in 0..5_000 {
            let x = std::array::from_fn(|k| f64::from(n * (7919 + 31 * k as u32) % 997) / 40.0);
            assert_eq!(both.value_and_gradient(x), truth.value_and_gradient(x));
        }
    }
}
