//! The checker of meshes of polyhedra: is this a valid mesh that fills its box exactly?

use rayon::prelude::*;
use serde::Serialize;

use super::poly::{Beyond, NO_CELL, PolyMesh, SIDE_0, dot};

/// What [`check_poly`] found. A mesh that is right has `problems` empty.
#[derive(Debug, Clone, Serialize, PartialEq, Default)]
pub struct PolyCheck {
    /// Number of cells.
    pub cells: usize,
    /// Number of faces, each counted once.
    pub faces: usize,
    /// Number of nodes.
    pub nodes: usize,
    /// Whether the cells are columns whose layers, top or base are not level.
    pub in_columns: bool,
    /// Cells of zero or negative volume.
    pub not_positive: usize,
    /// Cells whose faces do not close: an edge (a node in 2-D) is not met by exactly two of them.
    pub not_closed: usize,
    /// Cells that do not hold their own site.
    pub without_site: usize,
    /// |sum of volumes - volume of the box| / volume of the box; of columns, the volume between top and
    /// base.
    pub volume_error: f64,
    /// Largest relative error of a side's area, summed over its faces.
    pub area_error: f64,
    /// Largest distance of a boundary node from the side of its face, over the box's longest side.
    pub flatness_error: f64,
    /// Largest distance of a node from the plane of its face, over the box's longest side.
    pub warp: f64,
    /// Each fault in one line.
    pub problems: Vec<String>,
}

impl PolyCheck {
    /// Whether nothing is wrong.
    pub fn passed(&self) -> bool {
        self.problems.is_empty()
    }
}

/// Checks a mesh against the box `[low, high]`: faces between two cells or on a side of the box,
/// cells closed, of positive volume and with their sites inside, faces and sides flat, areas of
/// sides and the volume filled, all to `tolerance`.
///
/// Columns fill the box as seen from above: their layers, their top and their base may be bent, and
/// their volume is what lies between top and base.
pub fn check_poly<const D: usize>(
    mesh: &PolyMesh<D>,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
) -> PolyCheck {
    check_welded(mesh, low, high, tolerance, 0.0)
}

/// [`check_poly`] of cells whose nodes are welded within the share `weld` of their distance to their
/// sites: faces need be flat to that only.
pub fn check_welded<const D: usize>(
    mesh: &PolyMesh<D>,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
    weld: f64,
) -> PolyCheck {
    let mut found = PolyCheck {
        cells: mesh.sites.len(),
        faces: mesh.face_cells.len(),
        nodes: mesh.nodes.len(),
        ..PolyCheck::default()
    };
    if let Some(problem) = broken(mesh) {
        found.problems.push(problem);
        return found;
    }
    let longest = (0..D).map(|k| high[k] - low[k]).fold(0.0, f64::max);
    let in_columns = mesh.stands_in_columns() && bent(mesh, low, high, tolerance * longest);
    found.in_columns = in_columns;

    let faces = mesh.faces_of_cells();
    let cells: Vec<(f64, bool, bool)> = (0..mesh.sites.len())
        .into_par_iter()
        .map(|cell| {
            let faces = faces.get(cell);
            let (volume, _) = mesh.cell_shape(cell, faces);
            (
                volume,
                closed(mesh, cell, faces),
                holds_site(mesh, cell, faces, in_columns),
            )
        })
        .collect();
    let mut fault = |what: &str, good: &dyn Fn(&(f64, bool, bool)) -> bool| {
        let count = cells.iter().filter(|c| !good(c)).count();
        if let Some(first) = cells.iter().position(|c| !good(c)) {
            found
                .problems
                .push(format!("{count} cells {what}, the first is {first}"));
        }
        count
    };
    let not_positive = fault("are flat or inverted", &|c| c.0 > 0.0);
    let not_closed = fault("are not closed", &|c| c.1);
    let without_site = fault("do not hold their site", &|c| c.2);
    (found.not_positive, found.not_closed, found.without_site) =
        (not_positive, not_closed, without_site);

    let volume: f64 = cells.iter().map(|c| c.0).sum();
    let box_volume: f64 = match in_columns {
        true => mesh.enclosed_volume(),
        false => (0..D).map(|k| high[k] - low[k]).product(),
    };
    found.volume_error = ((volume - box_volume) / box_volume).abs();
    if found.volume_error > tolerance || found.volume_error.is_nan() {
        found.problems.push(format!(
            "the cells fill {volume} instead of the {box_volume} between the sides"
        ));
    }
    found.warp = (0..mesh.face_cells.len())
        .into_par_iter()
        .filter(|&f| !in_columns || mesh.is_upright(f))
        .map(|f| (warp(mesh, f) - welded(mesh, f, weld)).max(0.0) / longest)
        .reduce(|| 0.0, f64::max);
    if found.warp > tolerance {
        found.problems.push(format!(
            "a face is not flat, by {:.1e} of the box",
            found.warp
        ));
    }
    sides(
        mesh,
        [low, high],
        longest,
        tolerance,
        in_columns,
        &mut found,
    );
    found
}

