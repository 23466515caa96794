//! How often random shortest paths pass each sample, and the closed path round an object.
//!
//! Where the thesis is open or cannot be followed to the letter:
//!
//! - Both the weight exp(-0.1 |grad I|) of a step and the slowness of the fronts depend on the grey
//!   scale: it is stretched to 0 .. 255. The slowness is exp(0.1 |grad I|), the step's inverse; without
//!   the 0.1 it would overflow.
//! - A point is drawn with probability 1 - M / T, M its marching distance; T is the distance at which
//!   the front first reaches a point of the other kind.
//! - The last path joins the most confident sample to its neighbour, the step between them barred.
//!   Nothing keeps it from taking the next four samples; here it must go round the object's first
//!   point, by searching twice the graph: a step over the ray from that point leads from one copy into
//!   the other. A step costs what it did before, over its ends' mean confidence: the confidence alone,
//!   low where few sinks lie behind a piece of the boundary, lets the path cut through the object.

use super::PathSeeds;
use super::marching::{Queue, fast_marching};
use crate::error::{Error, Result, cause};
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::volume::Volume;
use crate::geometry::random::uniform;
use crate::image::Geometry;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// What paths tell of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct EnhancedEdges {
    /// For every sample, the share of the paths that pass it.
    pub confidence: Vec<f32>,
    /// The samples of the closed path round the object, in order; none if confident samples do not
    /// surround it.
    pub boundary: Option<Vec<usize>>,
}

/// How much the gradient of a grey scale of 0 to 255 matters.
const GRADIENT_WEIGHT: f32 = 0.1;

/// Draws in vain, for each point wanted, until too few are taken for none.
const MAX_REJECTED_DRAWS: usize = 10_000;

/// No sample.
const NO_SAMPLE: u32 = u32::MAX;

/// Enhances the edges of an object in an image of which `smoothed` holds the samples.
///
/// # Errors
/// [`Error::Feature`] for an image that is not of the plane, without a point of the object, for points
/// outside the image, and where object and background cannot be told apart.
pub fn enhance<const D: usize>(
    smoothed: Volume<'_, D>,
    geometry: &Geometry<D>,
    seeds: &PathSeeds<D>,
    patience: &CancelToken<'_>,
) -> Result<EnhancedEdges> {
    let fail = |problem: &str, remedy: &str| {
        Err(Error::Feature(cause("feature 'paths'", problem, remedy)))
    };
    if D != 2 {
        return fail(
            "is for 2-D images: in 3-D a closed path encloses nothing",
            "choose canny or edges, or take a section",
        );
    }
    if seeds.object.is_empty() {
        return Err(Error::Feature(
            cause(
                "feature 'paths'",
                "does not know where the object is",
                "give a point inside it",
            )
            .with_parameter("object"),
        ));
    }
    let dims = smoothed.dims;
    let sample = |point: &[f64; D]| sample_at(point, geometry, smoothed);
    let object: Vec<usize> = seeds.object.iter().map(sample).collect::<Result<_>>()?;
    let mut background: Vec<usize> = seeds.background.iter().map(sample).collect::<Result<_>>()?;
    if background.is_empty() {
        background = border_samples(smoothed).collect();
    }
    let gentle = edge_slowness(smoothed, patience);
    let slowness: Vec<f32> = gentle.iter().map(|g| 1.0 / g).collect();
    let drawn = |starts: &[usize], others: &[usize], count: usize, key: u64| {
        let distance = fast_marching(dims, [1.0; D], &slowness, starts, patience);
        let until = others.iter().map(|&i| distance[i]);
        let until = until.fold(f32::INFINITY, f32::min);
        draw_samples(&distance, until, count, seeds.seed.wrapping_add(key))
    };
    let sources = drawn(&object, &background, seeds.sources, 0);
    let sinks = drawn(&background, &object, seeds.sinks, 1 << 32);
    if sources.len() < seeds.sources || sinks.len() < seeds.sinks {
        return fail(
            "cannot tell the object from the background: a point of one lies at one of the other",
            "give points of the object inside it, and points of the background around it",
        );
    }
    let counts = path_counts(smoothed, &gentle, &sources, &sinks, patience);
    let per_path = 1.0 / (sources.len() * sinks.len()).max(1) as f32;
    Ok(EnhancedEdges {
        boundary: closed_path(smoothed, &gentle, &counts, object[0]),
        confidence: counts.iter().map(|&c| c as f32 * per_path).collect(),
    })
}

