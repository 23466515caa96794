//! Sites whose Voronoi cells have the facets of a surface for faces (VoroCrust: Abdelkader and others,
//! ACM Transactions on Graphics 39(3), 2020).
//!
//! A ball round every node of the surface: the spheres of a facet's nodes meet in two points, mirror
//! images of each other in the facet's plane. These are sites. Where no other ball covers either of
//! them, nothing is nearer to a node of the facet than the sites round it, all of which are on its sphere: so the
//! nodes are nodes of cells, and the face between the two sites is the facet. All other atoms stay
//! outside of the balls.
//!
//! - `surface`: the facets, and how they meet
//! - `tidy`: better triangles
//! - `balls`: radii such that few points are covered
//! - `faces`: the faces of cells that lie on the surface
//! - `room`: where sites may stand
//!
//! A facet whose points are covered, beyond a side of the box or too near to those of another facet goes
//! without sites. The cells around take its place, and as their sites are mirror images in nearly the same
//! plane, their faces go on nearly in it; [`ConformingSites::covered_share`] tells how much of the surface is followed so.
//!
//! Where a surface ends, a site stands ahead of its rim, as far from it as those above and below: the three cells meet
//! at the rim, and the face ends there.

mod balls;
mod faces;
mod regularise;
mod site_region;
mod surface;

use crate::geometry::cell_list::CellList;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::{distance2, norm, normal};
use crate::mesh::complex::NONE;
use balls::Balls;
pub use faces::FacetGrid;
pub use site_region::SiteRegion;
pub use surface::FacetSurface;

/// Sites nearer to one another than this, in units of the edges round them, are too near.
const MIN_SITE_DISTANCE: f64 = 0.25;

/// Sites on either side of the facets of a surface, and the balls that other atoms keep out of.
#[derive(Debug)]
pub struct ConformingSites<const D: usize> {
    balls: Balls<D>,
    site_region: SiteRegion<D>,
    grid: CellList<D>,
    max_radius: f64,
    /// The facets that have their two sites, ascending.
    facets: Vec<u32>,
    /// The facets, and of each the node opposite its rim, of the sites ahead of rims.
    rims: Vec<(u32, usize)>,
}

impl<const D: usize> ConformingSites<D> {
    /// Sites for a surface in the box `[0, extent]`, none of them near the atoms that are `given`.
    pub fn new(surface: FacetSurface<D>, extent: [f64; D], given: &[[f64; D]]) -> Self {
        Self::with_region(surface, extent, given, SiteRegion::default())
    }

    /// The same where there is `room`; other atoms keep to it, too.
    pub fn with_region(
        surface: FacetSurface<D>,
        extent: [f64; D],
        given: &[[f64; D]],
        room: SiteRegion<D>,
    ) -> Self {
        let balls = Balls::new(surface, extent);
        let largest = balls.max_radius();
        let mut conforming = Self {
            grid: CellList::new(&balls.surface.nodes, largest.max(f64::MIN_POSITIVE)),
            max_radius: largest,
            site_region: room,
            facets: Vec::new(),
            rims: Vec::new(),
            balls,
        };
        conforming.facets = conforming.separated_facets(given);
        conforming.rims = conforming.rims_with_sites();
        conforming
    }

    /// The surface, as the faces follow it.
    pub fn surface(&self) -> &FacetSurface<D> {
        &self.balls.surface
    }

    /// The facets that have their two sites, ascending.
    pub fn facets(&self) -> &[u32] {
        &self.facets
    }

    /// The sites: for each of the [`facets`](Self::facets) that above and that below it, then those ahead
    /// of rims.
    pub fn sites(&self) -> Vec<[f64; D]> {
        let points = self
            .facets
            .iter()
            .filter_map(|&f| self.balls.facet_points(f as usize));
        let rims = self.rims.iter().filter_map(|&rim| self.site_ahead_of(rim));
        points.flatten().chain(rims).collect()
    }

    /// Where sites and other atoms may stand.
    pub fn site_region(&self) -> &SiteRegion<D> {
        &self.site_region
    }

    /// Whether there is room at a place outside of all balls.
    pub fn is_free(&self, x: [f64; D]) -> bool {
        let mut free = self.site_region.contains(x);
        if free && !self.surface().nodes.is_empty() {
            self.grid.visit_within(x, self.max_radius, |n| {
                free = free && !self.balls.covers(n, &x);
            });
        }
        free
    }

