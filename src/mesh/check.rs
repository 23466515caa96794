//! The one public checker: is this mesh valid, and does it fill its box exactly?

use super::Simplices;
use super::complex::NONE;
use serde::Serialize;

/// What [`check`] found. A mesh that is right has `problems` empty.
#[derive(Debug, Clone, Serialize, PartialEq, Default)]
pub struct Check {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of cells: tetrahedra, or triangles in the plane.
    pub cells: usize,
    /// Cells of zero or negative volume.
    pub not_positive: usize,
    /// Nodes that no cell uses.
    pub unused_nodes: usize,
    /// Faces on the boundary (edges, in the plane).
    pub boundary_faces: usize,
    /// Boundary faces that do not lie in a side of the box.
    pub faces_off_sides: usize,
    /// |sum of volumes - volume of the box| / volume of the box.
    pub volume_error: f64,
    /// Largest distance of a boundary node from the side of its face, over the box's longest side.
    pub flatness_error: f64,
    /// Largest relative error of a side's area, summed over its faces.
    pub area_error: f64,
    /// Each fault in one line.
    pub problems: Vec<String>,
}

impl Check {
    /// Whether nothing is wrong.
    pub fn passed(&self) -> bool {
        self.problems.is_empty()
    }
}

/// Checks a mesh against the box `[low, high]`: positive volumes, conforming faces, no unused nodes,
/// sides exactly flat (to `tolerance` of the longest side), areas and volume filled to `tolerance`.
/// In the plane the same with areas for volumes and lengths for areas.
pub fn check<const D: usize, M: Simplices<D>>(
    mesh: &M,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
) -> Check {
    check_joined(mesh, None, low, high, tolerance)
}

/// [`check`] of a mesh whose neighbours are known: for every cell and face, in order, the cell on its
/// other side, or `NONE`. Whether they are right is checked, which takes less time than to find them.
pub fn check_joined<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: Option<&[u32]>,
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
) -> Check {
    let nodes = mesh.nodes();
    let mut found = Check {
        nodes: nodes.len(),
        cells: mesh.len(),
        ..Check::default()
    };
    let name = M::CELLS;
    if let Some(at) = mesh
        .connectivity()
        .iter()
        .position(|&i| i as usize >= nodes.len())
    {
        found.problems.push(format!(
            "{} {}: it names a node that does not exist",
            singular(name),
            at / (D + 1)
        ));
        return found;
    }
    if nodes.iter().flatten().any(|c| !c.is_finite()) {
        found.problems.push("a node is not finite".into());
        return found;
    }

    let mut volume = 0.0;
    let mut worst = None;
    for c in 0..mesh.len() {
        let v = mesh.volume(c);
        volume += v;
        if v <= 0.0 {
            found.not_positive += 1;
            worst.get_or_insert(c);
        }
    }
    if let Some(c) = worst {
        found.problems.push(format!(
            "{} {name} are flat or inverted, the first is {c}",
            found.not_positive
        ));
    }
    let mut used = vec![false; nodes.len()];
    for &i in mesh.connectivity() {
        used[i as usize] = true;
    }
    found.unused_nodes = used.iter().filter(|u| !**u).count();
    if found.unused_nodes > 0 {
        found.problems.push(format!(
            "{} nodes belong to no {}",
            found.unused_nodes,
            singular(name)
        ));
    }

    let extent: [f64; D] = std::array::from_fn(|k| high[k] - low[k]);
    let box_volume = extent.iter().product::<f64>();
    found.volume_error = ((volume - box_volume) / box_volume).abs();
    if found.volume_error > tolerance || found.volume_error.is_nan() {
        found.problems.push(format!(
            "the {name} fill {volume} instead of the box's {box_volume}"
        ));
    }

    if let Some(neighbors) = neighbors {
        match first_apart(mesh, neighbors) {
            Some(cell) => found.problems.push(format!(
                "{} {cell}: it and its neighbours do not fit",
                singular(name)
            )),
            None => sides(mesh, neighbors, low, high, tolerance, &mut found),
        }
        return found;
    }
    match mesh.neighbors() {
        Err(face) => found
            .problems
            .push(format!("face {face:?} belongs to more than two {name}")),
        Ok(neighbors) => sides(mesh, &neighbors, low, high, tolerance, &mut found),
    }
    found
}

/// The first cell that has not each of its faces but outer ones in common with the neighbour there,
/// and with that alone.
fn first_apart<const D: usize, M: Simplices<D>>(mesh: &M, neighbors: &[u32]) -> Option<usize> {
    let faces = D + 1;
    if neighbors.len() != faces * mesh.len() {
        return Some(0);
    }
    // A face seen from the cell of the lower number pairs with one seen from the higher: none of these
    // may be left over.
    let mut unpaired = 0isize;
    for c in 0..mesh.len() {
        let cell = mesh.cell(c);
        for (k, &n) in neighbors[faces * c..faces * (c + 1)].iter().enumerate() {
            let n = n as usize;
            if n == NONE as usize {
                continue;
            }
            if n >= mesh.len() || n == c {
                return Some(c);
            }
            if n < c {
                unpaired -= 1;
                continue;
            }
            unpaired += 1;
            let (other, back) = (mesh.cell(n), &neighbors[faces * n..faces * (n + 1)]);
            let mut pairs = 0;
            let mut shared = 0;
            for (&node, &cell_beyond) in other.iter().zip(back) {
                // The node opposite the face that they share is not in it.
                let is_apex = cell_beyond as usize == c;
                pairs += usize::from(is_apex);
                for (i, &own) in cell.iter().enumerate() {
                    shared += usize::from((own == node) & (i != k) & !is_apex);
                }
            }
            // Nodes of a cell differ, so that many in common are the face.
            if (pairs, shared) != (1, D) {
                return Some(c);
            }
        }
    }
    (unpaired != 0).then_some(0)
}