/// Whether a face above or below a cell of columns is not level, or the top or the base is not a side
/// of the box.
fn bent<const D: usize>(mesh: &PolyMesh<D>, low: [f64; D], high: [f64; D], most: f64) -> bool {
    (0..mesh.face_cells.len()).any(|f| {
        let ring = mesh.faces.get(f);
        let plane = match mesh.beyond(f) {
            Beyond::Cell(_) if !mesh.is_upright(f) => mesh.nodes[ring[0] as usize][D - 1],
            Beyond::Side(4) => low[D - 1],
            Beyond::Side(5) => high[D - 1],
            _ => return false,
        };
        let off = |&n: &u32| (mesh.nodes[n as usize][D - 1] - plane).abs();
        ring.iter().map(off).any(|off| off > most)
    })
}

/// What makes a mesh unreadable.
fn broken<const D: usize>(mesh: &PolyMesh<D>) -> Option<String> {
    let (nodes, cells, faces) = (mesh.nodes.len(), mesh.sites.len(), mesh.face_cells.len());
    if mesh.faces.len() != faces || mesh.region.len() != cells || mesh.on_feature.len() != faces {
        return Some("its arrays differ in length".into());
    }
    if mesh.nodes.as_flattened().iter().any(|c| !c.is_finite()) {
        return Some("a node is not finite".into());
    }
    let mut used = vec![false; nodes];
    for f in 0..faces {
        let ring = mesh.faces.get(f);
        if ring.iter().any(|&n| n as usize >= nodes) {
            return Some(format!("face {f} names a node that does not exist"));
        }
        if ring.len() < D || (1..ring.len()).any(|i| ring[..i].contains(&ring[i])) {
            return Some(format!("face {f} has the nodes {ring:?}"));
        }
        ring.iter().for_each(|&n| used[n as usize] = true);
        let [a, b] = mesh.face_cells[f];
        let known = b >= SIDE_0 && (b - SIDE_0 < 2 * D as u32 || b == NO_CELL);
        if a as usize >= cells || !(known || (a < b && (b as usize) < cells)) {
            return Some(format!("face {f} lies between the cells {a} and {b}"));
        }
    }
    let unused = used.iter().filter(|u| !**u).count();
    (unused > 0).then(|| format!("{unused} nodes belong to no face"))
}

/// Whether every edge of a cell is met by two of its faces, in opposite directions (in 2-D: every
/// node by the end of one edge and the start of another).
fn closed<const D: usize>(mesh: &PolyMesh<D>, cell: usize, faces: &[u32]) -> bool {
    let mut edges: Vec<([u32; 2], i32)> = Vec::with_capacity(6 * faces.len());
    for &f in faces {
        let ring = mesh.faces.get(f as usize);
        let own = mesh.face_cells[f as usize][0] as usize == cell;
        let sign = if own { 1 } else { -1 };
        if D == 2 {
            edges.push(([ring[0]; 2], sign));
            edges.push(([ring[1]; 2], -sign));
            continue;
        }
        for i in 0..ring.len() {
            let (p, q) = (ring[i], ring[(i + 1) % ring.len()]);
            edges.push(([p.min(q), p.max(q)], if p < q { sign } else { -sign }));
        }
    }
    edges.sort_unstable();
    let pairs = edges.chunk_by(|a, b| a.0 == b.0);
    faces.len() > D
        && pairs
            .into_iter()
            .all(|e| e.len() == 2 && e[0].1 + e[1].1 == 0)
}

/// Whether a cell's site is on the inner side of all its faces that have an area.
fn holds_site<const D: usize>(
    mesh: &PolyMesh<D>,
    cell: usize,
    faces: &[u32],
    in_columns: bool,
) -> bool {
    faces.iter().all(|&f| {
        let shape = mesh.face_shape(f as usize);
        let site = mesh.sites[cell];
        // What is above or below the site in a column counts there, as the face is bent.
        let on = (in_columns && !mesh.is_upright(f as usize)).then(|| mesh.under(f as usize, site));
        let on = on.flatten().unwrap_or(shape.apex);
        let out: [f64; D] = std::array::from_fn(|k| on[k] - site[k]);
        let own = mesh.face_cells[f as usize][0] as usize == cell;
        let height = dot(out, shape.area_vector) * if own { 1.0 } else { -1.0 };
        // Faces this small (and narrow ones among them) have a normal that is mere rounding.
        let distance = dot(out, out).sqrt();
        shape.area() < (1e-4 * distance).powi(D as i32 - 1)
            || height >= -1e-12 * distance * shape.area()
    })
}