/// The sample nearest to a physical point.
fn sample_at<const D: usize>(
    point: &[f64; D],
    geometry: &Geometry<D>,
    volume: Volume<'_, D>,
) -> Result<usize> {
    let inside =
        |at: &[f64; D]| (0..D).all(|k| at[k] >= -0.5 && at[k] < volume.dims[k] as f64 - 0.5);
    match geometry.to_index(*point).filter(inside) {
        Some(at) => Ok(volume.index(at.map(|i| i.round() as usize))),
        None => Err(Error::Feature(cause(
            format!("feature 'paths': point {point:?}"),
            format!("lies outside the image of {:?} samples", volume.dims),
            "give points inside, in the image's physical coordinates",
        ))),
    }
}

/// The samples on the sides of the image.
fn border_samples<const D: usize>(volume: Volume<'_, D>) -> impl Iterator<Item = usize> {
    (0..volume.dims.iter().product()).filter(move |&i| {
        let at = volume.coordinates(i);
        (0..D).any(|k| at[k] == 0 || at[k] + 1 == volume.dims[k])
    })
}

/// Formula 25 for every sample: 1 on even ground, near 0 on edges.
fn edge_slowness<const D: usize>(smoothed: Volume<'_, D>, patience: &CancelToken<'_>) -> Vec<f32> {
    let extremes = |(low, high): (f32, f32), &s: &f32| (low.min(s), high.max(s));
    let (low, high) = smoothed
        .samples
        .iter()
        .fold((f32::INFINITY, f32::NEG_INFINITY), extremes);
    let grey = 255.0 / (high - low).max(f32::MIN_POSITIVE);
    let mut gentle = gradient_magnitude(smoothed, patience);
    gentle
        .iter_mut()
        .for_each(|g| *g = (-GRADIENT_WEIGHT * grey * *g).exp());
    gentle
}

/// Samples drawn at random, kept with probability 1 - distance / until.
fn draw_samples(distance: &[f32], until: f32, count: usize, key: u64) -> Vec<usize> {
    let mut drawn = Vec::with_capacity(count);
    for n in 0..(MAX_REJECTED_DRAWS * count) as u64 {
        if drawn.len() == count {
            break;
        }
        let sample = (uniform(key, 2 * n) * distance.len() as f64) as usize;
        if f64::from(distance[sample]) < uniform(key, 2 * n + 1) * f64::from(until) {
            drawn.push(sample);
        }
    }
    drawn
}

/// How many of the shortest paths from all sources to all sinks pass each sample. A step between two
/// neighbours costs the mean of how gentle they are (formula 26).
fn path_counts<const D: usize>(
    grid: Volume<'_, D>,
    gentle: &[f32],
    sources: &[usize],
    sinks: &[usize],
    patience: &CancelToken<'_>,
) -> Vec<u32> {
    let parts: Vec<Vec<u32>> = sources
        .par_iter()
        .map(|&source| {
            let before = shortest_path_tree(grid, gentle, source, sinks, patience);
            let mut passed = Vec::new();
            for &sink in sinks {
                let mut at = sink as u32;
                while at != NO_SAMPLE {
                    passed.push(at);
                    at = before[at as usize];
                }
            }
            passed
        })
        .collect();
    let mut counts = vec![0u32; gentle.len()];
    for &i in parts.iter().flatten() {
        counts[i as usize] += 1;
    }
    counts
}

/// The sample before each on the shortest path from the source, until all sinks are reached.
fn shortest_path_tree<const D: usize>(
    grid: Volume<'_, D>,
    gentle: &[f32],
    source: usize,
    sinks: &[usize],
    patience: &CancelToken<'_>,
) -> Vec<u32> {
    let mut cost = vec![f32::INFINITY; gentle.len()];
    let mut before = vec![NO_SAMPLE; gentle.len()];
    let mut wanted: Vec<usize> = sinks.to_vec();
    wanted.sort_unstable();
    wanted.dedup();
    let mut left = wanted.len();
    let mut queue = Queue::default();
    cost[source] = 0.0;
    queue.push(0.0, source);
    while let Some((so_far, i)) = queue.pop() {
        if so_far > cost[i] {
            continue;
        }
        if patience.is_cancelled() {
            break;
        }
        if wanted.binary_search(&i).is_ok() {
            left -= 1;
            if left == 0 {
                break;
            }
        }
        for_each_neighbour(grid, i, |j| {
            let then = so_far + 0.5 * (gentle[i] + gentle[j]);
            if then < cost[j] {
                cost[j] = then;
                before[j] = i as u32;
                queue.push(then, j);
            }
        });
    }
    before
}

