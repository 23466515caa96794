//! Atoms along the lines where feature surfaces cross or branch off one another.
//!
//! Both surfaces need nodes on their common line, in the same places. Atoms of a lattice find the
//! line of two surfaces less surely than a surface, so the line gets its atoms first, and the lattice
//! is placed around them.
//!
//! Faces of Voronoi cells need more: the triangles at the line on all sides of it have to be mirror
//! images of one another (see [`crate::mesh::voronoi::conform`]). For them, a row of atoms is placed on
//! each surface along either side of the line, opposite the middles between the line's atoms.

use super::empty_grid;
use crate::feature::{FeatureLine, LineKind};
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::{add_scaled, cross, distance2, norm, sub, to_3d, unit};
use crate::lattice::distance::Distance;

/// Distance between the atoms of a line, in units of d: that of atoms on a surface.
const SPACING: f64 = 0.95;
/// Smallest distance from atoms of other lines, in units of d.
const MIN_DISTANCE: f64 = 0.7;
/// Smallest distance of an atom of a row from other atoms, in units of d. Rows are close to one another
/// where surfaces meet at small angles.
const MIN_ROW_DISTANCE: f64 = 0.45;
/// Smallest distance from a side of the box, except on it, in units of d.
const MIN_DISTANCE_TO_SIDE: f64 = 0.35;
/// Largest distance, in units of d, from the end of a line to the side of the box to which it is
/// continued.
const MAX_GAP_TO_SIDE: f64 = 1.0;
/// Length of the end of a line that gives its direction, in units of d.
const END_LENGTH: f64 = 1.0;
/// Distance of a row from its line, in distances between the line's atoms: the height of an
/// equilateral triangle.
const ROW_DISTANCE: f64 = 0.87;

/// A function that takes a position and a normal, and returns the nearest point of a surface with
/// nearly this normal; `None` if no such surface is near.
pub type Projection<'a, const D: usize> = &'a dyn Fn([f64; D], [f64; D]) -> Option<[f64; D]>;

/// Returns atoms at equal distances, in units of d, along lines where surfaces meet. Longer lines come
/// first. Lines that end near a side of the box `[0, extent]` are continued to it. With a projection
/// onto the surfaces, rows of atoms along the lines follow.
pub fn line_atoms<const D: usize>(
    lines: &[FeatureLine<D>],
    extent: [f64; D],
    distance: &Distance<D>,
    project: Option<Projection<'_, D>>,
) -> Vec<[f64; D]> {
    let mut lines: Vec<&FeatureLine<D>> = (lines.iter())
        .filter(|line| line.kind != LineKind::Tip)
        .collect();
    lines.sort_by(|a, b| b.length.total_cmp(&a.length));
    let mut placed = PlacedAtoms {
        grid: empty_grid([0.0; D], extent, MIN_DISTANCE * distance.min()),
        atoms: Vec::new(),
        extent,
        distance,
    };
    let mut intervals = Vec::new();
    for line in lines {
        let points = continued_to_sides(&line.points, extent, distance);
        let mut previous = None;
        for x in evenly_spaced(&points, distance) {
            let current = placed.add(x, MIN_DISTANCE).then_some(x);
            intervals.extend(
                previous
                    .zip(current)
                    .map(|(start, end)| (line, [start, end])),
            );
            previous = current;
        }
    }
    if let Some(project) = project {
        for (line, ends) in intervals {
            placed.add_rows(line, ends, project);
        }
    }
    placed.atoms
}

/// Atoms that are placed one after the other.
struct PlacedAtoms<'a, const D: usize> {
    grid: IncrementalGrid<D>,
    atoms: Vec<[f64; D]>,
    extent: [f64; D],
    distance: &'a Distance<D>,
}

