//! The one public checker: is this mesh valid, and does it fill its box exactly?

use super::complex::{NONE, neighbors};
use super::{FACES, TetMesh, cross, norm, sub, volume6};
use serde::Serialize;

/// What [`check`] found. A mesh that is right has `problems` empty.
#[derive(Debug, Clone, Serialize, PartialEq, Default)]
pub struct Check {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of tetrahedra.
    pub tets: usize,
    /// Tetrahedra of zero or negative volume.
    pub not_positive: usize,
    /// Nodes that no tetrahedron uses.
    pub unused_nodes: usize,
    /// Faces on the boundary.
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
pub fn check(mesh: &TetMesh, low: [f64; 3], high: [f64; 3], tolerance: f64) -> Check {
    let mut found = Check {
        nodes: mesh.nodes.len(),
        tets: mesh.tets.len(),
        ..Check::default()
    };
    if let Some(t) = mesh
        .tets
        .iter()
        .position(|t| t.iter().any(|&i| i as usize >= mesh.nodes.len()))
    {
        found
            .problems
            .push(format!("tetrahedron {t} names a node that does not exist"));
        return found;
    }
    if mesh.nodes.iter().flatten().any(|c| !c.is_finite()) {
        found.problems.push("a node is not finite".into());
        return found;
    }

    let mut volume = 0.0;
    let mut used = vec![false; mesh.nodes.len()];
    let mut worst = None;
    for t in 0..mesh.tets.len() {
        let v = volume6(&mesh.corners(t));
        volume += v / 6.0;
        if v <= 0.0 {
            found.not_positive += 1;
            worst.get_or_insert(t);
        }
        for &i in &mesh.tets[t] {
            used[i as usize] = true;
        }
    }
    if let Some(t) = worst {
        found.problems.push(format!(
            "{} tetrahedra are flat or inverted, the first is {t}",
            found.not_positive
        ));
    }
    found.unused_nodes = used.iter().filter(|u| !**u).count();
    if found.unused_nodes > 0 {
        found.problems.push(format!(
            "{} nodes belong to no tetrahedron",
            found.unused_nodes
        ));
    }

    let extent = sub(high, low);
    let longest = extent.iter().copied().fold(0.0, f64::max);
    let box_volume = extent.iter().product::<f64>();
    found.volume_error = ((volume - box_volume) / box_volume).abs();
    if found.volume_error > tolerance || found.volume_error.is_nan() {
        found.problems.push(format!(
            "the tetrahedra fill {volume} instead of the box's {box_volume}"
        ));
    }

    match neighbors(mesh.nodes.len(), &mesh.tets) {
        Err(face) => found
            .problems
            .push(format!("face {face:?} belongs to more than two tetrahedra")),
        Ok(neighbors) => sides(mesh, &neighbors, low, high, longest, tolerance, &mut found),
    }
    found
}

/// The boundary: every outer face in one side of the box, every side covered once.
fn sides(
    mesh: &TetMesh,
    neighbors: &[[u32; 4]],
    low: [f64; 3],
    high: [f64; 3],
    longest: f64,
    tolerance: f64,
    found: &mut Check,
) {
    let extent = sub(high, low);
    let mut area = [0.0; 6];
    for (t, around) in neighbors.iter().enumerate() {
        for k in 0..4 {
            if around[k] != NONE {
                continue;
            }
            found.boundary_faces += 1;
            let p = FACES[k].map(|i| mesh.nodes[mesh.tets[t][i] as usize]);
            // The side whose plane the face keeps closest to.
            let (side, off) = (0..6)
                .map(|s| {
                    let plane = if s % 2 == 0 { low[s / 2] } else { high[s / 2] };
                    let off = p
                        .iter()
                        .map(|q| (q[s / 2] - plane).abs())
                        .fold(0.0, f64::max);
                    (s, off)
                })
                .fold(
                    (0, f64::INFINITY),
                    |best, x| if x.1 < best.1 { x } else { best },
                );
            found.flatness_error = found.flatness_error.max(off / longest);
            if off > tolerance * longest {
                found.faces_off_sides += 1;
            }
            area[side] += 0.5 * norm(cross(sub(p[1], p[0]), sub(p[2], p[0])));
        }
    }
    if found.faces_off_sides > 0 {
        found.problems.push(format!(
            "{} boundary faces are off the box's sides: the mesh has holes or bumps",
            found.faces_off_sides
        ));
    }
    for (side, got) in area.iter().enumerate() {
        let k = side / 2;
        let want = extent[(k + 1) % 3] * extent[(k + 2) % 3];
        found.area_error = found.area_error.max((got - want).abs() / want);
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
