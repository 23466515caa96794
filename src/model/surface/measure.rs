//! Measures surfaces: area, orientation, extent, rim and neighbours.

use std::collections::BTreeMap;

use crate::parallel::prelude::*;
use serde::Serialize;

use super::Surfaces;
use super::amplitude::AmplitudeMeasure;
use super::facets::FacetComplex;
use super::kind::{SurfaceKind, surface_kinds};
use crate::geometry::NONE;
use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{
    add_scaled, bounding_box, cross, dot, norm, normal, sorted_distinct, sub, to_3d, unit,
};
use crate::image::Geometry;

/// Measures of one surface, in the space of the given nodes. In 2-D, area means length.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceMeasure {
    /// Number of the surface, from 1: surfaces with names come first, then the largest.
    pub surface: usize,
    /// The name in the mesh's file, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The kind of the surface.
    pub kind: SurfaceKind,
    /// Number of facets.
    pub facets: usize,
    /// Area (length in 2-D) of the smoothed surface, without the steps and bumps of single facets,
    /// which depend on the mesh.
    pub area: f64,
    /// Unit normal of the plane that fits the surface best, pointing up. The fit is in units of
    /// samples (`MapAxes::with_geometry`), in which errors of positions are similar along all
    /// axes.
    pub normal: Vec<f64>,
    /// Angle between that normal and up, in degrees: 0 is horizontal, 90 vertical. `None` if
    /// coordinates have different units (`MapAxes::with_units`).
    pub dip: Option<f64>,
    /// Direction of the horizontal line in that plane, in degrees from north towards east. The
    /// surface dips to the right of it. 3-D only; `None` if north and east have different units.
    pub strike: Option<f64>,
    /// Centroid of the area.
    pub centre: Vec<f64>,
    /// Lower corner of the bounding box.
    pub min_corner: Vec<f64>,
    /// Upper corner of the bounding box.
    pub max_corner: Vec<f64>,
    /// Smallest and largest vertical coordinate.
    pub vertical_range: [f64; 2],
    /// Root mean square distance of the facets' centres from that plane.
    pub rms_plane_distance: f64,
    /// Length of the rim in 3-D, number of end points in 2-D.
    pub rim: f64,
    /// Number of connected components.
    pub components: usize,
    /// Number of holes: closed curves of the rim beyond the first of each component. Always 0 in
    /// 2-D.
    pub holes: usize,
    /// Total area of the holes: for each hole the largest area of its projections on a plane.
    pub hole_area: f64,
    /// Numbers of the surfaces that share the nodes of a ridge with this one.
    pub adjacent_surfaces: Vec<usize>,
    /// Throw, polarity, amplitude and confidence, if the survey is given.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub amplitudes: Option<AmplitudeMeasure>,
}

/// The directions up, north and east, and the axes of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapAxes<const D: usize> {
    /// Unit vector upwards.
    pub up: [f64; D],
    /// Unit vector towards north.
    pub north: [f64; D],
    /// Unit vector towards east.
    pub east: [f64; D],
    /// `true` if angles from the horizontal have a meaning.
    pub has_dip: bool,
    /// `true` if angles in the map have a meaning.
    pub has_strike: bool,
    /// For each sample axis, the increase of its index along each coordinate.
    pub per_sample: [[f64; D]; D],
}

impl<const D: usize> MapAxes<D> {
    /// Returns axes with up along a coordinate, or against it. The other two coordinates are east
    /// and north, in cyclic order: if z is up, x is east and y is north.
    pub fn from_axis(axis: usize, positive: bool) -> Self {
        let unit = |k: usize| std::array::from_fn(|c| f64::from(u8::from(c == k % D)));
        let up: [f64; D] = unit(axis);
        Self {
            up: if positive { up } else { up.map(|c| -c) },
            east: unit(axis + 1),
            north: unit(axis + 2),
            has_dip: true,
            has_strike: true,
            per_sample: std::array::from_fn(unit),
        }
    }

