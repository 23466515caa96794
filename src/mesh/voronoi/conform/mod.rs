//! Places sites whose Voronoi cells have the facets of a surface as faces (VoroCrust: Abdelkader
//! and others, ACM Transactions on Graphics 39(3), 2020).
//!
//! Every node of the surface gets a ball. The spheres of a facet's nodes meet in two points, mirror
//! images of each other in the facet's plane; these are sites. If no other ball covers them,
//! nothing is nearer to a node of the facet than the sites around it, and these all lie on its
//! sphere. Therefore the nodes are nodes of cells, and the face between the two sites is the facet.
//! All other atoms stay outside the balls.
//!
//! - `surface`: the facets, and how they meet
//! - `regularise`: improves the shape of triangles
//! - `flatten`: makes nearly planar parts planar
//! - `balls`: radii such that few points are covered
//! - `faces`: the faces of cells that lie on the surface
//! - `site_region`: where sites may be
//!
//! A facet gets no sites if its points are covered, beyond a side of the box, or too close to those
//! of another facet. The cells around it fill its place. Their sites are mirror images in nearly the
//! same plane, so their faces continue nearly in it. [`ConformingSites::covered_share`] measures
//! how much of the surface has exact faces.
//!
//! Where a surface ends, one more site is placed ahead of its rim, at the same distance from the
//! rim as the sites above and below. The three cells meet at the rim, and the face ends there.

mod balls;
mod faces;
mod flatten;
mod regularise;
mod site_region;
mod surface;

use crate::geometry::cell_list::CellList;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{add_scaled, distance2, dot, norm, normal, sorted_distinct, sub, unit};
use crate::mesh::complex::NONE;
use balls::Balls;
pub use faces::FacetGrid;
pub use site_region::SiteRegion;
pub use surface::FacetSurface;

/// Smallest distance between sites, in mean edge lengths of their facets.
const MIN_SITE_DISTANCE: f64 = 0.25;
/// Distance, in mean edge lengths, below which two facets with a common edge where surfaces meet share
/// one site. The faces then deviate from the facets by at most a twentieth of an edge.
const SHARED_SITE_DISTANCE: f64 = 0.12;
/// Distance, in mean edge lengths, below which any two sites are one. Facets on either side of the
/// plane between two surfaces have sites this close to each other if their sites lie in that plane.
const SAME_SITE_DISTANCE: f64 = 0.01;

/// Smallest cosine between the normals of facets in one plane.
const MIN_PLANE_COSINE: f64 = 0.9;

/// Distance, in radii of the largest ball, below which a node of cells is a node of the surface.
const SAME_NODE_DISTANCE: f64 = 1e-7;

/// Sites on both sides of the facets of a surface, and the balls that other atoms must not enter.
#[derive(Debug)]
pub struct ConformingSites<const D: usize> {
    balls: Balls<D>,
    site_region: SiteRegion<D>,
    grid: CellList<D>,
    max_radius: f64,
    /// The facets that have two sites, ascending.
    facets: Vec<u32>,
    /// The pairs of facets that have a common edge where more than two meet, ascending.
    junctions: Vec<[u32; 2]>,
    /// The pairs of facets on either side of the plane between two surfaces that meet, ascending.
    mirrored_pairs: Vec<[u32; 2]>,
    /// The positions of the facets' sites.
    positions: Vec<[f64; D]>,
    /// The sites of each of the facets, above and below it.
    pairs: Vec<[u32; 2]>,
    /// The sites ahead of rims: the facet, and the index of its node opposite the rim.
    rims: Vec<(u32, usize)>,
}

impl<const D: usize> ConformingSites<D> {
    /// Creates sites for a surface in the box `[0, extent]`, none of them close to the `existing`
    /// atoms.
    pub fn new(surface: FacetSurface<D>, extent: [f64; D], existing: &[[f64; D]]) -> Self {
        Self::with_region(surface, extent, existing, SiteRegion::default())
    }

    /// Creates sites for a surface inside a `region`, which also applies to other atoms.
    pub fn with_region(
        surface: FacetSurface<D>,
        extent: [f64; D],
        existing: &[[f64; D]],
        region: SiteRegion<D>,
    ) -> Self {
        let balls = Balls::new(surface, extent);
        let max_radius = balls.max_radius();
        let junctions = junctions(&balls.surface);
        let mut conforming = Self {
            grid: CellList::new(&balls.surface.nodes, max_radius),
            max_radius,
            site_region: region,
            facets: Vec::new(),
            mirrored_pairs: mirrored_pairs(&balls.surface, &junctions),
            junctions,
            positions: Vec::new(),
            pairs: Vec::new(),
            rims: Vec::new(),
            balls,
        };
        conforming.facets = conforming.separated_facets(existing);
        conforming.place_sites();
        conforming.rims = conforming.rims_with_sites(existing);
        conforming
    }

