//! Names of surfaces that an earlier interpretation has.
//!
//! Numbers of surfaces change with the distance between nodes and with every option of the detection.
//! Names do not, if each surface takes the name of the earlier surface that lies at the same place:
//! most of either must be near the other. Of several parts of an earlier surface, the largest takes its
//! name.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use super::{SurfaceKind, Surfaces};
use crate::geometry::cell_list::CellList;
use crate::geometry::{distance2, norm, normal};
use crate::parallel::prelude::*;

/// Smallest distance (samples) within which two surfaces are at the same place.
const MIN_TOLERANCE: f64 = 4.0;

/// Share of a surface that must be near another one, so that both are the same.
const MIN_SHARE: f64 = 0.5;

/// Largest number of points along an edge of a simplex of an earlier surface.
const MAX_EDGE_POINTS: usize = 64;

/// A surface of an earlier interpretation, in samples.
#[derive(Debug, Clone, PartialEq)]
pub struct EarlierSurface<const D: usize> {
    /// The name.
    pub name: String,
    /// The corners of each triangle, the ends of each segment, or single points.
    pub simplices: Vec<Vec<[f64; D]>>,
}

/// Names of surfaces by earlier ones.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MatchedNames {
    /// The name of each surface.
    pub names: Vec<String>,
    /// Number of surfaces with the name of an earlier one.
    pub matched_count: usize,
}

/// Names surfaces. `nodes` are in samples. The first `file_names` surfaces keep these names. A
/// surface that no earlier one matches gets its kind and a number that no earlier name has.
pub fn match_names<const D: usize>(
    surfaces: &Surfaces<D>,
    kinds: &[SurfaceKind],
    nodes: &[[f64; D]],
    file_names: &[String],
    earlier: &[EarlierSurface<D>],
) -> MatchedNames {
    let mut names: Vec<Option<String>> = file_names.iter().cloned().map(Some).collect();
    names.resize(surfaces.len(), None);
    let pairs = overlaps(surfaces, nodes, earlier);
    let mut is_taken: Vec<bool> = (earlier.iter())
        .map(|surface| file_names.contains(&surface.name))
        .collect();
    for (s, e) in pairs {
        if names[s].is_none() && !std::mem::replace(&mut is_taken[e], true) {
            names[s] = Some(earlier[e].name.clone());
        }
    }
    let matched_count = names[file_names.len()..].iter().flatten().count();
    let known: Vec<String> = (file_names.iter())
        .chain(earlier.iter().map(|surface| &surface.name))
        .cloned()
        .collect();
    let mut last = BTreeMap::new();
    let mut new_name = |kind: SurfaceKind| {
        let number = last
            .entry(kind.name())
            .or_insert_with(|| largest_number(&known, kind.name()));
        *number += 1;
        format!("{}{number}", kind.name())
    };
    MatchedNames {
        names: (names.into_iter().zip(kinds))
            .map(|(name, kind)| name.unwrap_or_else(|| new_name(*kind)))
            .collect(),
        matched_count,
    }
}

/// Returns the largest number after `kind` in names.
fn largest_number(names: &[String], kind: &str) -> u64 {
    let numbers = names.iter().filter_map(|name| {
        let digits: String = (name.strip_prefix(kind)?.chars())
            .take_while(char::is_ascii_digit)
            .collect();
        digits.parse::<u64>().ok()
    });
    numbers.max().unwrap_or(0)
}