    /// Takes those of the [`sites`](Self::sites) away that are `unfit`, those of facets in pairs; whether there
    /// are any.
    pub fn remove_unfit(&mut self, unfit: impl Fn(usize) -> bool) -> bool {
        let (facets, rims) = (self.facets.len(), self.rims.len());
        let mut place = 0..facets;
        let pair = |i: usize| unfit(2 * i) || unfit(2 * i + 1);
        self.facets
            .retain(|_| place.next().is_none_or(|i| !pair(i)));
        let mut place = 2 * facets..;
        self.rims.retain(|_| place.next().is_none_or(|i| !unfit(i)));
        self.facets.len() < facets || self.rims.len() < rims
    }

    /// The facets whose points are fit for sites and apart from one another, the larger of two that are
    /// not.
    fn separated_facets(&self, given: &[[f64; D]]) -> Vec<u32> {
        let balls = &self.balls;
        let mut facets: Vec<u32> = Vec::new();
        let mut points: Vec<[f64; D]> = Vec::new();
        for f in 0..self.surface().facets.len() {
            let fits = |pair: &[[f64; D]; 2]| pair.iter().all(|&x| self.site_region.contains(x));
            if let Some(pair) = balls.facet_points(f).filter(fits) {
                facets.push(f as u32);
                points.extend(pair);
            }
        }
        let sizes: Vec<f64> = facets
            .iter()
            .map(|&f| balls.edge_length(f as usize))
            .collect();
        let reach = MIN_SITE_DISTANCE * sizes.iter().copied().fold(0.0, f64::max);
        let mut kept = vec![true; facets.len()];
        if facets.is_empty() {
            return facets;
        }
        let grid = CellList::new(&points, reach);
        let mut near: Vec<(f64, usize, usize)> = Vec::new();
        for (i, x) in points.iter().enumerate() {
            grid.visit(*x, |j| {
                let (f, g) = (i / 2, j / 2);
                let apart = distance2(x, &points[j]).sqrt() / sizes[f].min(sizes[g]);
                if f < g && apart < MIN_SITE_DISTANCE {
                    near.push((apart, f, g));
                }
            });
        }
        for x in given {
            grid.visit_within(*x, reach, |i| {
                kept[i / 2] &= distance2(x, &points[i]).sqrt() >= MIN_SITE_DISTANCE * sizes[i / 2];
            });
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let area = |f: usize| norm(normal(&self.surface().corners(facets[f] as usize)));
        for (_, f, g) in near {
            if kept[f] && kept[g] {
                kept[if area(f) < area(g) { f } else { g }] = false;
            }
        }
        let mut kept = kept.into_iter();
        facets.retain(|_| kept.next() == Some(true));
        facets
    }

    /// The site ahead of the rim of a facet opposite its k-th node, if there is room.
    fn site_ahead_of(&self, (f, k): (u32, usize)) -> Option<[f64; D]> {
        self.balls
            .rim_point(f as usize, k)
            .filter(|&x| self.is_free(x))
    }

    /// The rims ahead of which sites stand: of facets that have sites.
    fn rims_with_sites(&self) -> Vec<(u32, usize)> {
        let surface = self.surface();
        let mut rims: Vec<((u32, usize), [f64; D], f64)> = Vec::new();
        for (ridge, facets) in surface.ridges() {
            let [f] = facets[..] else { continue };
            let nodes = ridge.iter().filter(|&&n| n != NONE);
            let on_side = nodes.fold(u8::MAX, |s, &n| {
                s & surface.sides_of_node(n, self.balls.extent())
            });
            let opposite = surface.facets[f as usize]
                .iter()
                .position(|n| !ridge.contains(n));
            if on_side != 0 || self.facets.binary_search(&f).is_err() {
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
        let mut ahead = Vec::new();
        if rims.is_empty() {
            return ahead;
        }
        let extent = self.balls.extent();
        let reach = rims.iter().fold(0.0f64, |most, rim| most.max(rim.2));
        // Never more than a million cells.
        let volume: f64 = extent.iter().product();
        let edge = reach.max((volume / 1e6).powf(1.0 / D as f64));
        let mut placed = IncrementalGrid::new([0.0; D], extent, edge);
        self.sites().into_iter().for_each(|x| _ = placed.add(x));
        for (rim, x, room) in rims {
            if placed.is_free(&x, room) {
                placed.add(x);
                ahead.push(rim);
            }
        }
        ahead
    }
}
