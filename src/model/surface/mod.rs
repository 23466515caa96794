//! Faces on features -> labelled surfaces.
//!
//! A mesh says which of its faces lie on features. Which of them make one fault or one horizon?
//! Facets that continue each other across a ridge do; where more than two meet, those that bend
//! least; and beyond a gap, as it is left where features cross, the facets that lie in the plane.
//! One ridge may mislead, so ridges vote: see `unite`.
//!
//! Two faults that cross:
//!
//! ```
//! use atomesh::model::surface::{Options, Surfaces};
//!
//! // Along x from -9 to 9, then along y; the node in the middle belongs to both.
//! let along_x = (-9..=9).map(|x| [f64::from(x), 0.0]);
//! let along_y = (-9..=9).filter(|y| *y != 0).map(|y| [0.0, f64::from(y)]);
//! let nodes: Vec<[f64; 2]> = along_x.chain(along_y).collect();
//! let mut edges: Vec<[u32; 2]> = (0..18).map(|i| [i, i + 1]).collect();
//! let other: Vec<u32> = (19..28).chain([9]).chain(28..37).collect();
//! edges.extend(other.windows(2).map(|pair| [pair[0].min(pair[1]), pair[0].max(pair[1])]));
//!
//! let surfaces = Surfaces::find(&nodes, edges, &[], &Options::default());
//! assert_eq!(surfaces.len(), 2);
//! assert_eq!(surfaces.start, [0, 18, 36]);
//! ```
//!
//! - `facets`: facets and their ridges: triangles and edges in 3-D, edges and nodes in 2-D
//! - `select`: the facets of a mesh that lie on features
//! - `pairs`: what continues what
//! - `walls`: horizons end on faults
//! - `unite`: pieces and votes -> surfaces
//! - `patch`: crumbs that close holes of a surface are part of it
//! - `kind`: faults, horizons, and what parts two labels
//! - `names`: names of surfaces, and patterns that pick some of them
//! - `stored`: the surfaces of a mesh that a file holds
//! - `measure`: area, orientation, extent, rim
//! - `pairs_of_regions`: what every two regions share
//! - `adjacency`: cells and the faces between them

pub mod adjacency;
pub(crate) mod continuation_votes;
pub mod facet_selection;
pub(crate) mod facets;
pub(crate) mod fault_separation;
pub(crate) mod hole_patches;
pub(crate) mod kind;
pub(crate) mod measure;
pub(crate) mod merging;
pub mod names;
pub mod region_interfaces;
pub mod stored_surfaces;

use crate::geometry::norm;
use continuation_votes::{SmoothPieces, Vote, crossing_votes, gap_votes, ridge_votes, rim_lengths};
use facets::{FacetComplex, NONE};
use fault_separation::FaultSeparation;
pub use kind::SurfaceKind;
pub use measure::{SurfaceMeasure, measure};

/// What makes facets one surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// The largest bend within a surface, in degrees.
    pub max_bend: f64,
    /// The widest gap across which a surface goes on, in units of the facets' size.
    pub max_gap: f64,
    /// Smaller surfaces are dropped: least area (3-D) or length (2-D), in the space of the nodes; if
    /// `None` that of ten facets, and a fiftieth of the largest surface.
    pub min_area: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_bend: 25.0,
            max_gap: 2.0,
            min_area: None,
        }
    }
}

/// Smaller surfaces than this many facets are crumbs: ten faces, or as many edges as those are wide.
const fn min_facet_count<const D: usize>() -> f64 {
    if D == 2 { 3.0 } else { 10.0 }
}

/// Next to the largest surface, surfaces smaller than this part of it are confetti.
const MIN_AREA_RATIO: f64 = 0.02;

/// Facets grouped into surfaces.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Surfaces<const D: usize> {
    /// Facets of all surfaces, surface by surface.
    pub facets: Vec<[u32; D]>,
    /// Where the facets of each surface begin, and the end: those with names first, then the largest.
    pub start: Vec<usize>,
    /// The names of those that have one in the mesh's file.
    pub names: Vec<String>,
    /// Which of these part two labels of the image.
    pub interfaces: std::ops::Range<usize>,
    /// Surfaces that were too small.
    pub dropped_count: usize,
    /// Their area.
    pub dropped_area: f64,
}

