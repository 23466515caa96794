//! Continues given faults that end near a side of the image or near another fault.
//!
//! A fault stick often stops a sample short of the side of a survey, or of the fault at which it
//! ends. The mesh would then have a gap through which fluid flows. The rim of such a fault is
//! continued in the direction of its surface to what it ends near.

use std::collections::BTreeMap;

use crate::feature::GivenSurface;
use crate::geometry::{add_scaled, cross, dot, norm, sub, unit};
use crate::mesh::poly::SIDE_NAMES;

/// Corners nearer to each other than this, in samples, are one node.
const WELD_DISTANCE: f64 = 1e-6;
/// Distance in samples by which a continued surface goes beyond what it ends near.
const OVERSHOOT: f64 = 0.3;
/// Smallest cosine between the directions out of two edges that are one straight rim.
const STRAIGHT_COSINE: f64 = 0.9;
/// Smallest distance, in samples, by which a rim is continued.
const MIN_STEP: f64 = 1e-3;

/// A given surface that was continued.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ContinuedSurface {
    /// Index of the surface.
    pub index: usize,
    /// The longest distance from its rim to what it ends near, in the unit of the metric.
    pub longest: f64,
    /// Names of the sides and faults to which it was continued.
    pub targets: Vec<String>,
}

/// A surface of triangles with common nodes.
struct Sheet {
    nodes: Vec<[f64; 3]>,
    triangles: Vec<[usize; 3]>,
}

impl Sheet {
    /// Joins equal corners of triangles.
    fn new<const D: usize>(triangles: &[[[f64; D]; D]], scale: [f64; 3]) -> Self {
        let mut numbers: BTreeMap<[i64; 3], usize> = BTreeMap::new();
        let mut nodes = Vec::new();
        let mut node = |corner: [f64; D]| {
            let corner: [f64; 3] = std::array::from_fn(|k| corner[k] * scale[k]);
            let key = corner.map(|c| (c / WELD_DISTANCE).round() as i64);
            *numbers.entry(key).or_insert_with(|| {
                nodes.push(corner);
                nodes.len() - 1
            })
        };
        let triangles = triangles
            .iter()
            .map(|t| [node(t[0]), node(t[1]), node(t[2])])
            .collect();
        Self { nodes, triangles }
    }

    /// Returns the edges that belong to one triangle, each with the third node of it.
    fn rim(&self) -> Vec<[usize; 3]> {
        let mut edges: BTreeMap<[usize; 2], (usize, [usize; 3])> = BTreeMap::new();
        for t in &self.triangles {
            for [a, b, c] in [[t[0], t[1], t[2]], [t[1], t[2], t[0]], [t[2], t[0], t[1]]] {
                let entry = edges.entry([a.min(b), a.max(b)]).or_insert((0, [a, b, c]));
                entry.0 += 1;
            }
        }
        let edges = edges.into_values();
        edges
            .filter(|(count, _)| *count == 1)
            .map(|e| e.1)
            .collect()
    }

    /// Returns the directions in which the surface goes on at the nodes of its rim: one for each edge of the
    /// rim that ends there, or the mean of two that are nearly the same.
    fn outward_directions(&self, rim: &[[usize; 3]]) -> BTreeMap<usize, Vec<[f64; 3]>> {
        let mut directions: BTreeMap<usize, Vec<[f64; 3]>> = BTreeMap::new();
        for edge in rim {
            let [a, b, c] = edge.map(|n| self.nodes[n]);
            let along = sub(b, a);
            let squared = dot(along, along);
            if squared == 0.0 {
                continue;
            }
            let outward = sub(a, c);
            let outward = add_scaled(outward, -dot(outward, along) / squared, along);
            if norm(outward) == 0.0 {
                continue;
            }
            for node in [edge[0], edge[1]] {
                directions.entry(node).or_default().push(unit(outward));
            }
        }
        for list in directions.values_mut() {
            let is_straight = list
                .windows(2)
                .all(|pair| dot(pair[0], pair[1]) > STRAIGHT_COSINE);
            if is_straight || list.len() > 2 {
                let sum = list
                    .iter()
                    .fold([0.0; 3], |sum, d| add_scaled(sum, 1.0, *d));
                list.clear();
                list.extend((norm(sum) > 0.0).then(|| unit(sum)));
            }
        }
        directions
    }
}

/// Returns the displacement that goes so far along each of one or two directions.
fn displacement(directions: &[[f64; 3]], distances: &[f64]) -> [f64; 3] {
    match (directions, distances) {
        ([u, v], [a, b]) => {
            let cosine = dot(*u, *v);
            let determinant = 1.0 - cosine * cosine;
            let along = [
                (a - cosine * b) / determinant,
                (b - cosine * a) / determinant,
            ];
            add_scaled(u.map(|c| along[0] * c), along[1], *v)
        }
        ([u], [a]) => u.map(|c| a * c),
        _ => [0.0; 3],
    }
}

