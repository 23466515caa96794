//! Fixed atoms: wells, sources, sinks. They come from the user and never move.

use std::path::Path;

use super::{Atoms, sides_held};
use crate::distance::Distance;
use crate::error::{Error, Result, cause, os};
use crate::image::Geometry;
use crate::mesh::AtomKind;

/// Lattice atoms nearer to a fixed atom than this, in units of d, make room for it.
const ROOM: f64 = 0.7;
/// Positions this near to a side (relative to the box) or to each other (relative to d) are taken
/// to be on it, or the same.
const SAME: f64 = 1e-6;

/// Reads positions of fixed atoms, `x,y,z` in physical coordinates on each line, and returns them in
/// lattice space (`step` is the lattice-space distance between samples).
///
/// Commas, semicolons, tabs and spaces separate; columns beyond the third, empty lines, lines that
/// begin with `#` and one header line are skipped.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Seeding`] with the line's number if a line is
/// not three finite numbers, or if there are none.
pub fn read_fixed_csv(
    path: &Path,
    geometry: &Geometry<3>,
    step: [f64; 3],
) -> Result<Vec<[f64; 3]>> {
    let text = std::fs::read_to_string(path).map_err(|e| os(path, "read", e))?;
    let mut positions = Vec::new();
    let mut header_seen = false;
    for (number, line) in text.lines().enumerate() {
        let line = line.trim().trim_start_matches('\u{feff}');
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let fail = |problem: String| {
            let place = format!("{}, line {}", path.display(), number + 1);
            Error::Seeding(cause(
                place,
                problem,
                "give three numbers x,y,z on each line",
            ))
        };
        let fields: Vec<&str> = line
            .split([',', ';', '\t', ' '])
            .map(str::trim)
            .filter(|field| !field.is_empty())
            .collect();
        let numbers: Vec<f64> = fields
            .iter()
            .take(3)
            .map_while(|f| f.parse().ok())
            .collect();
        let Ok(physical) = <[f64; 3]>::try_from(numbers.as_slice()) else {
            // Only a line without any number can be a header.
            if positions.is_empty() && !header_seen && numbers.is_empty() {
                header_seen = true;
                continue;
            }
            return Err(fail(format!(
                "\"{line}\" does not begin with three numbers"
            )));
        };
        if !physical.iter().all(|c| c.is_finite()) {
            return Err(fail(format!("\"{line}\" is not finite")));
        }
        let index = geometry
            .to_index(physical)
            .ok_or_else(|| fail("the image's axes do not span space".to_string()))?;
        positions.push(std::array::from_fn(|k| index[k] * step[k]));
    }
    if positions.is_empty() {
        return Err(Error::Seeding(cause(
            path.display(),
            "holds no positions",
            "give three numbers x,y,z on each line, or leave the file out",
        )));
    }
    Ok(positions)
}

/// Checks fixed atoms against the box `[0, extent]` and against each other; those within rounding
/// of a side are put exactly on it.
///
/// # Errors
/// [`Error::Seeding`] if one lies outside the box or two at one place.
pub fn checked(
    fixed: &[[f64; 3]],
    extent: [f64; 3],
    distance: &Distance<3>,
) -> Result<Vec<[f64; 3]>> {
    let place = |n: usize, x: [f64; 3]| format!("fixed atom {} at {x:?} (lattice)", n + 1);
    let mut snapped = Vec::with_capacity(fixed.len());
    for (n, &x) in fixed.iter().enumerate() {
        let tolerance = extent.map(|l| SAME * l);
        if !(0..3).all(|k| x[k] >= -tolerance[k] && x[k] <= extent[k] + tolerance[k]) {
            return Err(Error::Seeding(cause(
                place(n, x),
                format!("lies outside the box from the origin to {extent:?}"),
                "leave it out or correct its coordinates",
            )));
        }
        snapped.push(std::array::from_fn(|k| {
            if x[k] <= tolerance[k] {
                0.0
            } else if x[k] >= extent[k] - tolerance[k] {
                extent[k]
            } else {
                x[k]
            }
        }));
    }
    if snapped.is_empty() {
        return Ok(snapped);
    }
    let same = SAME * distance.min();
    let mut order: Vec<usize> = (0..snapped.len()).collect();
    order.sort_by(|&a, &b| snapped[a][0].total_cmp(&snapped[b][0]));
    for (n, &a) in order.iter().enumerate() {
        let others = order[n + 1..]
            .iter()
            .take_while(|&&b| snapped[b][0] - snapped[a][0] <= same);
        for &b in others {
            if super::distance2(&snapped[a], &snapped[b]) <= same * same {
                let (first, second) = (a.min(b), a.max(b));
                return Err(Error::Seeding(cause(
                    place(second, fixed[second]),
                    format!("is at the same place as fixed atom {}", first + 1),
                    "leave one of them out",
                )));
            }
        }
    }
    Ok(snapped)
}