impl<const D: usize> Surfaces<D> {
    /// Groups facets into surfaces. `horizons`, nodes ascending, sorted, are those that lie on horizons, which end where the others,
    /// faults, cross them. Distances and angles are those of `nodes`: use lattice space, in which the mesh is even.
    ///
    /// The result does not depend on the number of threads.
    pub fn find(
        nodes: &[[f64; D]],
        facets: Vec<[u32; D]>,
        horizons: &[[u32; D]],
        options: &Options,
    ) -> Self {
        let straight = options.max_bend.to_radians().cos();
        let facets = FacetComplex::new(nodes, facets);
        let walls = FaultSeparation::new(&facets, horizons);
        let walls = walls.as_ref();
        let cores = SmoothPieces::new(&facets, walls);
        let (mut votes, rim) = ridge_votes(&facets, &cores, walls, straight);
        let reach = options.max_gap;
        votes.extend(gap_votes(&facets, &cores, walls, &rim, reach, straight));
        let unite_pieces = |piece: &[u32], count: usize, votes: &[Vote]| {
            let facing = merging::PieceOrientation::from_pieces(&facets, piece, count);
            let (united, count) =
                merging::merge_pieces(&rim_lengths(&facets, piece, count), facing, votes);
            let piece: Vec<u32> = piece.iter().map(|&p| united[p as usize]).collect();
            (united, piece, count)
        };
        let (united, surface, count) = unite_pieces(&cores.piece, cores.count, &votes);
        // Once more, across wider gaps; what was against stays so.
        let mut votes: Vec<Vote> = votes.iter().filter_map(|v| v.remap(&united)).collect();
        votes.extend(crossing_votes(&facets, &surface, &cores.normals, walls));
        let (_, surface, count) = unite_pieces(&surface, count, &votes);

        let mut areas = vec![0.0; count];
        for (f, &s) in surface.iter().enumerate() {
            areas[s as usize] += norm(facets.normal(f));
        }
        let mean = areas.iter().sum::<f64>() / facets.len().max(1) as f64;
        let largest = areas.iter().copied().fold(0.0, f64::max);
        let least = (min_facet_count::<D>() * mean).max(MIN_AREA_RATIO * largest);
        let least = options.min_area.unwrap_or(least);
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| areas[b].total_cmp(&areas[a]).then(a.cmp(&b)));
        let kept = order.partition_point(|&s| areas[s] >= least);
        let mut rank = vec![NONE; count];
        for (place, &s) in order[..kept].iter().enumerate() {
            rank[s] = place as u32;
        }
        let crumb = |s: usize| rank[s] == NONE && areas[s] < min_facet_count::<D>() * mean;
        let crumbs: Vec<bool> = (0..count).map(crumb).collect();
        let patches = hole_patches::hole_patches(&facets, &surface, &crumbs);
        let dropped: Vec<usize> = (order[kept..].iter().copied())
            .filter(|&s| patches[s].is_none_or(|whole| rank[whole as usize] == NONE))
            .collect();
        let rank_of = |s: u32| rank[patches[s as usize].unwrap_or(s) as usize];
        let mut members: Vec<(u32, [u32; D])> = (facets.facets.iter().zip(&surface))
            .map(|(&facet, &s)| (rank_of(s), facet))
            .filter(|(s, _)| *s != NONE)
            .collect();
        members.sort_unstable();
        let start = (0..=kept as u32).map(|s| members.partition_point(|m| m.0 < s));
        Self {
            start: start.collect(),
            facets: members.iter().map(|m| m.1).collect(),
            names: Vec::new(),
            interfaces: 0..0,
            dropped_count: dropped.len(),
            dropped_area: dropped.iter().map(|&s| areas[s]).sum(),
        }
    }

    /// The share of all area that was dropped, in the space of [`find`](Self::find)'s nodes.
    pub fn dropped_share(&self, nodes: &[[f64; D]]) -> f64 {
        let area = |f: &[u32; D]| crate::geometry::normal(&f.map(|n| nodes[n as usize]));
        let kept: f64 = (self.facets.iter().map(area).map(crate::geometry::norm)).sum();
        self.dropped_area / (kept + self.dropped_area).max(f64::MIN_POSITIVE)
    }

    /// Number of surfaces.
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Whether there is no surface.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many of the surfaces, the first, are as large as the default [`Options::min_area`] asks for.
    pub fn count_above_min_area(&self, nodes: &[[f64; D]]) -> usize {
        let area = |f: &[u32; D]| norm(crate::geometry::normal(&f.map(|n| nodes[n as usize])));
        let areas: Vec<f64> = (0..self.len())
            .map(|s| self.facets_of(s).iter().map(area).sum())
            .collect();
        let mean = areas.iter().sum::<f64>() / self.facets.len().max(1) as f64;
        let largest = areas.iter().copied().fold(0.0, f64::max);
        // Sums in another order than in `find`.
        let least = (min_facet_count::<D>() * mean).max(MIN_AREA_RATIO * largest) * (1.0 - 1e-9);
        areas.iter().take_while(|&&area| area >= least).count()
    }

    /// These surfaces behind those that have names, of which `interfaces` part two labels.
    #[must_use]
    pub fn append_to_named(
        self,
        names: Vec<String>,
        named: Vec<Vec<[u32; D]>>,
        interfaces: std::ops::Range<usize>,
    ) -> Self {
        let mut start = vec![0];
        let mut facets: Vec<[u32; D]> = Vec::new();
        for own in named {
            facets.extend(own);
            start.push(facets.len());
        }
        let before = facets.len();
        start.extend(self.start.iter().skip(1).map(|at| at + before));
        facets.extend(self.facets);
        Self {
            facets,
            start,
            names,
            interfaces,
            ..self
        }
    }

    /// The facets of a surface.
    pub fn facets_of(&self, surface: usize) -> &[[u32; D]] {
        &self.facets[self.start[surface]..self.start[surface + 1]]
    }

    /// For each surface the one that it counts as, as a part of it: crumbs of fewer than
    /// ten facets are part of the larger surface with which they share most nodes, if there is one.
    pub fn fragment_parents(&self, nodes: &[[f64; D]]) -> Vec<u32> {
        let area = |s: usize| -> f64 {
            let areas = (self.facets_of(s).iter())
                .map(|f| crate::geometry::normal(&f.map(|n| nodes[n as usize])));
            areas.map(crate::geometry::norm).sum()
        };
        let mut part_of: Vec<u32> = (0..self.len() as u32).collect();
        let all: f64 = (0..self.len()).map(area).sum();
        let least = min_facet_count::<D>() * all / self.facets.len().max(1) as f64;
        let first = (0..self.len()).position(|s| area(s) < least);
        let first = first.unwrap_or(self.len());
        let mut on: Vec<(u32, u32)> = (0..first)
            .flat_map(|s| {
                self.facets_of(s)
                    .as_flattened()
                    .iter()
                    .map(move |&n| (n, s as u32))
            })
            .collect();
        on.sort_unstable();
        on.dedup();
        for crumb in first..self.len() {
            let mut shared: Vec<u32> = Vec::new();
            for &n in self.facets_of(crumb).as_flattened() {
                let from = on.partition_point(|&(m, _)| m < n);
                shared.extend(on[from..].iter().take_while(|at| at.0 == n).map(|at| at.1));
            }
            shared.sort_unstable();
            // Of equals the first, which is the largest.
            let most = shared
                .chunk_by(|a, b| a == b)
                .rev()
                .max_by_key(|same| same.len());
            if let Some(same) = most {
                part_of[crumb] = same[0];
            }
        }
        part_of
    }

    /// The surface of each facet.
    pub fn labels(&self) -> Vec<u32> {
        let sizes = self.start.windows(2).map(|w| w[1] - w[0]);
        let labels = sizes
            .enumerate()
            .flat_map(|(s, n)| std::iter::repeat_n(s as u32, n));
        labels.collect()
    }

    /// Turns facets so that those of a surface all show the same side, upwards on the whole, as far
    /// as the surface has two sides. `nodes` may be in another space than those of [`find`](Self::find).
    pub fn orient(&mut self, nodes: &[[f64; D]], up: [f64; D]) {
        for s in 0..self.len() {
            let range = self.start[s]..self.start[s + 1];
            let turned = oriented_facets(nodes, self.facets[range.clone()].to_vec(), up);
            self.facets[range].copy_from_slice(&turned);
        }
    }
}