/// Calls `visit` for the neighbours of a sample along the axes.
#[inline]
fn for_each_neighbour<const D: usize>(grid: Volume<'_, D>, i: usize, mut visit: impl FnMut(usize)) {
    let (before, after) = grid.neighbour_offsets(grid.coordinates(i));
    for k in 0..D {
        if before[k] > 0 {
            visit(i - before[k]);
        }
        if after[k] > 0 {
            visit(i + after[k]);
        }
    }
}

/// The cheapest closed path over samples that any path passes, an odd number of times over the ray from
/// `inside` along the first axis.
///
/// It goes through the sample opposite to where the cheapest one through the most confident sample
/// of all comes to the boundary: that sample itself may lie beside it.
fn closed_path<const D: usize>(
    grid: Volume<'_, D>,
    gentle: &[f32],
    counts: &[u32],
    inside: usize,
) -> Option<Vec<usize>> {
    let surest = (0..counts.len()).max_by_key(|&i| (counts[i], std::cmp::Reverse(i)))?;
    let path = closed_path_through(surest, grid, gentle, counts, inside)?;
    closed_path_through(path[path.len() / 2], grid, gentle, counts, inside)
}

/// The same through one sample; where it is beside all such paths, without the way to one and back.
fn closed_path_through<const D: usize>(
    first: usize,
    grid: Volume<'_, D>,
    gentle: &[f32],
    counts: &[u32],
    inside: usize,
) -> Option<Vec<usize>> {
    let samples = counts.len();
    let centre = grid.coordinates(inside);
    // The ray runs between two rows.
    let row = centre[1].min(grid.dims[1].saturating_sub(2));
    let crosses = |i: usize, j: usize| {
        let (p, q) = (grid.coordinates(i), grid.coordinates(j));
        p[0] > centre[0] && p[1] != q[1] && p[1].min(q[1]) == row
    };
    // Sample i of the second copy is number samples + i.
    let mut cost = vec![f32::INFINITY; 2 * samples];
    let mut before = vec![NO_SAMPLE; 2 * samples];
    let mut queue = Queue::default();
    cost[first] = 0.0;
    queue.push(0.0, first);
    while let Some((so_far, here)) = queue.pop() {
        if here == samples + first {
            break;
        }
        if so_far > cost[here] {
            continue;
        }
        let (i, copy) = (here % samples, here / samples);
        for_each_neighbour(grid, i, |j| {
            if counts[j] == 0 || j == inside {
                return;
            }
            let there = j + samples * (copy ^ usize::from(crosses(i, j)));
            let then = so_far + (gentle[i] + gentle[j]) / (counts[i] + counts[j]) as f32;
            if then < cost[there] {
                cost[there] = then;
                before[there] = here as u32;
                queue.push(then, there);
            }
        });
    }
    // Back to where it began. Where a sample is met in both copies, the path has been once round in
    // between; what lies before is a way to the boundary and back.
    let mut place = vec![NO_SAMPLE; samples];
    let mut path: Vec<usize> = Vec::new();
    let mut here = (samples + first) as u32;
    while here != NO_SAMPLE {
        let i = here as usize % samples;
        if place[i] != NO_SAMPLE {
            return Some(path.split_off(place[i] as usize));
        }
        place[i] = path.len() as u32;
        path.push(i);
        here = before[here as usize];
    }
    None
}

/// 1 at the samples that a closed path surrounds, a half on the path, 0 outside.
pub fn inside_mask<const D: usize>(grid: Volume<'_, D>, path: &[usize]) -> Vec<f32> {
    let mut values = vec![1.0; grid.dims.iter().product()];
    for &i in path {
        values[i] = 0.5;
    }
    let mut open: Vec<usize> = border_samples(grid).filter(|&i| values[i] == 1.0).collect();
    open.iter().for_each(|&i| values[i] = 0.0);
    while let Some(i) = open.pop() {
        for_each_neighbour(grid, i, |j| {
            if values[j] == 1.0 {
                values[j] = 0.0;
                open.push(j);
            }
        });
    }
    values
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
