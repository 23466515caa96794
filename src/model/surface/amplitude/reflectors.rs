//! Splits horizons that jump from one reflector to another.
//!
//! Where the mesh lacks a fault, a horizon continues across it on another reflector. There the
//! amplitudes above and below the horizon change, while they stay nearly the same along a reflector.
//! Faces are gathered into clusters, whose waveforms are the means of vertical traces around the
//! faces. Clusters are merged in the order of the correlation of their waveforms, best first, and each
//! merged cluster has the mean waveform of its faces. What remains apart is on different reflectors.

use std::cmp::Ordering;
use std::collections::{BTreeSet, BinaryHeap};

use super::super::facets::FacetComplex;
use super::neighbours;
use crate::geometry::norm;
use crate::image::Image;

/// Half the length of a waveform, in samples.
const HALF_WAVEFORM: isize = 14;

/// Number of faces of a cluster.
const CLUSTER_FACES: usize = 16;

/// Smallest correlation of waveforms on the same reflector.
const MIN_CORRELATION: f64 = 0.7;

/// A part of a horizon while parts are merged.
struct Part {
    /// Sum of the waveforms of its faces, times their areas.
    waveform: Vec<f64>,
    neighbours: BTreeSet<usize>,
    /// The part that it became a part of; itself if it is still apart.
    merged_into: usize,
    /// Number of mergers, which make older correlations of it void.
    version: usize,
}

/// A merger of two parts that may be done.
#[derive(PartialEq)]
struct Merger {
    correlation: f64,
    parts: [usize; 2],
    versions: [usize; 2],
}

impl Eq for Merger {}

impl Ord for Merger {
    fn cmp(&self, other: &Self) -> Ordering {
        (self.correlation.total_cmp(&other.correlation)).then(other.parts.cmp(&self.parts))
    }
}

impl PartialOrd for Merger {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Returns for each face of a horizon the number of its reflector. Nodes are in samples, `vertical` is
/// the vertical axis and `mean` the mean amplitude.
pub(super) fn reflectors<const D: usize>(
    facets: &FacetComplex<'_, D>,
    image: &Image<D>,
    vertical: usize,
    mean: f64,
) -> Vec<usize> {
    let neighbours = neighbours(facets);
    let cluster = clusters(&neighbours);
    let count = cluster.iter().max().map_or(0, |max| max + 1);
    let length = (2 * HALF_WAVEFORM + 1) as usize;
    let new_part = |number| Part {
        waveform: vec![0.0; length],
        neighbours: BTreeSet::new(),
        merged_into: number,
        version: 0,
    };
    let mut parts: Vec<Part> = (0..count).map(new_part).collect();
    let last = (image.dims()[vertical] - 1) as f64;
    for (f, centre) in facets.centroids().into_iter().enumerate() {
        let (part, area) = (&mut parts[cluster[f]], norm(facets.normal(f)));
        for (sum, offset) in part.waveform.iter_mut().zip(-HALF_WAVEFORM..) {
            let mut x = centre;
            x[vertical] += offset as f64;
            if (0.0..=last).contains(&x[vertical]) {
                *sum += area * (f64::from(image.interpolate_linear(x)) - mean);
            }
        }
        let others = neighbours[f].iter().map(|&n| cluster[n as usize]);
        part.neighbours
            .extend(others.filter(|other| *other != cluster[f]));
    }
    let mut queue = BinaryHeap::new();
    for a in 0..count {
        for &b in parts[a].neighbours.range(a + 1..) {
            queue.push(merger(&parts, a, b));
        }
    }
    while let Some(Merger {
        correlation,
        parts: [a, b],
        versions,
    }) = queue.pop()
    {
        let is_current =
            |k: usize, version| parts[k].merged_into == k && parts[k].version == version;
        if !is_current(a, versions[0]) || !is_current(b, versions[1]) {
            continue;
        }
        if correlation < MIN_CORRELATION {
            break;
        }
        let waveform = std::mem::take(&mut parts[b].waveform);
        let others = std::mem::take(&mut parts[b].neighbours);
        parts[b].merged_into = a;
        (parts[a].waveform.iter_mut().zip(&waveform)).for_each(|(sum, value)| *sum += value);
        parts[a].version += 1;
        for &other in &others {
            parts[other].neighbours.remove(&b);
            parts[other].neighbours.insert(a);
        }
        parts[a].neighbours.extend(others);
        parts[a].neighbours.remove(&a);
        parts[a].neighbours.remove(&b);
        for other in parts[a].neighbours.clone() {
            queue.push(merger(&parts, a.min(other), a.max(other)));
        }
    }
    let root = |mut part: usize| {
        while parts[part].merged_into != part {
            part = parts[part].merged_into;
        }
        part
    };
    cluster.into_iter().map(root).collect()
}

/// Returns the merger of two parts.
fn merger(parts: &[Part], a: usize, b: usize) -> Merger {
    let (x, y) = (parts[a].waveform.as_slice(), parts[b].waveform.as_slice());
    let product: f64 = x.iter().zip(y).map(|(x, y)| x * y).sum();
    let energy = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
    Merger {
        correlation: product / (energy(x) * energy(y)).sqrt().max(f64::MIN_POSITIVE),
        parts: [a, b],
        versions: [parts[a].version, parts[b].version],
    }
}

/// Gathers faces into connected clusters. Returns the cluster of each face.
fn clusters(neighbours: &[Vec<u32>]) -> Vec<usize> {
    const NONE: usize = usize::MAX;
    let mut cluster = vec![NONE; neighbours.len()];
    let mut count = 0;
    for first in 0..neighbours.len() {
        if cluster[first] != NONE {
            continue;
        }
        cluster[first] = count;
        let mut members = vec![first];
        let mut head = 0;
        while head < members.len() {
            for &next in &neighbours[members[head]] {
                let next = next as usize;
                if cluster[next] == NONE && members.len() < CLUSTER_FACES {
                    cluster[next] = count;
                    members.push(next);
                }
            }
            head += 1;
        }
        count += 1;
    }
    cluster
}