/// Facets of one surface with consistent orientation, piece by connected piece; each piece such that
/// its mean normal agrees with that of the surface, which points up.
fn oriented_facets<const D: usize>(
    nodes: &[[f64; D]],
    facets: Vec<[u32; D]>,
    up: [f64; D],
) -> Vec<[u32; D]> {
    let normal = measure::mean_normal(nodes, &facets, up);
    let facets = FacetComplex::new(nodes, facets);
    let mut result = facets.facets.clone();
    let mut known = vec![false; facets.len()];
    let mut piece: Vec<usize> = Vec::new();
    for first in 0..facets.len() {
        if std::mem::replace(&mut known[first], true) {
            continue;
        }
        piece.clear();
        piece.push(first);
        let mut head = 0;
        let mut sum = [0.0; D];
        while head < piece.len() {
            let f = piece[head];
            head += 1;
            let x = result[f].map(|n| nodes[n as usize]);
            sum = crate::geometry::add_scaled(sum, 1.0, crate::geometry::normal(&x));
            for k in 0..D {
                let &[a, b] = facets.sides(facets.ridges[f][k] as usize) else {
                    continue;
                };
                let other = (a + b) as usize - (D * f + k);
                let (g, l) = (other / D, other % D);
                if !std::mem::replace(&mut known[g], true) {
                    let opposite = [(f, k), (g, l)].map(|(i, j)| facets.facets[i][j]);
                    if !have_same_orientation(&result[f], opposite[0], &result[g], opposite[1]) {
                        result[g].swap(0, 1);
                    }
                    piece.push(g);
                }
            }
        }
        if crate::geometry::dot(sum, normal) < 0.0 {
            piece.iter().for_each(|&f| result[f].swap(0, 1));
        }
    }
    result
}

/// Whether two facets that share a ridge show the same side; told by the nodes opposite the ridge.
fn have_same_orientation<const D: usize>(
    f: &[u32; D],
    f_node: u32,
    g: &[u32; D],
    g_node: u32,
) -> bool {
    let at = |facet: &[u32; D], node| facet.iter().position(|&n| n == node).unwrap_or(0);
    let (k, l) = (at(f, f_node), at(g, g_node));
    match D {
        // Edges follow each other.
        2 => k != l,
        // Triangles run along their edge in opposite directions.
        _ => f[(k + 1) % D] != g[(l + 1) % D],
    }
}

#[cfg(test)]
mod tests;