    /// Returns the surface.
    pub fn surface(&self) -> &FacetSurface<D> {
        &self.balls.surface
    }

    /// Returns the facets that have two sites, ascending.
    pub fn facets(&self) -> &[u32] {
        &self.facets
    }

    /// Returns the sites: those of the [`facets`](Self::facets), then those ahead of rims.
    pub fn sites(&self) -> Vec<[f64; D]> {
        let rims = self.rims.iter().filter_map(|&rim| self.site_ahead_of(rim));
        self.positions.iter().copied().chain(rims).collect()
    }

    /// Returns for each of the [`facets`](Self::facets) the two [`sites`](Self::sites) above and below
    /// it, in ascending order. Facets that meet where surfaces cross may share a site.
    pub fn site_pairs(&self) -> Vec<[u32; 2]> {
        let pairs = self.pairs.iter().map(|&[a, b]| [a.min(b), a.max(b)]);
        pairs.collect()
    }

    /// Places the sites of the facets.
    fn place_sites(&mut self) {
        let points = self
            .facets
            .iter()
            .filter_map(|&f| self.balls.facet_points(f as usize));
        let points: Vec<[f64; D]> = points.flatten().collect();
        let mut sets = UnionFind::new(points.len());
        for pair in &self.junctions {
            let [Ok(i), Ok(j)] = pair.map(|f| self.facets.binary_search(&f)) else {
                continue;
            };
            for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                let (a, b) = (2 * i + a, 2 * j + b);
                if self.junction_distance(*pair, [points[a], points[b]]) < SHARED_SITE_DISTANCE {
                    sets.unite(a as u32, b as u32);
                }
            }
        }
        let positions = loop {
            let positions = self.mean_positions(&points, &sets.clone().into_labels());
            if !self.unite_same_sites(&positions, &mut sets) {
                break positions;
            }
        };
        self.pairs = sets.into_labels().0.as_chunks::<2>().0.to_vec();
        self.positions = positions;
    }

    /// Returns the mean position of each set of points. `labels` has the set of each point, and the
    /// number of sets.
    fn mean_positions(&self, points: &[[f64; D]], labels: &(Vec<u32>, usize)) -> Vec<[f64; D]> {
        let mut sums = vec![([0.0; D], 0.0); labels.1];
        for (x, &label) in points.iter().zip(&labels.0) {
            let (sum, weight) = &mut sums[label as usize];
            *sum = add_scaled(*sum, 1.0, *x);
            *weight += 1.0;
        }
        let mean = |(sum, weight): ([f64; D], f64)| sum.map(|c| c / weight);
        sums.into_iter().map(mean).collect()
    }

    /// Unites the sets of facets' points whose sites, at `positions`, are at the same place. Returns
    /// `true` if there were any.
    fn unite_same_sites(&self, positions: &[[f64; D]], sets: &mut UnionFind) -> bool {
        let (labels, count) = sets.clone().into_labels();
        let mut first_point = vec![NONE; count];
        for (point, &label) in (0..).zip(&labels) {
            let first = &mut first_point[label as usize];
            *first = (*first).min(point);
        }
        let edge_length = |site: usize| {
            let facet = self.facets[first_point[site] as usize / 2];
            self.balls.edge_length(facet as usize)
        };
        let edge_lengths: Vec<f64> = (0..count).map(edge_length).collect();
        let longest = edge_lengths.iter().copied().fold(0.0, f64::max);
        let radius = SAME_SITE_DISTANCE * longest;
        let mut has_united = false;
        if count == 0 {
            return has_united;
        }
        let grid = CellList::new(positions, MIN_SITE_DISTANCE * longest);
        for (a, x) in positions.iter().enumerate() {
            grid.visit_within(*x, radius, |b| {
                let distance = SAME_SITE_DISTANCE * edge_lengths[a].min(edge_lengths[b]);
                if a < b && distance2(x, &positions[b]) < distance * distance {
                    sets.unite(first_point[a], first_point[b]);
                    has_united = true;
                }
            });
        }
        has_united
    }

    /// Returns the distance between points of two facets, in the mean edge length of the smaller one.
    fn junction_distance(&self, facets: [u32; 2], [x, y]: [[f64; D]; 2]) -> f64 {
        let [a, b] = facets.map(|f| self.balls.edge_length(f as usize));
        distance2(&x, &y).sqrt() / a.min(b)
    }

    /// Returns the region where sites and other atoms may be.
    pub fn site_region(&self) -> &SiteRegion<D> {
        &self.site_region
    }

    /// Returns `true` if a position is inside the region and outside all balls.
    pub fn is_free(&self, x: [f64; D]) -> bool {
        let mut is_free = self.site_region.contains(x);
        if is_free && !self.surface().nodes.is_empty() {
            self.grid.visit_within(x, self.max_radius, |n| {
                is_free = is_free && !self.balls.covers(n, &x);
            });
        }
        is_free
    }

    /// Returns the point on the sphere of the surface's node at `x`, in the direction of another
    /// point, where an atom can be: its cell reaches the node. `None` if no node is there or
    /// the point is not free.
    pub fn sphere_point(&self, x: [f64; D], towards: [f64; D]) -> Option<[f64; D]> {
        let mut node = None;
        if !self.surface().nodes.is_empty() {
            let tolerance = SAME_NODE_DISTANCE * self.max_radius;
            let nodes = &self.surface().nodes;
            self.grid.visit_within(x, tolerance, |n| {
                if distance2(&nodes[n], &x) < tolerance * tolerance {
                    node = Some(n);
                }
            });
        }
        let point = self.point_on_sphere(node?, towards);
        self.is_free(point).then_some(point)
    }

    /// Returns the point nearest to `x` on the sphere around the nearest node of the surface whose ball
    /// covers `x`; `None` if none does.
    pub fn nearest_sphere_point(&self, x: [f64; D]) -> Option<[f64; D]> {
        if self.surface().nodes.is_empty() {
            return None;
        }
        let mut nearest: Option<(f64, usize)> = None;
        self.grid.visit_within(x, self.max_radius, |n| {
            let distance = distance2(&self.surface().nodes[n], &x);
            if self.balls.covers(n, &x) && nearest.is_none_or(|best| (distance, n) < best) {
                nearest = Some((distance, n));
            }
        });
        Some(self.point_on_sphere(nearest?.1, x))
    }

    /// Returns the point on the sphere around a node of the surface in the direction of another point.
    fn point_on_sphere(&self, node: usize, towards: [f64; D]) -> [f64; D] {
        let centre = self.surface().nodes[node];
        let radius = self.balls.squared_radii[node].sqrt();
        add_scaled(centre, radius, unit(sub(towards, centre)))
    }

    /// Removes the [`sites`](Self::sites) for which `is_unfit` holds, those of facets in pairs.
    /// Returns `true` if any were removed.
    pub fn remove_unfit(&mut self, is_unfit: impl Fn(usize) -> bool) -> bool {
        let (facets, rims) = (self.facets.len(), self.rims.len());
        let mut pairs = self.pairs.iter();
        let has_unfit_site = |pair: &[u32; 2]| pair.iter().any(|&site| is_unfit(site as usize));
        self.facets
            .retain(|_| pairs.next().is_none_or(|pair| !has_unfit_site(pair)));
        let mut indices = self.positions.len()..;
        self.rims
            .retain(|_| indices.next().is_none_or(|i| !is_unfit(i)));
        self.place_sites();
        self.facets.len() < facets || self.rims.len() < rims
    }

    /// Returns the facets whose points can be sites and are far enough from each other. Of two
    /// facets that are too close, the larger one is kept.
    fn separated_facets(&self, existing: &[[f64; D]]) -> Vec<u32> {
        let balls = &self.balls;
        let mut facets: Vec<u32> = Vec::new();
        let mut points: Vec<[f64; D]> = Vec::new();
        for f in 0..self.surface().facets.len() {
            let is_allowed =
                |pair: &[[f64; D]; 2]| pair.iter().all(|&x| self.site_region.contains(x));
            if let Some(pair) = balls.facet_points(f).filter(is_allowed) {
                facets.push(f as u32);
                points.extend(pair);
            }
        }
        let sizes: Vec<f64> = facets
            .iter()
            .map(|&f| balls.edge_length(f as usize))
            .collect();
        let radius = MIN_SITE_DISTANCE * sizes.iter().copied().fold(0.0, f64::max);
        let mut kept = vec![true; facets.len()];
        if facets.is_empty() {
            return facets;
        }
        let grid = CellList::new(&points, radius);
        let mut close_pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (i, x) in points.iter().enumerate() {
            grid.visit_within(*x, radius, |j| {
                let (f, g) = (i / 2, j / 2);
                let distance = distance2(x, &points[j]).sqrt() / sizes[f].min(sizes[g]);
                let pair = [facets[f], facets[g]];
                let may_be_close = || {
                    let mut lists = [&self.junctions, &self.mirrored_pairs].into_iter();
                    lists.any(|pairs| pairs.binary_search(&pair).is_ok())
                };
                if f < g && distance < MIN_SITE_DISTANCE && !may_be_close() {
                    close_pairs.push((distance, f, g));
                }
            });
        }
        for x in existing {
            grid.visit_within(*x, radius, |i| {
                kept[i / 2] &= distance2(x, &points[i]).sqrt() >= MIN_SITE_DISTANCE * sizes[i / 2];
            });
        }
        close_pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let area = |f: usize| norm(normal(&self.surface().corners(facets[f] as usize)));
        for (_, f, g) in close_pairs {
            if kept[f] && kept[g] {
                kept[if area(f) < area(g) { f } else { g }] = false;
            }
        }
        let mut kept = kept.into_iter();
        facets.retain(|_| kept.next() == Some(true));
        facets
    }

    /// Returns the site ahead of the rim of a facet opposite its k-th node, if that position is
    /// free.
    fn site_ahead_of(&self, (f, k): (u32, usize)) -> Option<[f64; D]> {
        self.balls
            .rim_point(f as usize, k)
            .filter(|&x| self.is_free(x))
    }

    /// Returns the rims, of facets that have sites, ahead of which sites are placed, none of them close to
    /// the `existing` atoms.
    fn rims_with_sites(&self, existing: &[[f64; D]]) -> Vec<(u32, usize)> {
        let surface = self.surface();
        let mut rims: Vec<((u32, usize), [f64; D], f64)> = Vec::new();
        for (ridge, facets) in surface.ridges() {
            let [f] = facets[..] else { continue };
            let nodes = ridge.iter().filter(|&&n| n != NONE);
            let common_sides = nodes.fold(u8::MAX, |s, &n| {
                s & surface.sides_of_node(n, self.balls.extent())
            });
            let opposite = surface.facets[f as usize]
                .iter()
                .position(|n| !ridge.contains(n));
            if common_sides != 0 || self.facets.binary_search(&f).is_err() {
                continue;
            }
            let Some(rim) = opposite.map(|k| (f, k)) else {
                continue;
            };
            if let Some(x) = self.site_ahead_of(rim) {
                rims.push((
                    rim,
                    x,
                    MIN_SITE_DISTANCE * self.balls.edge_length(f as usize),
                ));
            }
        }
        let mut kept = Vec::new();
        if rims.is_empty() {
            return kept;
        }
        let extent = self.balls.extent();
        let max_distance = rims.iter().fold(0.0f64, |max, rim| max.max(rim.2));
        // The grid has at most a million cells.
        let volume: f64 = extent.iter().product();
        let cell_size = max_distance.max((volume / 1e6).powf(1.0 / D as f64));
        let mut placed = IncrementalGrid::new([0.0; D], extent, cell_size);
        let others = self.sites().into_iter().chain(existing.iter().copied());
        others.for_each(|x| _ = placed.add(x));
        for (rim, x, min_distance) in rims {
            if placed.is_free(&x, min_distance) {
                placed.add(x);
                kept.push(rim);
            }
        }
        kept
    }
}