impl<const D: usize> PlacedAtoms<'_, D> {
    /// Adds an atom if its distance from others, in units of d, is at least `min_distance`, and if
    /// it is not too close to a side of the box. Returns `true` if it was added.
    fn add(&mut self, x: [f64; D], min_distance: f64) -> bool {
        let d = self.distance.value_at(x);
        let is_clear_of_sides = (0..D).all(|k| {
            let gap = x[k].min(self.extent[k] - x[k]);
            gap == 0.0 || gap >= MIN_DISTANCE_TO_SIDE * d
        });
        let is_free = is_clear_of_sides && self.grid.is_free(&x, min_distance * d);
        if is_free {
            self.grid.add(x);
            self.atoms.push(x);
        }
        is_free
    }

    /// Adds atoms on both surfaces on either side of two neighbouring atoms of a line.
    fn add_rows(
        &mut self,
        line: &FeatureLine<D>,
        [start, end]: [[f64; D]; 2],
        project: Projection<'_, D>,
    ) {
        let middle = add_scaled(start, 0.5, sub(end, start));
        let square = |i: &usize| distance2(&line.points[*i], &middle);
        let Some(nearest) = (0..line.points.len()).min_by(|a, b| square(a).total_cmp(&square(b)))
        else {
            return;
        };
        let along = sub(end, start);
        let spacing = norm(along);
        for normal in line.normals[nearest] {
            let lateral = unit(cross(to_3d(along), to_3d(normal)));
            self.add_pair(middle, lateral, ROW_DISTANCE * spacing, normal, project);
            for end in [start, end] {
                let sides = (0..D).filter(|&k| end[k] == 0.0 || end[k] == self.extent[k]);
                for k in sides.collect::<Vec<_>>() {
                    let mut side_normal = [0.0; 3];
                    side_normal[k] = 1.0;
                    let lateral = unit(cross(side_normal, to_3d(normal)));
                    self.add_pair(end, lateral, spacing, normal, project);
                }
            }
        }
    }

    /// Adds the atoms at a distance from `x` on either side, on the surface with this normal. If `x`
    /// is on a side of the box, they are as well.
    fn add_pair(
        &mut self,
        x: [f64; D],
        lateral: [f64; 3],
        distance: f64,
        normal: [f64; D],
        project: Projection<'_, D>,
    ) {
        for step in [-distance, distance] {
            let guess = std::array::from_fn(|k| x[k] + step * lateral[k]);
            if let Some(mut point) = project(guess, normal) {
                for k in (0..D).filter(|&k| x[k] == 0.0 || x[k] == self.extent[k]) {
                    point[k] = x[k];
                }
                self.add(point, MIN_ROW_DISTANCE);
            }
        }
    }
}

/// Returns a line with both of its ends continued straight to the sides of the box that are near.
fn continued_to_sides<const D: usize>(
    line: &[[f64; D]],
    extent: [f64; D],
    distance: &Distance<D>,
) -> Vec<[f64; D]> {
    let mut points = line.to_vec();
    for _ in 0..2 {
        points.reverse();
        let Some(&end) = points.last() else { break };
        let d = distance.value_at(end);
        let is_apart = |x: &&[f64; D]| distance2(x, &end) >= (END_LENGTH * d).powi(2);
        let start = points.iter().rev().find(is_apart).unwrap_or(&points[0]);
        if *start == end {
            break;
        }
        let direction = unit(sub(end, *start));
        let length_to_side = |k: usize| {
            let side = if direction[k] > 0.0 { extent[k] } else { 0.0 };
            (side - end[k]) / direction[k]
        };
        let axes = (0..D).filter(|&k| direction[k] != 0.0);
        let Some(k) = axes.min_by(|&i, &j| length_to_side(i).total_cmp(&length_to_side(j))) else {
            break;
        };
        let length = length_to_side(k);
        if length > 0.0 && length <= MAX_GAP_TO_SIDE * d {
            let mut exit = add_scaled(end, length, direction);
            exit[k] = if direction[k] > 0.0 { extent[k] } else { 0.0 };
            points.push(exit);
        }
    }
    points
}