/// Returns the fraction of a ray from `x` along `direction` at which it crosses a triangle.
fn crossing(x: [f64; 3], direction: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> Option<f64> {
    // Möller and Trumbore (1997).
    let (u, v) = (sub(b, a), sub(c, a));
    let p = cross(direction, v);
    let determinant = dot(u, p);
    if determinant.abs() <= 1e-12 * norm(u) * norm(v) {
        return None;
    }
    let offset = sub(x, a);
    let first = dot(offset, p) / determinant;
    let q = cross(offset, u);
    let second = dot(direction, q) / determinant;
    let tolerance = 1e-9;
    let is_inside =
        first >= -tolerance && second >= -tolerance && first + second <= 1.0 + tolerance;
    is_inside.then(|| dot(v, q) / determinant)
}

/// Returns the distance of the first of other faults from `x` along a direction, and its name.
fn nearest_fault<'a>(
    x: [f64; 3],
    direction: [f64; 3],
    others: impl Iterator<Item = (&'a Sheet, &'a str)>,
    [low, high]: [f64; 2],
) -> Option<(f64, String)> {
    let mut nearest: Option<(f64, &str)> = None;
    for (sheet, name) in others {
        for triangle in &sheet.triangles {
            let found = crossing(x, direction, triangle.map(|n| sheet.nodes[n]));
            if let Some(t) = found.filter(|t| (low..=high).contains(t))
                && nearest.is_none_or(|(best, _)| t < best)
            {
                nearest = Some((t, name));
            }
        }
    }
    nearest.map(|(t, name)| (t, name.to_string()))
}

/// Returns the distance of the first side of a box from `x` along a direction, and its name.
fn nearest_side(
    x: [f64; 3],
    direction: [f64; 3],
    last: [f64; 3],
    [low, high]: [f64; 2],
) -> Option<(f64, String)> {
    let distances = (0..6).map(|side| {
        let (axis, plane) = (side / 2, [0.0, last[side / 2]][side % 2]);
        ((plane - x[axis]) / direction[axis], side)
    });
    let near = distances.filter(|(t, _)| (low..=high).contains(t));
    let nearest = near.min_by(|a, b| a.0.total_cmp(&b.0));
    nearest.map(|(t, side)| (t, format!("side {}", SIDE_NAMES[side])))
}