    /// Returns the axes with the sample axes of `geometry`.
    #[must_use]
    pub fn with_geometry(self, geometry: &Geometry<D>) -> Self {
        let origin = geometry.origin;
        let index_step = |c: usize| {
            let mut position = origin;
            position[c] += 1.0;
            geometry.to_index(position)
        };
        let steps: Option<Vec<[f64; D]>> = (0..D).map(index_step).collect();
        let Some(steps) = steps else { return self };
        Self {
            per_sample: std::array::from_fn(|k| std::array::from_fn(|c| steps[c][k])),
            ..self
        }
    }

    /// Returns the axes for coordinates in `units`: there is no angle between milliseconds and
    /// metres.
    #[must_use]
    pub fn with_units(self, units: &[String; D]) -> Self {
        let horizontal_units: Vec<&String> = (units.iter().zip(self.up))
            .filter(|(_, up)| *up == 0.0)
            .map(|(unit, _)| unit)
            .collect();
        Self {
            has_dip: units.iter().all(|unit| *unit == units[0]),
            has_strike: horizontal_units
                .iter()
                .all(|unit| *unit == horizontal_units[0]),
            ..self
        }
    }
}

/// Measures all surfaces; `nodes` are usually in physical space. `horizons` are the facets that lie
/// on horizons (nodes ascending, sorted).
pub fn measure<const D: usize>(
    surfaces: &Surfaces<D>,
    nodes: &[[f64; D]],
    axes: &MapAxes<D>,
    horizons: &[[u32; D]],
) -> Vec<SurfaceMeasure> {
    let adjacent = adjacent_surfaces(surfaces);
    let kinds = surface_kinds(surfaces, nodes, horizons);
    (0..surfaces.len())
        .into_par_iter()
        .map(|s| SurfaceMeasure {
            name: surfaces.names.get(s).cloned(),
            ..measure_surface(
                s,
                surfaces.facets_of(s),
                kinds[s],
                nodes,
                axes,
                adjacent[s].clone(),
            )
        })
        .collect()
}

fn measure_surface<const D: usize>(
    surface: usize,
    facets: &[[u32; D]],
    kind: SurfaceKind,
    nodes: &[[f64; D]],
    axes: &MapAxes<D>,
    adjacent: Vec<usize>,
) -> SurfaceMeasure {
    let corners = |f: &[u32; D]| f.map(|n| nodes[n as usize]);
    let middle = |f: &[u32; D]| {
        let sum = corners(f)
            .into_iter()
            .fold([0.0; D], |sum, x| add_scaled(sum, 1.0, x));
        sum.map(|c| c / D as f64)
    };
    let areas: Vec<f64> = facets.iter().map(|f| norm(normal(&corners(f)))).collect();
    let area: f64 = areas.iter().sum();
    let centre = facets.iter().zip(&areas).fold([0.0; D], |sum, (f, &a)| {
        add_scaled(sum, a / area, middle(f))
    });
    let n = plane_normal(nodes, facets, axes);
    let mean_square: f64 = (facets.iter().zip(&areas))
        .map(|(f, a)| a / area * dot(sub(middle(f), centre), n).powi(2))
        .sum();
    let corners = facets.as_flattened().iter();
    let [low, high] = bounding_box(corners.map(|&node| &nodes[node as usize]));
    let SurfaceTopology {
        rim,
        components,
        holes,
        hole_area,
    } = topology(nodes, facets);
    let dip = dot(n, axes.up).clamp(-1.0, 1.0).acos().to_degrees();
    // The normal leans towards the dip direction; strike is 90 degrees less.
    let dip_azimuth = dot(n, axes.east).atan2(dot(n, axes.north)).to_degrees();
    SurfaceMeasure {
        surface: surface + 1,
        name: None,
        kind,
        facets: facets.len(),
        area: smooth_area(nodes, facets, axes.per_sample),
        normal: n.to_vec(),
        dip: axes.has_dip.then_some(dip),
        strike: (D == 3 && axes.has_strike).then(|| (dip_azimuth - 90.0).rem_euclid(360.0)),
        centre: centre.to_vec(),
        min_corner: low.to_vec(),
        max_corner: high.to_vec(),
        vertical_range: [low, high].map(|corner| dot(corner, axes.up.map(f64::abs))),
        rms_plane_distance: mean_square.sqrt(),
        rim,
        components,
        holes,
        hole_area,
        adjacent_surfaces: adjacent,
        amplitudes: None,
    }
}