/// Returns positions along a line, from its first point to its last, whose distances are equal in
/// units of d and as near to [`SPACING`] as possible.
fn evenly_spaced<const D: usize>(points: &[[f64; D]], distance: &Distance<D>) -> Vec<[f64; D]> {
    let mut lengths = vec![0.0];
    for pair in points.windows(2) {
        let middle = add_scaled(pair[0], 0.5, sub(pair[1], pair[0]));
        let length = distance2(&pair[0], &pair[1]).sqrt() / distance.value_at(middle);
        lengths.push(lengths[lengths.len() - 1] + length);
    }
    let total = lengths[lengths.len() - 1];
    if points.len() < 2 || total == 0.0 {
        return points.iter().take(1).copied().collect();
    }
    let count = (total / SPACING).round().max(1.0);
    let position = |i: usize| {
        let at = total * (i as f64 / count);
        let next = lengths.partition_point(|&length| length < at).max(1);
        let next = next.min(points.len() - 1);
        let share = (at - lengths[next - 1]) / (lengths[next] - lengths[next - 1]);
        let [p, q] = [points[next - 1], points[next]];
        add_scaled(p, share.clamp(0.0, 1.0), sub(q, p))
    };
    let mut positions: Vec<[f64; D]> = (0..count as usize).map(position).collect();
    positions.push(points[points.len() - 1]);
    positions
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTENT: [f64; 3] = [40.0, 50.0, 60.0];

    fn line(kind: LineKind, points: Vec<[f64; 3]>) -> FeatureLine<3> {
        let length = distance2(&points[0], &points[points.len() - 1]).sqrt();
        FeatureLine {
            kind,
            surfaces: [1, 2],
            angle: 60.0,
            length,
            normals: vec![[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]; points.len()],
            points,
        }
    }

    fn straight(z: impl Fn(usize) -> f64, count: usize) -> Vec<[f64; 3]> {
        (0..count).map(|i| [20.0, 25.0, z(i)]).collect()
    }

    #[test]
    fn a_line_is_continued_to_near_sides_and_divided_evenly() {
        let distance = Distance::Constant(7.0);
        let crossing = line(LineKind::Crossing, straight(|i| 3.0 + i as f64, 52));
        let atoms = line_atoms(&[crossing], EXTENT, &distance, None);
        // 60 samples are 9 distances of 6.67, which is .95 d.
        assert_eq!(atoms.len(), 10);
        for (i, x) in atoms.iter().enumerate() {
            let expected = [20.0, 25.0, 60.0 * i as f64 / 9.0];
            assert!(distance2(x, &expected) < 1e-20, "{x:?}");
        }
        assert_eq!((atoms[0][2], atoms[9][2]), (0.0, 60.0));
    }

    #[test]
    fn ends_far_from_sides_stay_and_tips_get_no_atoms() {
        let distance = Distance::Constant(7.0);
        let branch = line(LineKind::Branch, straight(|i| 10.0 + i as f64, 31));
        let tip = line(LineKind::Tip, vec![[10.0, 5.0, 20.0], [10.0, 45.0, 20.0]]);
        let atoms = line_atoms(&[tip, branch], EXTENT, &distance, None);
        let heights: Vec<f64> = atoms.iter().map(|x| x[2]).collect();
        // 30 samples are 5 distances of 6, which is nearest to .95 d of 6.65.
        assert_eq!(heights, [10.0, 16.0, 22.0, 28.0, 34.0, 40.0]);
    }

    #[test]
    fn atoms_keep_away_from_other_lines_and_sides() {
        let distance = Distance::Constant(5.0);
        let long = line(
            LineKind::Crossing,
            vec![[20.0, 2.0, 30.0], [20.0, 48.0, 30.0]],
        );
        let short = line(
            LineKind::Crossing,
            vec![[2.0, 25.0, 30.0], [38.0, 25.0, 30.0]],
        );
        // Along an edge of the box, one sample from a side.
        let near_side = line(
            LineKind::Crossing,
            vec![[1.0, 25.0, 2.0], [1.0, 25.0, 20.0]],
        );
        let atoms = line_atoms(&[short, near_side, long], EXTENT, &distance, None);
        for (i, x) in atoms.iter().enumerate() {
            for y in &atoms[..i] {
                assert!(distance2(x, y) >= 3.5f64.powi(2), "{x:?} {y:?}");
            }
            assert!(x[0] != 1.0, "{x:?}");
        }
        assert!(atoms.iter().filter(|x| x[0] == 20.0).count() >= 9);
    }

    #[test]
    fn rows_lie_on_both_surfaces_opposite_the_middles_between_atoms() {
        let distance = Distance::Constant(7.0);
        let crossing = line(LineKind::Crossing, straight(|i| i as f64, 61));
        // Normals along x and y: the surfaces are the planes x = 20 and y = 25.
        let project = |x: [f64; 3], normal: [f64; 3]| {
            let on_first = [20.0, x[1], x[2]];
            let on_second = [x[0], 25.0, x[2]];
            Some(if normal[0] == 1.0 {
                on_first
            } else {
                on_second
            })
        };
        let lines = [crossing];
        let count = line_atoms(&lines, EXTENT, &distance, None).len();
        let atoms = line_atoms(&lines, EXTENT, &distance, Some(&project));
        let (on_line, rows) = atoms.split_at(count);
        let spacing = on_line[1][2];
        // Four rows, and four atoms on the sides of the box at either end.
        assert_eq!(rows.len(), 4 * (count - 1) + 8);
        for x in rows {
            let across = [(x[0] - 20.0).abs(), (x[1] - 25.0).abs()];
            assert!(across.contains(&0.0), "{x:?}");
            let row = across[0].max(across[1]) / spacing;
            if x[2] == 0.0 || x[2] == 60.0 {
                assert!((row - 1.0).abs() < 1e-12, "{x:?}");
            } else {
                assert!((row - ROW_DISTANCE).abs() < 1e-12, "{x:?}");
                let along = (x[2] / spacing).fract();
                assert!((along - 0.5).abs() < 1e-9, "{x:?}");
            }
        }
    }

    #[test]
    fn rows_end_where_a_surface_ends() {
        let distance = Distance::Constant(7.0);
        let branch = line(LineKind::Branch, straight(|i| i as f64, 61));
        // The second surface ends at the first.
        let project =
            |x: [f64; 3], normal: [f64; 3]| (normal[0] == 1.0 || x[0] > 20.0).then_some(x);
        let atoms = line_atoms(&[branch], EXTENT, &distance, Some(&project));
        assert!(atoms.iter().all(|x| x[0] >= 20.0));
        assert!(atoms.iter().any(|x| x[0] > 20.0));
    }

    #[test]
    fn where_curves_cross_in_the_plane_there_is_one_atom() {
        let crossing = FeatureLine {
            kind: LineKind::Crossing,
            surfaces: [1, 2],
            angle: 60.0,
            length: 0.0,
            points: vec![[30.0, 20.0]],
            normals: vec![[[1.0, 0.0], [0.0, 1.0]]],
        };
        let atoms = line_atoms(&[crossing], [60.0, 40.0], &Distance::Constant(6.0), None);
        assert_eq!(atoms, [[30.0, 20.0]]);
    }
}
