//! Points at which a feature surface crosses the columns of samples.

use super::volume::Volume;
use crate::files::codec::{Codec, codec_fields};
use crate::geometry::dot;
use std::cmp::Ordering;
use std::io::{self, Write};

/// Distance (samples) past the midpoint to the next sample within which a crossing still counts.
/// Neighbouring samples see slightly different normals; a duplicate can be removed later, but a
/// hole cannot be filled.
pub const MAX_CELL_OVERLAP: f32 = 0.05;

/// Index in memory of a sample, in 48 bits, to keep candidates small. No disk holds more samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Voxel([u16; 3]);

impl Voxel {
    /// Number of samples that can be indexed.
    pub const MAX_COUNT: u64 = 1 << 48;

    /// Returns the index of sample `at` in a volume of `dims` samples.
    #[inline]
    pub fn new<const D: usize>(dims: [usize; D], at: [usize; D]) -> Self {
        let index = Volume::new(dims, &[]).index(at) as u64;
        Self([0, 16, 32].map(|bits| (index >> bits) as u16))
    }

    /// Returns the index.
    #[inline]
    pub fn index(self) -> usize {
        let [low, middle, high] = self.0.map(u64::from);
        (low | middle << 16 | high << 32) as usize
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

    fn decode(input: &mut &[u8]) -> Option<Self> {
        let (&[a, b, c, d, e, f], rest) = input.split_first_chunk()?;
        *input = rest;
        Some(Self([[a, b], [c, d], [e, f]].map(u16::from_le_bytes)))
    }
}

/// A point of a feature surface, in sample coordinates.
#[derive(Debug, Clone, Copy)]
pub struct Candidate<const D: usize> {
    /// Index in memory of the sample whose cell holds the point.
    pub voxel: Voxel,
    /// Axis along which the surface was crossed: position and sample differ only along it.
    pub axis: u8,
    /// Position in sample coordinates.
    pub position: [f32; D],
    /// Unit normal.
    pub normal: [f32; D],
    /// Strength of the feature at the point.
    pub strength: f32,
}

codec_fields! {
    @(const D: usize) Candidate<D> as Candidate { voxel, axis, position, normal, strength }
}

impl<const D: usize> Candidate<D> {
    /// Returns the point that is `offset` samples from sample `at` along `axis`.
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

/// Returns the axis nearest to `w`, and other axes whose component is at least 95 % of its
/// component. Where the nearest axis changes along a surface, columns along both axes are needed to
/// leave no hole.
pub fn dominant_axes<const D: usize>(w: [f64; D]) -> impl Iterator<Item = usize> {
    let max = w.iter().fold(0.0f64, |a, c| a.max(c.abs()));
    (0..D).filter(move |&k| w[k].abs() >= 0.95 * max)
}

/// Returns the offset along `axis`, in samples from `at`, at which the derivative along `w` falls
/// through zero (a ridge), if it is within half a sample.
pub fn ridge_offset<const D: usize>(
    volume: Volume<'_, D>,
    at: [usize; D],
    w: [f64; D],
    axis: usize,
) -> Option<f32> {
    let slope = |at: [usize; D]| dot(volume.gradient(at).map(f64::from), w) * w[axis].signum();
    let slope_here = slope(at);
    let ahead = slope_here > 0.0;
    let mut next = at;
    if ahead {
        next[axis] += 1;
        if next[axis] >= volume.dims[axis] {
            return None;
        }
    } else {
        next[axis] = next[axis].checked_sub(1)?;
    }
    let slope_next = slope(next);
    if (slope_next > 0.0) == ahead && slope_next != 0.0 {
        return None;
    }
    let offset = (slope_here / (slope_here - slope_next)) as f32;
    (offset <= 0.5 + MAX_CELL_OVERLAP).then_some(if ahead { offset } else { -offset })
}

/// Returns the nearest sample of a position in or near the box, without a call to the maths
/// library.
#[inline]
pub fn nearest_sample(position: f32) -> i32 {
    (position + 1024.5) as i32 - 1024
}