/// Returns the unit normal of the plane from which the facets deviate least, in units of samples
/// and weighted by their area there. The normal points up.
fn plane_normal<const D: usize>(
    nodes: &[[f64; D]],
    facets: &[[u32; D]],
    axes: &MapAxes<D>,
) -> [f64; D] {
    // Positions relative to one node, because coordinates may be large.
    let origin = nodes[facets[0][0] as usize];
    let in_samples = |n: u32| {
        let x = sub(nodes[n as usize], origin);
        axes.per_sample.map(|row| dot(row, x))
    };
    let mut total = 0.0;
    let mut first = [0.0; D];
    let mut second = [[0.0; D]; D];
    for facet in facets {
        let corners = facet.map(in_samples);
        let area = norm(normal(&corners));
        let sum = corners
            .into_iter()
            .fold([0.0; D], |sum, x| add_scaled(sum, 1.0, x));
        total += area;
        first = add_scaled(first, area / D as f64, sum);
        // The integral of the products of coordinates over a simplex.
        let weight = area / (D * (D + 1)) as f64;
        for x in corners.iter().chain([&sum]) {
            for (row, c) in second.iter_mut().zip(x) {
                *row = add_scaled(*row, weight * c, *x);
            }
        }
    }
    let mean = first.map(|c| c / total.max(f64::MIN_POSITIVE));
    for (row, m) in second.iter_mut().zip(mean) {
        *row = add_scaled(*row, -m, first);
    }
    let min_vector = eigenvector(&second, eigenvalues(&second)[0]);
    let mut axis = [0.0; D];
    for (c, row) in min_vector.into_iter().zip(axes.per_sample) {
        axis = add_scaled(axis, c, row);
    }
    orient_up(unit(axis), axes.up)
}

/// Number of passes that average normals before an area is measured; the average extends over two
/// or three facets to each side.
const NORMAL_SMOOTHING_PASSES: usize = 12;

/// Returns the area of the smoothed facets: each facet counts with its projection along the mean
/// normal of the facets around it.
///
/// Normals are averaged as area vectors, because bumps do not change the sum of area vectors except
/// at their rims. `per_sample` converts to samples, in which neighbouring normals differ little.
fn smooth_area<const D: usize>(
    nodes: &[[f64; D]],
    facets: &[[u32; D]],
    per_sample: [[f64; D]; D],
) -> f64 {
    let corners = |f: &[u32; D]| f.map(|n| nodes[n as usize]);
    let in_samples = |x: [f64; D]| {
        let offset = sub(x, nodes[facets[0][0] as usize]);
        per_sample.map(|row| dot(row, offset))
    };
    let area_vectors: Vec<[f64; D]> = facets.iter().map(|f| normal(&corners(f))).collect();
    let sample_vectors: Vec<[f64; D]> = facets
        .iter()
        .map(|f| normal(&corners(f).map(in_samples)))
        .collect();
    // Facets by their ridges, which are all nodes except one.
    let mut ridges: Vec<([u32; D], u32)> = Vec::with_capacity(D * facets.len());
    for (number, facet) in (0u32..).zip(facets) {
        for omitted in 0..D {
            let mut ridge = *facet;
            ridge[omitted] = NONE;
            ridge.sort_unstable();
            ridges.push((ridge, number));
        }
    }
    ridges.sort_unstable();
    // Pairs of neighbours, and the sign of their relative orientation.
    let mut pairs: Vec<(usize, usize, f64)> = Vec::with_capacity(ridges.len());
    for group in ridges.chunk_by(|a, b| a.0 == b.0) {
        for (i, (_, a)) in group.iter().enumerate() {
            for (_, b) in &group[..i] {
                let (a, b) = (*a as usize, *b as usize);
                pairs.push((a, b, dot(sample_vectors[a], sample_vectors[b]).signum()));
            }
        }
    }
    let mut means = area_vectors.clone();
    for _ in 0..NORMAL_SMOOTHING_PASSES {
        let mut sums = means.clone();
        for &(a, b, sign) in &pairs {
            sums[a] = add_scaled(sums[a], sign, means[b]);
            sums[b] = add_scaled(sums[b], sign, means[a]);
        }
        means = sums;
    }
    let projected_area = |(area_vector, mean): (&[f64; D], &[f64; D])| {
        if norm(*mean) > 0.0 {
            dot(*area_vector, unit(*mean))
        } else {
            norm(*area_vector)
        }
    };
    area_vectors
        .iter()
        .zip(&means)
        .map(projected_area)
        .sum::<f64>()
        .abs()
}

