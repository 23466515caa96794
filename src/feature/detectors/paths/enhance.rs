//! Confidence of samples by random shortest paths, and the closed path around an object.
//!
//! Decisions where the thesis leaves the details open or cannot be followed literally:
//!
//! - Both the weight exp(-0.1 |grad I|) of a step and the slowness of the fronts depend on the grey
//!   scale, which is stretched to 0 .. 255. The slowness is exp(0.1 |grad I|), the inverse of the
//!   weight; without the factor 0.1 it would overflow.
//! - A point is drawn with probability 1 - M / T, where M is its marching distance and T the
//!   distance at which the front first reaches a point of the other kind.
//! - The last path of the thesis joins the most confident sample to its neighbour without using the
//!   step between them; nothing prevents it from being a loop of a few samples. Here the path must
//!   go around the object's first point. This is enforced by a search in two copies of the graph: a
//!   step across the ray from that point leads from one copy to the other. A step costs the weight
//!   above, divided by the mean confidence of its ends. The confidence alone is low where few sinks
//!   lie behind a part of the boundary, so that the path would cut through the object.

use super::PathSeeds;
use super::marching::{Queue, fast_marching};
use crate::error::{Error, Result, cause};
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::volume::Volume;
use crate::geometry::NONE;
use crate::geometry::random::uniform;
use crate::geometry::sorted_distinct;
use crate::image::Geometry;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Confidence of edges, and the boundary of the object.
#[derive(Debug, Clone, PartialEq)]
pub struct EnhancedEdges {
    /// For every sample, the share of the paths that pass it.
    pub confidence: Vec<f32>,
    /// Samples of the closed path around the object, in order; `None` if confident samples do not
    /// surround it.
    pub boundary: Option<Vec<usize>>,
}

/// Factor of the gradient of a grey scale of 0 to 255.
const GRADIENT_WEIGHT: f32 = 0.1;

/// Largest number of rejected draws per requested point.
const MAX_REJECTED_DRAWS: usize = 10_000;

