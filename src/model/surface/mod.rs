//! Groups the faces on features into labelled surfaces.
//!
//! A mesh marks the faces that lie on features. This module decides which of them form one fault or
//! one horizon. Facets that continue each other across a ridge belong together. Where more than two
//! facets meet, those with the smallest bend do. Beyond a gap, as it remains where features cross,
//! facets in the same plane do. One ridge may be misleading, so ridges vote: see `merging`.
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
//! - `facet_selection`: the facets of a mesh that lie on features
//! - `continuation_votes`: votes on which pieces continue each other
//! - `fault_extension`: continues faults beyond their edges
//! - `fault_separation`: horizons end on faults
//! - `merging`: merges pieces into surfaces by their votes
//! - `hole_patches`: fragments that close holes of a surface belong to it
//! - `kind`: faults, horizons, and interfaces between labels
//! - `grouping`: options that group faces into surfaces
//! - `names`: names of surfaces, and selectors
//! - `earlier_names`: names that an earlier interpretation has
//! - `stored_surfaces`: the surfaces of a mesh from a file
//! - `measure`: area, orientation, extent, rim
//! - `amplitude`: throw, polarity, amplitude and confidence, from the amplitudes of an image
//! - `region_interfaces`: the interfaces between every two regions
//! - `adjacency`: cells and the faces between them

pub(crate) mod adjacency;
pub mod amplitude;
pub(crate) mod continuation_votes;
pub(crate) mod earlier_names;
pub mod facet_selection;
pub(crate) mod facets;
pub(crate) mod fault_extension;
pub(crate) mod fault_separation;
pub(crate) mod grouping;
pub(crate) mod hole_patches;
pub(crate) mod kind;
pub(crate) mod measure;
pub(crate) mod merging;
pub(crate) mod names;
pub(crate) mod region_interfaces;
pub(crate) mod size_classes;
pub(crate) mod stored_surfaces;

use crate::geometry::{norm, sorted_distinct};
use crate::mesh::complex::NONE;
pub use crate::surface_file::{AnySurfaces, SurfaceFile};
use continuation_votes::{SmoothPieces, Vote, crossing_votes, gap_votes, ridge_votes, rim_lengths};
use facets::FacetComplex;
use fault_separation::FaultSeparation;
pub use grouping::GroupingOptions;
pub use kind::SurfaceKind;
pub use measure::{SurfaceMeasure, measure};

/// Options of the grouping of facets into surfaces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Largest bend within a surface, in degrees.
    pub max_bend: f64,
    /// Widest gap across which a surface continues, in units of the facets' size.
    pub max_gap: f64,
    /// Smallest area (3-D) or length (2-D) of a surface that is kept, in the space of the nodes. If
    /// `None`, it is the area of ten facets or a fiftieth of the largest surface, whichever is
    /// larger.
    pub min_area: Option<f64>,
    /// Area of the largest surface that is known already, in the space of the nodes.
    pub known_area: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_bend: 25.0,
            max_gap: 2.0,
            min_area: None,
            known_area: 0.0,
        }
    }
}

/// Returns the number of facets below which a surface is a fragment: ten faces in 3-D, and about
/// its square root of edges in 2-D.
const fn min_facet_count<const D: usize>() -> f64 {
    if D == 2 { 3.0 } else { 10.0 }
}

/// Smallest area of a surface that is kept by default, relative to the largest surface.
const MIN_AREA_RATIO: f64 = 0.02;

/// Facets grouped into surfaces.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Surfaces<const D: usize> {
    /// Facets of all surfaces, surface by surface.
    pub facets: Vec<[u32; D]>,
    /// Where the facets of each surface begin, then the total number. Surfaces with names come
    /// first, then the largest.
    pub start: Vec<usize>,
    /// The names of the surfaces that have one in the mesh's file.
    pub names: Vec<String>,
    /// The range of the named surfaces that separate two labels of the image.
    pub interfaces: std::ops::Range<usize>,
    /// Number of surfaces that were too small.
    pub dropped_count: usize,
    /// Total area of these.
    pub dropped_area: f64,
}