/// Returns the pairs of surfaces and earlier surfaces at the same place, those with the largest
/// common area first.
fn overlaps<const D: usize>(
    surfaces: &Surfaces<D>,
    nodes: &[[f64; D]],
    earlier: &[EarlierSurface<D>],
) -> Vec<(usize, usize)> {
    let corners = |facet: &[u32; D]| facet.map(|n| nodes[n as usize]);
    let areas: Vec<f64> = (surfaces.facets.iter())
        .map(|facet| norm(normal(&corners(facet))))
        .collect();
    let centres: Vec<[f64; D]> = (surfaces.facets.iter())
        .map(|facet| centre(&corners(facet)))
        .collect();
    let edge = |simplex: &[[f64; D]]| {
        let ends = simplex.iter().zip(simplex.iter().cycle().skip(1));
        let squares = ends.map(|(a, b)| distance2(a, b));
        squares.fold(0.0, f64::max).sqrt()
    };
    let mean_edge = (surfaces.facets.iter())
        .map(|facet| edge(&corners(facet)))
        .sum::<f64>()
        / surfaces.facets.len().max(1) as f64;
    let tolerance = mean_edge.max(MIN_TOLERANCE);
    // Points of the earlier surfaces, with the index of their surface.
    let points: Vec<(u32, [f64; D])> = (earlier.par_iter().enumerate())
        .flat_map_iter(|(e, surface)| {
            let simplices = surface.simplices.iter();
            let points = simplices.flat_map(|simplex| {
                let count = (2.0 * edge(simplex) / tolerance).ceil() as usize;
                fill(simplex, count.clamp(1, MAX_EDGE_POINTS))
            });
            points.map(move |x| (e as u32, x)).collect::<Vec<_>>()
        })
        .collect();
    let positions: Vec<[f64; D]> = points.iter().map(|point| point.1).collect();
    let labels = surfaces.labels();
    let nearest_earlier = nearest(&centres, &positions, tolerance);
    let nearest_surface = nearest(&positions, &centres, tolerance);
    // Common area, and the number of common points of the earlier surface.
    let mut common: BTreeMap<(usize, usize), (f64, usize)> = BTreeMap::new();
    let mut totals = vec![0.0; surfaces.len()];
    for (f, near) in nearest_earlier.into_iter().enumerate() {
        let s = labels[f] as usize;
        totals[s] += areas[f];
        if let Some(point) = near {
            common.entry((s, points[point].0 as usize)).or_default().0 += areas[f];
        }
    }
    let mut counts = vec![0; earlier.len()];
    for ((e, _), near) in points.iter().zip(nearest_surface) {
        counts[*e as usize] += 1;
        if let Some(facet) = near {
            let entry = common.entry((labels[facet] as usize, *e as usize));
            entry.or_default().1 += 1;
        }
    }
    let is_same = |((s, e), (area, count)): (&(usize, usize), &(f64, usize))| {
        let share = (area / totals[*s]).max(*count as f64 / f64::from(counts[*e]));
        *area > 0.0 && share >= MIN_SHARE
    };
    let mut pairs: Vec<((usize, usize), f64)> = (common.iter())
        .filter(|entry| is_same(*entry))
        .map(|(pair, (area, _))| (*pair, *area))
        .collect();
    pairs.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    pairs.into_iter().map(|(pair, _)| pair).collect()
}

/// Returns the index of the nearest of `points` to each place, if one is within `radius`.
fn nearest<const D: usize>(
    places: &[[f64; D]],
    points: &[[f64; D]],
    radius: f64,
) -> Vec<Option<usize>> {
    let list = CellList::new(points, radius);
    let nearest_to = |x: &[f64; D]| {
        let mut best: Option<(f64, Reverse<usize>)> = None;
        list.visit_within(*x, radius, |i| {
            let distance = distance2(&points[i], x);
            let is_nearer = best.is_none_or(|(least, Reverse(j))| (distance, i) < (least, j));
            if distance <= radius * radius && is_nearer {
                best = Some((distance, Reverse(i)));
            }
        });
        best.map(|(_, Reverse(i))| i)
    };
    places.par_iter().map(nearest_to).collect()
}

/// Returns the mean of corners.
fn centre<const D: usize>(corners: &[[f64; D]]) -> [f64; D] {
    std::array::from_fn(|k| corners.iter().map(|x| x[k]).sum::<f64>() / corners.len() as f64)
}