fn singular(name: &str) -> &str {
    match name {
        "tetrahedra" => "tetrahedron",
        name => name.trim_end_matches('s'),
    }
}

/// The boundary: every outer face in one side of the box, every side covered once.
fn sides<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: &[u32],
    low: [f64; D],
    high: [f64; D],
    tolerance: f64,
    found: &mut Check,
) {
    let extent: [f64; D] = std::array::from_fn(|k| high[k] - low[k]);
    let longest = extent.iter().copied().fold(0.0, f64::max);
    // Of the low and the high side of each axis.
    let mut area = [[0.0; 2]; D];
    for (i, _) in neighbors.iter().enumerate().filter(|(_, n)| **n == NONE) {
        found.boundary_faces += 1;
        let face = mesh.face(i / (D + 1), i % (D + 1));
        let p = face.map(|n| mesh.nodes()[n as usize]);
        // The side whose plane the face keeps closest to.
        let mut best = (0, 0, f64::INFINITY);
        for k in 0..D {
            for (end, plane) in [low[k], high[k]].into_iter().enumerate() {
                let off = p.iter().map(|q| (q[k] - plane).abs()).fold(0.0, f64::max);
                if off < best.2 {
                    best = (k, end, off);
                }
            }
        }
        let (k, end, off) = best;
        found.flatness_error = found.flatness_error.max(off / longest);
        if off > tolerance * longest {
            found.faces_off_sides += 1;
        }
        area[k][end] += M::face_area(&p);
    }
    if found.faces_off_sides > 0 {
        found.problems.push(format!(
            "{} boundary faces are off the box's sides: the mesh has holes or bumps",
            found.faces_off_sides
        ));
    }
    for k in 0..D {
        let want: f64 = (0..D).filter(|&j| j != k).map(|j| extent[j]).product();
        for got in area[k] {
            found.area_error = found.area_error.max((got - want).abs() / want);
        }
    }
    if found.area_error > tolerance.max(1e-9) {
        found.problems.push(format!(
            "a side of the box is covered with a relative area error of {:.2e}",
            found.area_error
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::volume6;
    use crate::mesh::TetMesh;

    /// The unit cube as six tetrahedra about its diagonal (Kuhn).
    fn cube() -> TetMesh {
        let nodes: Vec<[f64; 3]> = (0..8)
            .map(|i| [f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)])
            .collect();
        let paths = [[1, 3], [1, 5], [2, 3], [2, 6], [4, 5], [4, 6]];
        let tets = paths
            .iter()
            .map(|&[a, b]| {
                let tet = [0, a, b, 7];
                let p = tet.map(|i: u32| nodes[i as usize]);
                if volume6(&p) > 0.0 { tet } else { [0, b, a, 7] }
            })
            .collect();
        TetMesh { nodes, tets }
    }

    #[test]
    fn a_right_mesh_passes() {
        let found = check(&cube(), [0.0; 3], [1.0; 3], 1e-12);
        assert!(found.passed(), "{:?}", found.problems);
        assert_eq!(found.boundary_faces, 12);
    }

    #[test]
    fn known_neighbours_are_checked() {
        let mesh = cube();
        let right = Simplices::neighbors(&mesh).unwrap();
        let found = |neighbors: &[u32]| {
            check_joined(&mesh, Some(neighbors), [0.0; 3], [1.0; 3], 1e-12).problems
        };
        assert_eq!(
            check_joined(&mesh, Some(&right), [0.0; 3], [1.0; 3], 1e-12),
            check(&mesh, [0.0; 3], [1.0; 3], 1e-12)
        );
        for i in 0..right.len() {
            for other in [0, 1, 2, 3, 4, 5, 6, NONE] {
                let mut wrong = right.clone();
                wrong[i] = other;
                assert_eq!(found(&wrong).is_empty(), wrong == right, "{i} {other}");
            }
        }
        assert!(!found(&right[1..]).is_empty());
    }

    #[test]
    fn each_fault_is_found() {
        let fault = |change: &dyn Fn(&mut TetMesh)| {
            let mut mesh = cube();
            change(&mut mesh);
            check(&mesh, [0.0; 3], [1.0; 3], 1e-12)
        };
        assert_eq!(fault(&|m| m.tets[0].swap(0, 1)).not_positive, 1);
        assert_eq!(fault(&|m| m.nodes.push([0.5; 3])).unused_nodes, 1);
        assert!(fault(&|m| m.tets.truncate(5)).faces_off_sides > 0);
        assert!(fault(&|m| m.nodes[7][0] = 1.1).flatness_error > 0.05);
        assert!(!fault(&|m| m.tets[0][1] = 99).passed());
        assert!(
            !fault(&|m| {
                let t = m.tets[0];
                m.tets.push(t);
                m.tets.push(t)
            })
            .passed()
        );
        assert!(!fault(&|m| m.nodes[3][1] = f64::NAN).passed());
    }
}