/// Enhances the edges of an object in the image `smoothed`.
///
/// # Errors
/// Returns an [`Error::Feature`] if the image is not two-dimensional, no point of the object is
/// given, a point is outside the image, or object and background cannot be distinguished.
pub fn enhance<const D: usize>(
    smoothed: Volume<'_, D>,
    geometry: &Geometry<D>,
    seeds: &PathSeeds<D>,
    cancel: &CancelToken<'_>,
) -> Result<EnhancedEdges> {
    let fail = |problem: &str, remedy: &str| {
        Err(Error::Feature(cause("feature 'paths'", problem, remedy)))
    };
    if D != 2 {
        return fail(
            "is for 2-D images: in 3-D a closed path encloses nothing",
            "choose --feature canny or edges, or take a section of the image",
        );
    }
    if seeds.object.is_empty() {
        return Err(Error::Feature(
            cause(
                "feature 'paths'",
                "needs a point inside the object",
                "give one, such as --object 120,80",
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
    let weights = edge_slowness(smoothed, cancel);
    let slowness: Vec<f32> = weights.iter().map(|g| 1.0 / g).collect();
    let draw = |starts: &[usize], other_points: &[usize], count: usize, key: u64| {
        let distance = fast_marching(dims, [1.0; D], &slowness, starts, cancel);
        let max_distance = other_points.iter().map(|&i| distance[i]);
        let max_distance = max_distance.fold(f32::INFINITY, f32::min);
        draw_samples(&distance, max_distance, count, seeds.seed.wrapping_add(key))
    };
    let sources = draw(&object, &background, seeds.sources, 0);
    let sinks = draw(&background, &object, seeds.sinks, 1 << 32);
    if sources.len() < seeds.sources || sinks.len() < seeds.sinks {
        return fail(
            "cannot tell the object from the background, because a point of one lies at a point of the other",
            "give points of the object inside it, and points of the background around it",
        );
    }
    let counts = path_counts(smoothed, &weights, &sources, &sinks, cancel);
    let per_path = 1.0 / (sources.len() * sinks.len()).max(1) as f32;
    Ok(EnhancedEdges {
        boundary: closed_path(smoothed, &weights, &counts, object[0]),
        confidence: counts.iter().map(|&c| c as f32 * per_path).collect(),
    })
}

/// Returns the sample nearest to a physical point.
fn sample_at<const D: usize>(
    point: &[f64; D],
    geometry: &Geometry<D>,
    volume: Volume<'_, D>,
) -> Result<usize> {
    let is_inside =
        |at: &[f64; D]| (0..D).all(|k| at[k] >= -0.5 && at[k] < volume.dims[k] as f64 - 0.5);
    match geometry.to_index(*point).filter(is_inside) {
        Some(at) => Ok(volume.index(at.map(|i| i.round() as usize))),
        None => Err(Error::Feature(cause(
            format!("feature 'paths': point {point:?}"),
            format!("lies outside the image of {:?} samples", volume.dims),
            "give points inside, in the image's physical coordinates",
        ))),
    }
}

/// Returns the samples on the sides of the image.
fn border_samples<const D: usize>(volume: Volume<'_, D>) -> impl Iterator<Item = usize> {
    (0..volume.dims.iter().product()).filter(move |&i| {
        let at = volume.coordinates(i);
        (0..D).any(|k| at[k] == 0 || at[k] + 1 == volume.dims[k])
    })
}

/// Returns the weight of formula 25 for every sample: 1 on flat ground, near 0 on edges.
fn edge_slowness<const D: usize>(smoothed: Volume<'_, D>, cancel: &CancelToken<'_>) -> Vec<f32> {
    let extremes = |(low, high): (f32, f32), &s: &f32| (low.min(s), high.max(s));
    let (low, high) = smoothed
        .samples
        .iter()
        .fold((f32::INFINITY, f32::NEG_INFINITY), extremes);
    let grey = 255.0 / (high - low).max(f32::MIN_POSITIVE);
    let mut weights = gradient_magnitude(smoothed, cancel);
    weights
        .iter_mut()
        .for_each(|g| *g = (-GRADIENT_WEIGHT * grey * *g).exp());
    weights
}

/// Draws `count` samples at random, each kept with probability 1 - distance / max_distance.
fn draw_samples(distance: &[f32], max_distance: f32, count: usize, key: u64) -> Vec<usize> {
    let mut drawn = Vec::with_capacity(count);
    for n in 0..(MAX_REJECTED_DRAWS * count) as u64 {
        if drawn.len() == count {
            break;
        }
        let sample = (uniform(key, 2 * n) * distance.len() as f64) as usize;
        if f64::from(distance[sample]) < uniform(key, 2 * n + 1) * f64::from(max_distance) {
            drawn.push(sample);
        }
    }
    drawn
}

/// Returns the number of shortest paths, from all sources to all sinks, that pass each sample. A
/// step between two neighbours costs the mean of their weights (formula 26).
fn path_counts<const D: usize>(
    grid: Volume<'_, D>,
    weights: &[f32],
    sources: &[usize],
    sinks: &[usize],
    cancel: &CancelToken<'_>,
) -> Vec<u32> {
    let parts: Vec<Vec<u32>> = sources
        .par_iter()
        .map(|&source| {
            let previous = shortest_path_tree(grid, weights, source, sinks, cancel);
            let mut passed = Vec::new();
            for &sink in sinks {
                let mut at = sink as u32;
                while at != NONE {
                    passed.push(at);
                    at = previous[at as usize];
                }
            }
            passed
        })
        .collect();
    let mut counts = vec![0u32; weights.len()];
    for &i in parts.iter().flatten() {
        counts[i as usize] += 1;
    }
    counts
}

/// Returns the sample before each one on the shortest path from the source, until all sinks are
/// reached.
fn shortest_path_tree<const D: usize>(
    grid: Volume<'_, D>,
    weights: &[f32],
    source: usize,
    sinks: &[usize],
    cancel: &CancelToken<'_>,
) -> Vec<u32> {
    let mut cost = vec![f32::INFINITY; weights.len()];
    let mut previous = vec![NONE; weights.len()];
    let targets = sorted_distinct(sinks.iter().copied());
    let mut remaining = targets.len();
    let mut queue = Queue::default();
    cost[source] = 0.0;
    queue.push(0.0, source);
    while let Some((path_cost, i)) = queue.pop() {
        if path_cost > cost[i] {
            continue;
        }
        if cancel.is_cancelled() {
            break;
        }
        if targets.binary_search(&i).is_ok() {
            remaining -= 1;
            if remaining == 0 {
                break;
            }
        }
        for_each_neighbour(grid, i, |j| {
            let new_cost = path_cost + 0.5 * (weights[i] + weights[j]);
            if new_cost < cost[j] {
                cost[j] = new_cost;
                previous[j] = i as u32;
                queue.push(new_cost, j);
            }
        });
    }
    previous
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

/// Returns the cheapest closed path, over samples that any path passes, that crosses the ray from
/// `inside` along the first axis an odd number of times.
///
/// A first closed path is searched for through the most confident sample, which may lie beside the
/// boundary. The result is the closed path through the sample in the middle of the first one.
fn closed_path<const D: usize>(
    grid: Volume<'_, D>,
    weights: &[f32],
    counts: &[u32],
    inside: usize,
) -> Option<Vec<usize>> {
    let most_confident = (0..counts.len()).max_by_key(|&i| (counts[i], std::cmp::Reverse(i)))?;
    let path = closed_path_through(most_confident, grid, weights, counts, inside)?;
    closed_path_through(path[path.len() / 2], grid, weights, counts, inside)
}

/// Returns the cheapest closed path through one sample. If that sample is not on the loop, the way
/// to the loop and back is removed.
fn closed_path_through<const D: usize>(
    first: usize,
    grid: Volume<'_, D>,
    weights: &[f32],
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
    // Sample i of the second copy has the index samples + i.
    let mut cost = vec![f32::INFINITY; 2 * samples];
    let mut previous = vec![NONE; 2 * samples];
    let mut queue = Queue::default();
    cost[first] = 0.0;
    queue.push(0.0, first);
    while let Some((path_cost, node)) = queue.pop() {
        if node == samples + first {
            break;
        }
        if path_cost > cost[node] {
            continue;
        }
        let (i, copy) = (node % samples, node / samples);
        for_each_neighbour(grid, i, |j| {
            if counts[j] == 0 || j == inside {
                return;
            }
            let neighbour = j + samples * (copy ^ usize::from(crosses(i, j)));
            let new_cost = path_cost + (weights[i] + weights[j]) / (counts[i] + counts[j]) as f32;
            if new_cost < cost[neighbour] {
                cost[neighbour] = new_cost;
                previous[neighbour] = node as u32;
                queue.push(new_cost, neighbour);
            }
        });
    }
    // The path is followed back to its start. If it meets a sample in both copies, it has gone
    // around once in between; the part before is the way to the loop and back.
    let mut position_on_path = vec![NONE; samples];
    let mut path: Vec<usize> = Vec::new();
    let mut node = (samples + first) as u32;
    while node != NONE {
        let i = node as usize % samples;
        if position_on_path[i] != NONE {
            return Some(path.split_off(position_on_path[i] as usize));
        }
        position_on_path[i] = path.len() as u32;
        path.push(i);
        node = previous[node as usize];
    }
    None
}

/// Returns 1 at samples inside a closed path, 0.5 on the path, and 0 outside.
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