/// Returns the axis of the facets' normals, weighted by area and pointing up. It is the main
/// eigenvector of the sum of their outer products, by the power method, so that the signs of single
/// normals do not matter.
pub fn mean_normal<const D: usize>(
    nodes: &[[f64; D]],
    facets: &[[u32; D]],
    up: [f64; D],
) -> [f64; D] {
    let mut tensor = [[0.0; D]; D];
    for facet in facets {
        let n = normal(&facet.map(|i| nodes[i as usize]));
        let weight = 1.0 / norm(n).max(f64::MIN_POSITIVE);
        for i in 0..D {
            tensor[i] = add_scaled(tensor[i], weight * n[i], n);
        }
    }
    // The column with the largest norm is a start vector that is not normal to the axis.
    let mut axis = tensor.into_iter().fold([0.0; D], |best, row| {
        if dot(row, row) > dot(best, best) {
            row
        } else {
            best
        }
    });
    for _ in 0..100 {
        let next = unit(std::array::from_fn(|i| dot(tensor[i], axis)));
        let change = norm(sub(next, axis));
        axis = next;
        if change < 1e-14 {
            break;
        }
    }
    orient_up(axis, up)
}

/// Returns the axis or its opposite, whichever points up.
fn orient_up<const D: usize>(axis: [f64; D], up: [f64; D]) -> [f64; D] {
    // For vertical surfaces, the largest component is positive.
    let mut sign = dot(axis, up);
    if sign.abs() < 1e-9 {
        sign = axis.into_iter().fold(
            0.0,
            |best: f64, c| if c.abs() > best.abs() { c } else { best },
        );
    }
    if sign < 0.0 { axis.map(|c| -c) } else { axis }
}

struct SurfaceTopology {
    rim: f64,
    components: usize,
    holes: usize,
    hole_area: f64,
}

/// Returns the rim, the components and the holes of one surface.
fn topology<const D: usize>(nodes: &[[f64; D]], surface_facets: &[[u32; D]]) -> SurfaceTopology {
    let facets = FacetComplex::new(nodes, surface_facets.to_vec());
    let mut pieces = UnionFind::new(facets.len());
    let mut rim_sides = Vec::new();
    for ridge in 0..facets.ridge_count() {
        let sides = facets.sides(ridge);
        for pair in sides.windows(2) {
            pieces.unite(pair[0] / D as u32, pair[1] / D as u32);
        }
        if let &[side] = sides {
            rim_sides.push(side as usize);
        }
    }
    let (piece, components) = pieces.into_labels();
    let rim = rim_sides.iter().map(|&side| {
        let ends: Vec<[f64; D]> = (facets.ridge_nodes(side))
            .map(|n| nodes[n as usize])
            .collect();
        match ends[..] {
            [a, b] => norm(sub(a, b)),
            _ => 1.0,
        }
    });
    let (holes, hole_area) = count_holes(&facets, &rim_sides, &piece);
    SurfaceTopology {
        rim: rim.sum(),
        components,
        holes,
        hole_area,
    }
}