/// Returns the pairs of facets that have a common ridge where more than two facets meet, ascending.
fn junctions<const D: usize>(surface: &FacetSurface<D>) -> Vec<[u32; 2]> {
    let ridges = surface.ridges().into_values();
    let meetings = ridges.filter(|facets| facets.len() > 2);
    sorted_distinct(meetings.flat_map(|facets| pairs(&facets)))
}

/// Returns the pairs of facets that have only a node in common where more than two facets meet, and
/// are not in one plane, ascending. Their sites are on either side of the plane between them, however
/// close they are to each other.
fn mirrored_pairs<const D: usize>(
    surface: &FacetSurface<D>,
    junctions: &[[u32; 2]],
) -> Vec<[u32; 2]> {
    let ridges = surface.ridges();
    let lines = ridges.iter().filter(|(_, facets)| facets.len() > 2);
    let nodes = sorted_distinct(lines.flat_map(|(ridge, _)| *ridge).filter(|&n| n != NONE));
    let stars = surface.facets_of_nodes();
    let is_mirrored = |pair: &[u32; 2]| {
        let [m, n] = pair.map(|f| surface.unit_normal(f as usize));
        dot(m, n).abs() < MIN_PLANE_COSINE && junctions.binary_search(pair).is_err()
    };
    let meetings = nodes.iter().flat_map(|&n| pairs(stars.get(n as usize)));
    sorted_distinct(meetings.filter(is_mirrored))
}

/// Returns all pairs of some facets, the lower of each first.
fn pairs(facets: &[u32]) -> Vec<[u32; 2]> {
    let others = |(i, &f): (usize, &u32)| {
        let rest = facets[i + 1..].iter();
        rest.map(move |&g| [f.min(g), f.max(g)]).collect::<Vec<_>>()
    };
    facets.iter().enumerate().flat_map(others).collect()
}