/// Adds fixed atoms (already [`checked`]) to a lattice. Lattice atoms nearer to one than 0.7 d make
/// room, unless they lie on more sides of the box than it does: the box keeps its corners, edges and
/// sides.
pub fn insert(atoms: &mut Atoms<3>, fixed: &[[f64; 3]], extent: [f64; 3], distance: &Distance<3>) {
    if fixed.is_empty() {
        return;
    }
    let rooms: Vec<(f64, usize)> = fixed
        .iter()
        .map(|&x| ((ROOM * distance.at(x)).powi(2), sides_held(x, extent)))
        .collect();
    // Sorted along x, so that each lattice atom looks at a few only.
    let mut order: Vec<usize> = (0..fixed.len()).collect();
    order.sort_by(|&a, &b| fixed[a][0].total_cmp(&fixed[b][0]));
    let widest = rooms.iter().fold(0.0f64, |w, r| w.max(r.0)).sqrt();
    let stays = |x: &[f64; 3]| {
        let first = order.partition_point(|&n| fixed[n][0] < x[0] - widest);
        let held = sides_held(*x, extent);
        order[first..]
            .iter()
            .take_while(|&&n| fixed[n][0] <= x[0] + widest)
            .all(|&n| {
                let (room2, fixed_held) = rooms[n];
                held > fixed_held || super::distance2(x, &fixed[n]) >= room2
            })
    };
    let keep: Vec<bool> = atoms.positions.iter().map(stays).collect();
    let mut kept = keep.iter();
    atoms
        .positions
        .retain(|_| kept.next().copied().unwrap_or(true));
    let mut kept = keep.iter();
    atoms.kinds.retain(|_| kept.next().copied().unwrap_or(true));
    atoms.positions.extend_from_slice(fixed);
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seeding::fcc;

    fn read(text: &str) -> Result<Vec<[f64; 3]>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wells.csv");
        std::fs::write(&path, text).unwrap();
        let geometry = Geometry::with_spacing([100.0, 200.0, 0.0], [25.0, 12.5, 4.0]);
        read_fixed_csv(&path, &geometry, [1.0, 1.0, 2.0])
    }

    #[test]
    fn reads_physical_positions() {
        let truth = vec![[2.0, 4.0, 5.0], [0.5, 0.0, 0.0]];
        assert_eq!(
            read("x,y,z\n150,250,10\n\n# a comment\n112.5,200,0\n").unwrap(),
            truth
        );
        assert_eq!(
            read("150 250\t10 W1\r\n112.5; 200; 0; W2\r\n").unwrap(),
            truth
        );
    }

    #[test]
    fn names_the_line_that_is_wrong() {
        for (text, line) in [
            ("x,y,z\n1,2,3\n4,5\n", "line 3"),
            ("1,2,3\nx,y,z\n", "line 2"),
            ("1,2,nan\n", "line 1"),
            ("x,y,z\nx,y,z\n", "line 2"),
            ("1,zwei,3\n", "line 1"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(line), "{error}");
        }
        assert!(
            read("x,y,z\n")
                .unwrap_err()
                .to_string()
                .contains("no positions")
        );
        let geometry = Geometry::default();
        let missing = read_fixed_csv(Path::new("/nowhere/wells.csv"), &geometry, [1.0; 3]);
        assert!(matches!(missing, Err(Error::Io(_))));
    }

    #[test]
    fn lattice_makes_room_and_the_box_stays_whole() {
        let extent = [40.0, 44.0, 48.0];
        let distance = Distance::Constant(6.0);
        let fixed = [
            [20.0, 21.0, 22.0],
            [0.0, 20.0, 20.0],
            [20.0, 0.0, 48.0],
            [1.0, 1.0, 1.0],
        ];
        let plain = fcc(extent, &distance, &[]).unwrap();
        let atoms = fcc(extent, &distance, &fixed).unwrap();
        assert!(atoms.len() <= plain.len() + fixed.len());
        let is = |kind| atoms.kinds.iter().filter(|&&k| k == kind).count();
        assert_eq!((is(AtomKind::Fixed), is(AtomKind::Corner)), (4, 8));
        for (x, kind) in atoms.positions.iter().zip(&atoms.kinds) {
            if *kind == AtomKind::Interior {
                let near = |f: &&[f64; 3]| crate::seeding::distance2(x, f) < (0.7f64 * 6.0).powi(2);
                assert!(fixed.iter().find(near).is_none(), "{x:?}");
            }
        }
    }

    #[test]
    fn impossible_fixed_atoms_are_refused() {
        let extent = [40.0; 3];
        let distance = Distance::Constant(6.0);
        let message = |fixed: &[[f64; 3]]| fcc(extent, &distance, fixed).unwrap_err().to_string();
        let outside = message(&[[1.0, 2.0, 3.0], [41.0, 2.0, 3.0]]);
        assert!(
            outside.contains("fixed atom 2") && outside.contains("outside"),
            "{outside}"
        );
        assert!(message(&[[f64::NAN, 2.0, 3.0]]).contains("outside"));
        let twice = message(&[[1.0, 2.0, 3.0], [5.0, 5.0, 5.0], [1.0, 2.0, 3.0]]);
        assert!(twice.contains("same place as fixed atom 1"), "{twice}");
    }
}
