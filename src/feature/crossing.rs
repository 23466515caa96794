//! Where a sheet crosses the columns of samples.

use super::symmetric::dot;
use super::volume::Volume;

/// How far past the half way to the next sample a crossing still counts: neighbouring samples see
/// slightly different normals, and a double can be dropped later while a hole cannot be filled.
pub const OVERLAP: f32 = 0.05;

/// A point of a sheet, in samples.
#[derive(Debug, Clone, Copy)]
pub struct Candidate {
    /// Index in memory of the sample whose cell holds the point.
    pub voxel: u32,
    /// The axis along which the sheet was crossed: position and sample differ only along it.
    pub axis: u8,
    /// Position, in samples.
    pub position: [f32; 3],
    /// Unit normal.
    pub normal: [f32; 3],
    /// How strong the feature is.
    pub strength: f32,
}

impl Candidate {
    /// The point `offset` samples from the sample `at` along `axis`.
    pub fn new(
        dims: [usize; 3],
        at: [usize; 3],
        axis: usize,
        offset: f32,
        normal: [f64; 3],
        strength: f32,
    ) -> Self {
        let mut position = at.map(|i| i as f32);
        position[axis] = (position[axis] + offset).clamp(0.0, (dims[axis] - 1) as f32);
        let voxel = ((at[2] * dims[1] + at[1]) * dims[0] + at[0]) as u32;
        Self {
            voxel,
            axis: axis as u8,
            position,
            normal: normal.map(|c| c as f32),
            strength,
        }
    }
}

/// The axis nearest to `w`, and others as near within five per cent: where the nearest axis changes
/// along a sheet, columns of both kinds are needed to leave no hole.
pub fn dominant_axes(w: [f64; 3]) -> impl Iterator<Item = usize> {
    let most = w.iter().fold(0.0f64, |a, c| a.max(c.abs()));
    (0..3).filter(move |&k| w[k].abs() >= 0.95 * most)
}

/// Where, along `axis` and in samples from `at`, the derivative along `w` falls through zero (a
/// ridge) within half a sample of `at`.
pub fn along_axis(volume: Volume<'_>, at: [usize; 3], w: [f64; 3], axis: usize) -> Option<f32> {
    let slope = |at: [usize; 3]| dot(volume.gradient(at).map(f64::from), w) * w[axis].signum();
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
    (offset <= 0.5 + OVERLAP).then_some(if ahead { offset } else { -offset })
}