/// Returns points in a simplex, `count` along each edge.
fn fill<const D: usize>(corners: &[[f64; D]], count: usize) -> Vec<[f64; D]> {
    let mix = |weights: [f64; 3]| {
        std::array::from_fn(|k| {
            let terms = corners.iter().zip(weights);
            terms.map(|(corner, weight)| weight * corner[k]).sum()
        })
    };
    let step = |i: usize| (i as f64 + 1.0 / 3.0) / count as f64;
    match corners.len() {
        1 => corners.to_vec(),
        2 => (0..count)
            .map(|i| (i as f64 + 0.5) / count as f64)
            .map(|t| mix([1.0 - t, t, 0.0]))
            .collect(),
        _ => (0..count)
            .flat_map(|i| (0..count - i).map(move |j| (i, j)))
            .map(|(i, j)| mix([1.0 - step(i) - step(j), step(i), step(j)]))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an upright sheet at `x` from `low` to `high` along y, with edges of `edge`.
    fn sheet(x: f64, [low, high]: [f64; 2], edge: f64) -> Vec<[[f64; 3]; 3]> {
        let steps = ((high - low) / edge) as usize;
        let corner = |i: usize, j: usize| [x, low + edge * i as f64, edge * j as f64];
        (0..steps)
            .flat_map(|i| (0..5).map(move |j| (i, j)))
            .flat_map(|(i, j)| {
                let [a, b, c, d] =
                    [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|(i, j)| corner(i, j));
                [[a, b, c], [b, c, d]]
            })
            .collect()
    }

    fn surfaces(sheets: &[Vec<[[f64; 3]; 3]>]) -> (Vec<[f64; 3]>, Surfaces<3>) {
        let nodes: Vec<[f64; 3]> = sheets.iter().flatten().flatten().copied().collect();
        let facets = (0..nodes.len() as u32 / 3).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]);
        let mut surfaces = Surfaces {
            facets: facets.collect(),
            start: vec![0],
            ..Surfaces::default()
        };
        for sheet in sheets {
            let end = surfaces.start.last().unwrap() + sheet.len();
            surfaces.start.push(end);
        }
        (nodes, surfaces)
    }

    fn earlier(sheets: &[(&str, Vec<[[f64; 3]; 3]>)]) -> Vec<EarlierSurface<3>> {
        let surface = |(name, sheet): &(&str, Vec<[[f64; 3]; 3]>)| EarlierSurface {
            name: (*name).into(),
            simplices: sheet.iter().map(|t| t.to_vec()).collect(),
        };
        sheets.iter().map(surface).collect()
    }

    #[test]
    fn surfaces_at_the_same_place_keep_their_names() {
        let known = earlier(&[
            ("Main", sheet(10.0, [0.0, 80.0], 8.0)),
            ("fault7", sheet(40.0, [0.0, 40.0], 8.0)),
            ("Gone", sheet(90.0, [0.0, 40.0], 8.0)),
        ]);
        // In another order, with other edges, slightly off, and with a new surface in between.
        let (nodes, found) = surfaces(&[
            sheet(41.5, [4.0, 44.0], 5.0),
            sheet(60.0, [0.0, 60.0], 5.0),
            sheet(9.0, [0.0, 30.0], 5.0),
            sheet(9.0, [35.0, 80.0], 5.0),
        ]);
        let kinds = [SurfaceKind::Fault; 4];
        let matched = match_names(&found, &kinds, &nodes, &[], &known);
        assert_eq!(matched.names, ["fault7", "fault8", "fault9", "Main"]);
        assert_eq!(matched.matched_count, 2);
        // A name in the mesh's file is not given again.
        let matched = match_names(&found, &kinds, &nodes, &["Main".into()], &known);
        assert_eq!(matched.names, ["Main", "fault8", "fault9", "fault10"]);
        assert_eq!(matched.matched_count, 0);
    }

    #[test]
    fn points_and_lines_are_matched_as_well() {
        let points = (0..60).map(|i| vec![[10.0, f64::from(i), 12.0]]);
        let known = EarlierSurface {
            name: "picks".to_string(),
            simplices: points.collect(),
        };
        let (nodes, found) = surfaces(&[sheet(10.0, [0.0, 60.0], 5.0)]);
        let matched = match_names(&found, &[SurfaceKind::Fault], &nodes, &[], &[known]);
        assert_eq!(matched.names, ["picks"]);
        let line = EarlierSurface {
            name: "line".to_string(),
            simplices: vec![vec![[0.0, 3.0], [40.0, 3.0]]],
        };
        let nodes: Vec<[f64; 2]> = (0..10).map(|i| [4.0 * f64::from(i), 2.0]).collect();
        let found = Surfaces {
            facets: (0..9).map(|i| [i, i + 1]).collect(),
            start: vec![0, 9],
            ..Surfaces::default()
        };
        let matched = match_names(&found, &[SurfaceKind::Horizon], &nodes, &[], &[line]);
        assert_eq!(matched.names, ["line"]);
    }
}