/// How far off a face's plane welding may have put its nodes: each of two by the share of its distance
/// to the site.
fn welded<const D: usize>(mesh: &PolyMesh<D>, f: usize, weld: f64) -> f64 {
    let site = mesh.sites[mesh.face_cells[f][0] as usize];
    let square = |&n: &u32| -> f64 {
        let node = mesh.nodes[n as usize];
        (0..D).map(|k| (node[k] - site[k]).powi(2)).sum()
    };
    2.0 * weld
        * mesh
            .faces
            .get(f)
            .iter()
            .map(square)
            .fold(0.0, f64::max)
            .sqrt()
}

/// An area vector this small a share of a face's length times its width has cancelled: the face's
/// outline crosses itself, as an eight does, and no plane is the face's own.
const CANCELLED: f64 = 1e-9;

/// The largest distance of a face's nodes from a plane: that of its area, or, as the normal of a face
/// as narrow as rounding means nothing, one through its long axis if that is nearer. A face whose area
/// cancels is as far from flat as it is wide.
fn warp<const D: usize>(mesh: &PolyMesh<D>, f: usize) -> f64 {
    let shape = mesh.face_shape(f);
    let area = shape.area();
    let nodes = mesh.faces.get(f).iter();
    let off = nodes.map(|&n| -> [f64; D] {
        std::array::from_fn(|k| mesh.nodes[n as usize][k] - shape.apex[k])
    });
    let square = |x: &[f64; D]| dot(*x, *x);
    let longest = off
        .clone()
        .max_by(|x, y| square(x).total_cmp(&square(y)))
        .unwrap_or([0.0; D]);
    // Nodes all at one place are flat.
    if square(&longest) == 0.0 {
        return 0.0;
    }
    let (mut height, mut width) = (0.0f64, 0.0f64);
    for x in off {
        let along = dot(x, longest) / square(&longest);
        let aside: [f64; D] = std::array::from_fn(|k| x[k] - along * longest[k]);
        height = height.max((dot(x, shape.area_vector) / area).abs());
        width = width.max(square(&aside).sqrt());
    }
    // Also where the area is 0, and no height is known.
    if area <= CANCELLED * square(&longest).sqrt() * width {
        return width;
    }
    height.min(width)
}

