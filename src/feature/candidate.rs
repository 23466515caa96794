//! Where a sheet crosses the columns of samples.

use super::volume::Volume;
use crate::files::codec::{Codec, codec_fields};
use crate::geometry::dot;
use std::cmp::Ordering;
use std::io::{self, Write};

/// How far past the half way to the next sample a crossing still counts: neighbouring samples see
/// slightly different normals, and a double can be dropped later while a hole cannot be filled.
pub const MAX_CELL_OVERLAP: f32 = 0.05;

/// The index in memory of a sample, in 48 bits: a candidate has no room for more, and no disk so many samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Voxel([u16; 3]);

impl Voxel {
    /// So many samples have one.
    pub const MAX_COUNT: usize = 1 << 48;

    /// That of the sample `at` of `dims`.
    #[inline]
    pub fn new<const D: usize>(dims: [usize; D], at: [usize; D]) -> Self {
        let index = Volume::new(dims, &[]).index(at);
        Self([0, 16, 32].map(|bits| (index >> bits) as u16))
    }

    /// The index.
    #[inline]
    pub fn index(self) -> usize {
        let [low, middle, high] = self.0.map(usize::from);
        low | middle << 16 | high << 32
    }
}

impl Ord for Voxel {
    #[inline]
    fn cmp(&self, other: &Self) -> Ordering {
        self.index().cmp(&other.index())
    }
}

impl PartialOrd for Voxel {
    #[inline]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Codec for Voxel {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        (self.0.iter()).try_for_each(|part| out.write_all(&part.to_le_bytes()))
    }

    fn decode(from: &mut &[u8]) -> Option<Self> {
        let (&[a, b, c, d, e, f], rest) = from.split_first_chunk()?;
        *from = rest;
        Some(Self([[a, b], [c, d], [e, f]].map(u16::from_le_bytes)))
    }
}

/// A point of a sheet, in samples.
#[derive(Debug, Clone, Copy)]
pub struct Candidate<const D: usize> {
    /// Index in memory of the sample whose cell holds the point.
    pub voxel: Voxel,
    /// The axis along which the sheet was crossed: position and sample differ only along it.
    pub axis: u8,
    /// Position, in samples.
    pub position: [f32; D],
    /// Unit normal.
    pub normal: [f32; D],
    /// How strong the feature is.
    pub strength: f32,
}

codec_fields! {
    @(const D: usize) Candidate<D> as Candidate { voxel, axis, position, normal, strength }
}

impl<const D: usize> Candidate<D> {
    /// The point `offset` samples from the sample `at` along `axis`.
    pub fn new(
        dims: [usize; D],
        at: [usize; D],
        axis: usize,
        offset: f32,
        normal: [f64; D],
        strength: f32,
    ) -> Self {
        let mut position = at.map(|i| i as f32);
        position[axis] = (position[axis] + offset).clamp(0.0, (dims[axis] - 1) as f32);
        Self {
            voxel: Voxel::new(dims, at),
            axis: axis as u8,
            position,
            normal: normal.map(|c| c as f32),
            strength,
        }
    }
}

/// The axis nearest to `w`, and others as near within five per cent: where the nearest axis changes
/// along a sheet, columns of both kinds are needed to leave no hole.
pub fn dominant_axes<const D: usize>(w: [f64; D]) -> impl Iterator<Item = usize> {
    let most = w.iter().fold(0.0f64, |a, c| a.max(c.abs()));
    (0..D).filter(move |&k| w[k].abs() >= 0.95 * most)
}

/// Where, along `axis` and in samples from `at`, the derivative along `w` falls through zero (a
/// ridge) within half a sample of `at`.
pub fn ridge_offset<const D: usize>(
    volume: Volume<'_, D>,
    at: [usize; D],
    w: [f64; D],
    axis: usize,
) -> Option<f32> {
    let slope = |at: [usize; D]| dot(volume.gradient(at).map(f64::from), w) * w[axis].signum();
    let here = slope(at);
    let ahead = here > 0.0;
    let mut next = at;
    if ahead {
        next[axis] += 1;
        if next[axis] >= volume.dims[axis] {
            return None;
        }
    } else {
        next[axis] = next[axis].checked_sub(1)?;
    }
    let there = slope(next);
    if (there > 0.0) == ahead && there != 0.0 {
        return None;
    }
    let offset = (here / (here - there)) as f32;
    (offset <= 0.5 + MAX_CELL_OVERLAP).then_some(if ahead { offset } else { -offset })
}

/// The nearest sample, for positions in or near the box (without a call to the maths library).
#[inline]
pub fn nearest_sample(position: f32) -> i32 {
    (position + 1024.5) as i32 - 1024
}