/// Continues the faults among given surfaces, in sample coordinates, to sides of an image and to other
/// faults that are nearer than `reach`, in a space in which samples have these lengths.
pub(super) fn continue_faults<const D: usize>(
    surfaces: &mut [GivenSurface<D>],
    dims: [usize; D],
    lengths: [f64; D],
    reach: f64,
) -> Vec<ContinuedSurface> {
    if D != 3 {
        return Vec::new();
    }
    let scale: [f64; 3] = std::array::from_fn(|k| lengths[k]);
    let last: [f64; 3] = std::array::from_fn(|k| (dims[k] as f64 - 1.0) * scale[k]);
    let sample = scale.into_iter().fold(f64::INFINITY, f64::min);
    let sheets: Vec<Sheet> = (surfaces.iter())
        .map(|surface| Sheet::new(&surface.triangles, scale))
        .collect();
    let mut continued = Vec::new();
    for (index, sheet) in sheets.iter().enumerate() {
        if surfaces[index].is_horizon {
            continue;
        }
        let rim = sheet.rim();
        let mut ends: BTreeMap<usize, [f64; 3]> = BTreeMap::new();
        let (mut longest, mut targets) = (0.0f64, Vec::new());
        for (node, directions) in sheet.outward_directions(&rim) {
            let x = sheet.nodes[node];
            let tolerance = WELD_DISTANCE * sample;
            if (0..3).any(|k| x[k] < -tolerance || x[k] > last[k] + tolerance) {
                continue;
            }
            let found: Vec<Option<(f64, String)>> = directions
                .iter()
                .map(|direction| {
                    let range = [MIN_STEP * sample, reach];
                    let others = (0..sheets.len())
                        .filter(|other| *other != index && !surfaces[*other].is_horizon);
                    let others = others.map(|other| (&sheets[other], &*surfaces[other].name));
                    nearest_fault(x, *direction, others, range)
                        .or_else(|| nearest_side(x, *direction, last, range))
                })
                .collect();
            if found.iter().all(Option::is_none) {
                continue;
            }
            let distance = |target: &Option<(f64, String)>| {
                target.as_ref().map_or(0.0, |(t, _)| t + OVERSHOOT * sample)
            };
            let distances: Vec<f64> = found.iter().map(distance).collect();
            for (t, name) in found.into_iter().flatten() {
                longest = longest.max(t);
                targets.push(name);
            }
            ends.insert(
                node,
                add_scaled(x, 1.0, displacement(&directions, &distances)),
            );
        }
        let mut added: Vec<[[f64; 3]; 3]> = Vec::new();
        for [a, b, _] in rim {
            let [x, y] = [a, b].map(|n| sheet.nodes[n]);
            match (ends.get(&a), ends.get(&b)) {
                (Some(&end), Some(&other_end)) => {
                    added.extend([[x, y, other_end], [x, other_end, end]]);
                }
                (Some(&end), None) | (None, Some(&end)) => added.push([x, y, end]),
                (None, None) => {}
            }
        }
        if added.is_empty() {
            continue;
        }
        let triangles = added
            .iter()
            .map(|t| std::array::from_fn(|i| std::array::from_fn(|k| t[i][k] / scale[k])));
        surfaces[index].triangles.extend(triangles);
        targets.sort();
        targets.dedup();
        continued.push(ContinuedSurface {
            index,
            longest,
            targets,
        });
    }
    continued
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a plane x = `x` between ranges of y and z, of squares of 4 samples.
    fn plane(name: &str, x: f64, y: [f64; 2], z: [f64; 2]) -> GivenSurface<3> {
        let steps = |[low, high]: [f64; 2]| {
            let count = ((high - low) / 4.0).ceil() as usize;
            (0..=count).map(move |i| low + (high - low) * i as f64 / count as f64)
        };
        let (ys, zs): (Vec<f64>, Vec<f64>) = (steps(y).collect(), steps(z).collect());
        let mut triangles = Vec::new();
        for y in ys.windows(2) {
            for z in zs.windows(2) {
                let [a, b, c, d] = [
                    [x, y[0], z[0]],
                    [x, y[1], z[0]],
                    [x, y[1], z[1]],
                    [x, y[0], z[1]],
                ];
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        GivenSurface {
            name: name.into(),
            is_horizon: false,
            triangles,
        }
    }

    fn area(surface: &GivenSurface<3>) -> f64 {
        let areas = surface.triangles.iter();
        areas
            .map(|t| 0.5 * norm(cross(sub(t[1], t[0]), sub(t[2], t[0]))))
            .sum()
    }

    #[test]
    fn a_fault_goes_on_to_sides_that_are_near_and_to_no_others() {
        // 2 samples short of ymax, 13 of zmax and 12 of ymin.
        let mut surfaces = [plane("a", 20.0, [12.0, 37.0], [0.0, 26.0])];
        let continued = continue_faults(&mut surfaces, [40; 3], [1.0; 3], 5.0);
        assert_eq!(continued.len(), 1);
        assert_eq!(continued[0].targets, ["side ymax"]);
        let mut surfaces = [plane("a", 20.0, [12.0, 37.0], [0.0, 36.0])];
        let continued = continue_faults(&mut surfaces, [40; 3], [1.0; 3], 5.0);
        assert_eq!(continued[0].targets, ["side ymax", "side zmax"]);
        // The corner is covered, too.
        let reaches = |y: f64, z: f64| {
            surfaces[0].triangles.iter().any(|t| {
                crossing([0.0, y, z], [1.0, 0.0, 0.0], *t).is_some_and(|x| (x - 20.0).abs() < 1e-9)
            })
        };
        assert!(reaches(38.9, 38.9) && reaches(38.9, 5.0) && reaches(20.0, 38.9));
        assert!(!reaches(11.0, 20.0));
        // Nothing is near.
        let mut far = [plane("a", 20.0, [12.0, 30.0], [8.0, 30.0])];
        assert!(continue_faults(&mut far, [40; 3], [1.0; 3], 5.0).is_empty());
        // Samples that are twice as long are twice as far.
        let mut long = [plane("a", 20.0, [12.0, 36.0], [8.0, 30.0])];
        assert!(continue_faults(&mut long, [40; 3], [1.0, 2.0, 1.0], 5.0).is_empty());
    }

    #[test]
    fn a_fault_goes_on_to_the_next_fault() {
        let mut other = plane("b", 10.0, [0.0, 39.0], [0.0, 39.0]);
        // The plane y = 10.
        for triangle in &mut other.triangles {
            for corner in triangle {
                corner.swap(0, 1);
            }
        }
        let mut surfaces = [plane("a", 20.0, [13.0, 39.0], [0.0, 39.0]), other];
        let before = area(&surfaces[0]);
        let continued = continue_faults(&mut surfaces, [40; 3], [1.0; 3], 4.0);
        assert_eq!(continued.len(), 1);
        assert_eq!(
            (continued[0].index, &*continued[0].targets),
            (0, &["b".to_string()][..])
        );
        assert!((continued[0].longest - 3.0).abs() < 1e-9, "{continued:?}");
        let added = area(&surfaces[0]) - before;
        assert!((added / (3.3 * 39.0) - 1.0).abs() < 1e-9, "{added}");
        // A horizon is no target, and is not continued.
        surfaces[1].is_horizon = true;
        surfaces[0].triangles.truncate(4);
        assert!(
            continue_faults(&mut surfaces, [40; 3], [1.0; 3], 4.0)
                .iter()
                .all(|continued| continued.targets.iter().all(|t| t != "b"))
        );
    }
}