/// Returns the number and the area of the holes of a surface. `rim` holds the sides without a
/// neighbour. The holes are the closed rim curves of each component, except the one that encloses
/// the largest area.
fn count_holes<const D: usize>(
    facets: &FacetComplex<D>,
    rim: &[usize],
    piece: &[u32],
) -> (usize, f64) {
    if D != 3 {
        return (0, 0.0);
    }
    let rim_nodes = sorted_distinct(rim.iter().flat_map(|&s| facets.ridge_nodes(s)));
    let index_of = |n: u32| rim_nodes.partition_point(|&m| m < n) as u32;
    // Closed curves: rim nodes that rim edges connect.
    let mut curves = UnionFind::new(rim_nodes.len());
    for &side in rim {
        let ends: Vec<u32> = facets.ridge_nodes(side).map(index_of).collect();
        curves.unite(ends[0], ends[1]);
    }
    // Twice the vector area of each curve: facets are oriented consistently, so the edges of a
    // curve have one direction.
    let mut enclosed: BTreeMap<(u32, u32), [f64; 3]> = BTreeMap::new();
    for &side in rim {
        let facet = facets.corners(side / D);
        let [a, b] = [1, 2].map(|step| to_3d(facet[(side % D + step) % D]));
        let first = facets.ridge_nodes(side).map(index_of).next().unwrap_or(0);
        let curve = curves.find(first);
        let base = to_3d(facets.nodes[rim_nodes[curve as usize] as usize]);
        let sum = enclosed.entry((piece[side / D], curve)).or_default();
        *sum = add_scaled(*sum, 1.0, cross(sub(a, base), sub(b, base)));
    }
    let curves: Vec<(u32, f64)> = (enclosed.iter())
        .map(|((piece, _), area)| (*piece, 0.5 * norm(*area)))
        .collect();
    curves
        .chunk_by(|a, b| a.0 == b.0)
        .fold((0, 0.0), |(count, area), piece_curves| {
            let areas = piece_curves.iter().map(|curve| curve.1);
            let largest = areas.clone().fold(0.0, f64::max);
            (
                count + piece_curves.len() - 1,
                area + areas.sum::<f64>() - largest,
            )
        })
}

/// Returns for each surface the numbers, from 1, of the surfaces with which it shares at least as
/// many nodes as a ridge has.
fn adjacent_surfaces<const D: usize>(surfaces: &Surfaces<D>) -> Vec<Vec<usize>> {
    let mut node_surfaces: Vec<(u32, u32)> = (0..surfaces.len())
        .flat_map(|s| {
            let nodes = surfaces.facets_of(s).as_flattened().iter();
            nodes.map(move |&n| (n, s as u32))
        })
        .collect();
    node_surfaces.par_sort_unstable();
    node_surfaces.dedup();
    let mut pairs: Vec<(u32, u32)> = node_surfaces
        .chunk_by(|a, b| a.0 == b.0)
        .flat_map(|entries| {
            entries.iter().flat_map(move |a| {
                entries
                    .iter()
                    .filter(move |b| a.1 != b.1)
                    .map(move |b| (a.1, b.1))
            })
        })
        .collect();
    pairs.sort_unstable();
    let mut adjacent = vec![Vec::new(); surfaces.len()];
    for run in pairs.chunk_by(|a, b| a == b) {
        if run.len() >= D - 1 {
            adjacent[run[0].0 as usize].push(run[0].1 as usize + 1);
        }
    }
    adjacent
}