impl<const D: usize> Surfaces<D> {
    /// Groups facets into surfaces. `horizons` are the facets that lie on horizons (nodes
    /// ascending, sorted); these end where the other facets, faults, cross them. Distances and
    /// angles are measured between `nodes`: use lattice space, in which the mesh is uniform.
    ///
    /// The result does not depend on the number of threads.
    pub fn find(
        nodes: &[[f64; D]],
        facets: Vec<[u32; D]>,
        horizons: &[[u32; D]],
        options: &Options,
    ) -> Self {
        let min_cosine = options.max_bend.to_radians().cos();
        let facets = FacetComplex::new(nodes, facets);
        let separation = FaultSeparation::new(&facets, horizons);
        let separation = separation.as_ref();
        let pieces = SmoothPieces::new(&facets, separation);
        let (mut votes, rim) = ridge_votes(&facets, &pieces, separation, min_cosine);
        let max_gap = options.max_gap;
        votes.extend(gap_votes(
            &facets, &pieces, separation, &rim, max_gap, min_cosine,
        ));
        let unite_pieces = |piece: &[u32], count: usize, votes: &[Vote]| {
            let orientations = merging::PieceOrientation::from_pieces(&facets, piece, count);
            let (merged_into, count) =
                merging::merge_pieces(&rim_lengths(&facets, piece, count), orientations, votes);
            let piece: Vec<u32> = piece.iter().map(|&p| merged_into[p as usize]).collect();
            (merged_into, piece, count)
        };
        let (merged_into, surface, count) = unite_pieces(&pieces.piece, pieces.count, &votes);
        // The second pass bridges wider gaps; votes against a union remain.
        let mut votes: Vec<Vote> = votes.iter().filter_map(|v| v.remap(&merged_into)).collect();
        votes.extend(crossing_votes(
            &facets,
            &surface,
            &pieces.normals,
            separation,
        ));
        let (_, surface, count) = unite_pieces(&surface, count, &votes);

        let mut areas = vec![0.0; count];
        for (f, &s) in surface.iter().enumerate() {
            areas[s as usize] += norm(facets.normal(f));
        }
        let mean = areas.iter().sum::<f64>() / facets.len().max(1) as f64;
        let largest = areas.iter().copied().fold(options.known_area, f64::max);
        let min_area = (min_facet_count::<D>() * mean).max(MIN_AREA_RATIO * largest);
        let min_area = options.min_area.unwrap_or(min_area);
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| areas[b].total_cmp(&areas[a]).then(a.cmp(&b)));
        let kept_count = order.partition_point(|&s| areas[s] >= min_area);
        let mut rank = vec![NONE; count];
        for (place, &s) in order[..kept_count].iter().enumerate() {
            rank[s] = place as u32;
        }
        let is_fragment = |s: usize| rank[s] == NONE && areas[s] < min_facet_count::<D>() * mean;
        let fragments: Vec<bool> = (0..count).map(is_fragment).collect();
        let patches = hole_patches::hole_patches(&facets, &surface, &fragments);
        let dropped: Vec<usize> = (order[kept_count..].iter().copied())
            .filter(|&s| patches[s].is_none_or(|parent| rank[parent as usize] == NONE))
            .collect();
        let rank_of = |s: u32| rank[patches[s as usize].unwrap_or(s) as usize];
        let mut members: Vec<(u32, [u32; D])> = (facets.facets.iter().zip(&surface))
            .map(|(&facet, &s)| (rank_of(s), facet))
            .filter(|(s, _)| *s != NONE)
            .collect();
        members.sort_unstable();
        let start = (0..=kept_count as u32).map(|s| members.partition_point(|m| m.0 < s));
        Self {
            start: start.collect(),
            facets: members.iter().map(|m| m.1).collect(),
            names: Vec::new(),
            interfaces: 0..0,
            dropped_count: dropped.len(),
            dropped_area: dropped.iter().map(|&s| areas[s]).sum(),
        }
    }

    /// Returns the fraction of the total area that was dropped, in the space of the nodes of
    /// [`find`](Self::find).
    pub fn dropped_share(&self, nodes: &[[f64; D]]) -> f64 {
        let area = |f: &[u32; D]| crate::geometry::normal(&f.map(|n| nodes[n as usize]));
        let kept_area: f64 = (self.facets.iter().map(area).map(crate::geometry::norm)).sum();
        self.dropped_area / (kept_area + self.dropped_area).max(f64::MIN_POSITIVE)
    }

    /// Returns the number of surfaces.
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Returns `true` if there are no surfaces.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the number of surfaces, from the first, whose area is at least the default of
    /// [`Options::min_area`], beside a known surface of area `known_area`.
    pub fn count_above_min_area(&self, nodes: &[[f64; D]], known_area: f64) -> usize {
        let area = |f: &[u32; D]| norm(crate::geometry::normal(&f.map(|n| nodes[n as usize])));
        let areas: Vec<f64> = (0..self.len())
            .map(|s| self.facets_of(s).iter().map(area).sum())
            .collect();
        let mean = areas.iter().sum::<f64>() / self.facets.len().max(1) as f64;
        let largest = areas.iter().copied().fold(known_area, f64::max);
        // The sums have another order than in `find`.
        let min_area = (min_facet_count::<D>() * mean).max(MIN_AREA_RATIO * largest) * (1.0 - 1e-9);
        areas.iter().take_while(|&&area| area >= min_area).count()
    }

    /// Returns the named surfaces followed by these surfaces. `interfaces` is the range of the
    /// named surfaces that separate two labels.
    #[must_use]
    pub fn append_to_named(
        self,
        names: Vec<String>,
        named: Vec<Vec<[u32; D]>>,
        interfaces: std::ops::Range<usize>,
    ) -> Self {
        let mut start = vec![0];
        let mut facets: Vec<[u32; D]> = Vec::new();
        for surface_facets in named {
            facets.extend(surface_facets);
            start.push(facets.len());
        }
        let offset = facets.len();
        start.extend(self.start.iter().skip(1).map(|position| position + offset));
        facets.extend(self.facets);
        Self {
            facets,
            start,
            names,
            interfaces,
            ..self
        }
    }

    /// Removes surfaces; `is_removed` has a value for each.
    pub(crate) fn remove(&mut self, is_removed: &[bool]) {
        let kept_before = |end: usize| {
            is_removed[..end]
                .iter()
                .filter(|removed| !**removed)
                .count()
        };
        self.interfaces = kept_before(self.interfaces.start)..kept_before(self.interfaces.end);
        let kept = (0..self.len()).filter(|&s| !is_removed[s]);
        let names = kept.clone().filter_map(|s| self.names.get(s).cloned());
        let names: Vec<String> = names.collect();
        let (mut facets, mut start) = (Vec::new(), vec![0]);
        for s in kept {
            facets.extend_from_slice(self.facets_of(s));
            start.push(facets.len());
        }
        (self.names, self.facets, self.start) = (names, facets, start);
    }

    /// Returns the facets of a surface.
    pub fn facets_of(&self, surface: usize) -> &[[u32; D]] {
        &self.facets[self.start[surface]..self.start[surface + 1]]
    }

    /// Returns for each surface the one to which it belongs. A fragment of fewer than ten facets
    /// belongs to the larger surface with which it shares most nodes, if there is one; all others
    /// belong to themselves.
    pub fn fragment_parents(&self, nodes: &[[f64; D]]) -> Vec<u32> {
        let area = |s: usize| -> f64 {
            let areas = (self.facets_of(s).iter())
                .map(|f| crate::geometry::normal(&f.map(|n| nodes[n as usize])));
            areas.map(crate::geometry::norm).sum()
        };
        let mut parent: Vec<u32> = (0..self.len() as u32).collect();
        let total_area: f64 = (0..self.len()).map(area).sum();
        let min_area = min_facet_count::<D>() * total_area / self.facets.len().max(1) as f64;
        let first_fragment = (0..self.len()).position(|s| area(s) < min_area);
        let first_fragment = first_fragment.unwrap_or(self.len());
        let node_surfaces = sorted_distinct((0..first_fragment).flat_map(|s| {
            self.facets_of(s)
                .as_flattened()
                .iter()
                .map(move |&n| (n, s as u32))
        }));
        for fragment in first_fragment..self.len() {
            let mut shared: Vec<u32> = Vec::new();
            for &n in self.facets_of(fragment).as_flattened() {
                let begin = node_surfaces.partition_point(|&(m, _)| m < n);
                shared.extend(
                    node_surfaces[begin..]
                        .iter()
                        .take_while(|entry| entry.0 == n)
                        .map(|entry| entry.1),
                );
            }
            shared.sort_unstable();
            // Of surfaces with equal counts, the first one is the largest.
            let longest_run = shared
                .chunk_by(|a, b| a == b)
                .rev()
                .max_by_key(|run| run.len());
            if let Some(run) = longest_run {
                parent[fragment] = run[0];
            }
        }
        parent
    }

    /// Returns the surface of each facet.
    pub fn labels(&self) -> Vec<u32> {
        let sizes = self.start.windows(2).map(|w| w[1] - w[0]);
        let labels = sizes
            .enumerate()
            .flat_map(|(s, n)| std::iter::repeat_n(s as u32, n));
        labels.collect()
    }

    /// Orients facets so that all facets of a surface have the same side up, as far as the surface
    /// has two sides. On average, normals point along `up`; those of a closed surface point outwards.
    /// `nodes` may be in another space than those of [`find`](Self::find).
    pub fn orient(&mut self, nodes: &[[f64; D]], up: [f64; D]) {
        for s in 0..self.len() {
            let range = self.start[s]..self.start[s + 1];
            let oriented = oriented_facets(nodes, self.facets[range.clone()].to_vec(), up);
            self.facets[range].copy_from_slice(&oriented);
        }
    }
}