/// The boundary: every outer face in its side of the box, every side covered once.
fn sides<const D: usize>(
    mesh: &PolyMesh<D>,
    [low, high]: [[f64; D]; 2],
    longest: f64,
    tolerance: f64,
    in_columns: bool,
    found: &mut PolyCheck,
) {
    let mut areas = vec![0.0; 2 * D];
    for f in mesh.inner_faces()..mesh.face_cells.len() {
        let Beyond::Side(side) = mesh.beyond(f) else {
            found.problems.push(format!(
                "face {f} has one cell and lies in no side of the box"
            ));
            return;
        };
        let (axis, upper) = (side / 2, side % 2 == 1);
        let plane = if upper { high[axis] } else { low[axis] };
        let bent = in_columns && axis == 2;
        for &n in mesh.faces.get(f).iter().filter(|_| !bent) {
            let off = (mesh.nodes[n as usize][axis] - plane).abs() / longest;
            found.flatness_error = found.flatness_error.max(off);
        }
        let area = mesh.face_shape(f).area_vector[axis];
        areas[side] += if upper { area } else { -area };
    }
    if found.flatness_error > tolerance {
        found.problems.push(format!(
            "faces are off their sides of the box by {:.1e} of it",
            found.flatness_error
        ));
    }
    let whole = areas.iter().enumerate();
    for (side, got) in whole.filter(|(side, _)| !in_columns || side / 2 == 2) {
        let others = (0..D).filter(|&k| k != side / 2);
        let want: f64 = others.map(|k| high[k] - low[k]).product();
        found.area_error = found.area_error.max((got - want).abs() / want);
    }
    if found.area_error > tolerance {
        found.problems.push(format!(
            "a side of the box is covered with a relative area error of {:.1e}",
            found.area_error
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::super::poly::samples::two_cells;
    use super::*;

    fn faults<const D: usize>() {
        let check = |change: &dyn Fn(&mut PolyMesh<D>)| {
            let mut mesh = two_cells::<D>(0.75);
            change(&mut mesh);
            let mut high = [1.0; D];
            high[0] = 2.0;
            check_poly(&mesh, [0.0; D], high, 1e-12)
        };
        let good = check(&|_| ());
        assert!(good.passed(), "{good:?}");
        assert_eq!((good.cells, good.volume_error), (2, 0.0));
        let last = 1 << D;
        for (change, want) in [
            (
                (&|m: &mut PolyMesh<D>| m.nodes[last][0] = 2.5) as &dyn Fn(&mut PolyMesh<D>),
                "fill",
            ),
            (&|m| m.nodes[last][0] = f64::NAN, "not finite"),
            (&|m| m.nodes.push([0.0; D]), "1 nodes belong to no face"),
            (&|m| m.faces.items[0] = 99, "face 0 names a node"),
            (
                &|m| m.faces.items[0] = m.faces.items[1],
                "face 0 has the nodes",
            ),
            (&|m| m.face_cells[0] = [1, 0], "between the cells 1 and 0"),
            (&|m| m.sites[0][0] = 1.0, "1 cells do not hold their site"),
            (&|m| m.region.clear(), "differ in length"),
            (
                &|m| {
                    m.face_cells.pop();
                    m.on_feature.pop();
                    let end = m.faces.offsets.len() - 2;
                    m.faces.items.truncate(m.faces.offsets[end] as usize);
                    m.faces.offsets.pop();
                },
                "1 cells are not closed, the first is 1",
            ),
            (&|m| m.face_cells[1][1] = NO_CELL, "lies in no side"),
            (&|m| m.sites.swap(0, 1), "hold their site"),
            (
                &|m| m.nodes.iter_mut().for_each(|p| p[0] = -p[0]),
                "2 cells are flat or inverted",
            ),
        ] {
            let found = check(change);
            let said = found.problems.join("\n");
            assert!(said.contains(want), "{want}: {said:?}");
        }
    }

    #[test]
    fn each_fault_is_found() {
        faults::<2>();
        faults::<3>();
    }

    #[test]
    fn narrow_faces_are_as_flat_as_they_are_narrow() {
        // A face of length 1 and width 1e-11, oblique: its area vector is mostly rounding.
        let along = [0.48, 0.6, 0.64];
        let aside = [0.8e-11, -0.64e-11, 0.0];
        let place = |u: f64, v: f64| std::array::from_fn(|k| 0.3 + u * along[k] + v * aside[k]);
        let mut mesh = PolyMesh::<3> {
            nodes: vec![
                place(0.0, 0.0),
                place(1.0, 0.2),
                place(0.7, 1.0),
                place(0.2, 0.9),
            ],
            ..PolyMesh::default()
        };
        mesh.faces.push([0, 1, 2, 3]);
        assert!(warp(&mesh, 0) < 2e-11, "{}", warp(&mesh, 0));
        // As wide as long, it is what its plane says.
        mesh.nodes[2][2] += 0.5;
        mesh.nodes[3][0] -= 0.3;
        assert!(warp(&mesh, 0) > 0.01);
    }

    #[test]
    fn a_face_like_an_eight_is_not_flat() {
        let eight = |bend: f64| {
            let mut mesh = PolyMesh::<3> {
                nodes: vec![
                    [0.0, 0.0, 0.0],
                    [1.0, 1.0, bend],
                    [1.0, 0.0, 0.0],
                    [0.0, 1.0, 0.0],
                ],
                ..PolyMesh::default()
            };
            mesh.faces.push([0, 1, 2, 3]);
            mesh
        };
        assert_eq!(eight(0.0).face_shape(0).area(), 0.0);
        for bend in [0.0, 1e-15, 0.1] {
            let warp = warp(&eight(bend), 0);
            assert!(warp > 0.4, "{bend}: {warp}");
        }
        // All nodes at one place, or in one line: no area, and nothing that is not flat.
        let mut none = eight(0.0);
        none.nodes.fill([0.3; 3]);
        assert_eq!(warp(&none, 0), 0.0);
        none.nodes = vec![[0.0; 3], [0.5; 3], [1.0; 3], [0.25; 3]];
        assert!(warp(&none, 0) < 1e-15);
    }

    #[test]
    fn warped_faces_are_found() {
        let mut mesh = two_cells::<3>(0.75);
        // A corner of the cut moves along x: the cut is no longer flat.
        mesh.nodes[5][0] += 0.04;
        let found = check_poly(&mesh, [0.0; 3], [2.0, 1.0, 1.0], 1e-12);
        assert!((0.004..0.02).contains(&found.warp), "{}", found.warp);
        assert_eq!((found.not_closed, found.volume_error), (0, 0.0));
        assert!(!found.passed());
    }
}