/// Returns the facets of one surface with consistent orientation within each connected component.
/// A closed component faces outwards. The mean normal of any other component agrees with that of
/// the surface, which points up.
fn oriented_facets<const D: usize>(
    nodes: &[[f64; D]],
    facets: Vec<[u32; D]>,
    up: [f64; D],
) -> Vec<[u32; D]> {
    let normal = measure::mean_normal(nodes, &facets, up);
    let facets = FacetComplex::new(nodes, facets);
    let mut result = facets.facets.clone();
    let mut visited = vec![false; facets.len()];
    let mut piece: Vec<usize> = Vec::new();
    for first in 0..facets.len() {
        if std::mem::replace(&mut visited[first], true) {
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
                if !std::mem::replace(&mut visited[g], true) {
                    let opposite = [(f, k), (g, l)].map(|(i, j)| facets.facets[i][j]);
                    if !have_same_orientation(&result[f], opposite[0], &result[g], opposite[1]) {
                        result[g].swap(0, 1);
                    }
                    piece.push(g);
                }
            }
        }
        let is_closed = piece.iter().all(|&f| {
            let ridges = facets.ridges[f].iter();
            ridges
                .clone()
                .all(|&ridge| facets.sides(ridge as usize).len() == 2)
        });
        let is_reversed = if is_closed {
            let oriented: Vec<[u32; D]> = piece.iter().map(|&f| result[f]).collect();
            region_interfaces::is_turned_inwards(nodes, &oriented)
        } else {
            crate::geometry::dot(sum, normal) < 0.0
        };
        if is_reversed {
            piece.iter().for_each(|&f| result[f].swap(0, 1));
        }
    }
    result
}

/// Returns `true` if two facets that share a ridge have the same orientation. `f_node` and `g_node`
/// are the nodes opposite the ridge.
fn have_same_orientation<const D: usize>(
    f: &[u32; D],
    f_node: u32,
    g: &[u32; D],
    g_node: u32,
) -> bool {
    let index_of = |facet: &[u32; D], node| facet.iter().position(|&n| n == node).unwrap_or(0);
    let (k, l) = (index_of(f, f_node), index_of(g, g_node));
    match D {
        // Edges with the same orientation follow each other.
        2 => k != l,
        // Triangles with the same orientation run along their common edge in opposite directions.
        _ => f[(k + 1) % D] != g[(l + 1) % D],
    }
}

#[cfg(test)]
mod tests;
