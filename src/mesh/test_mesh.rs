//! A mesh for tests: a box of cubes, each cut into the six tetrahedra about its diagonal.

use super::TetMesh;

/// `cubes` cubes along each axis, each of side `size`, from the origin (Kuhn's subdivision, which
/// conforms from cube to cube).
pub(crate) fn kuhn_box(cubes: [usize; 3], size: f64) -> TetMesh {
    let n = cubes.map(|c| c + 1);
    let node = |x: usize, y: usize, z: usize| ((z * n[1] + y) * n[0] + x) as u32;
    let mut mesh = TetMesh::default();
    for z in 0..n[2] {
        for y in 0..n[1] {
            for x in 0..n[0] {
                mesh.nodes.push([x, y, z].map(|c| size * c as f64));
            }
        }
    }
    // Each order of the axes is a path of edges from the near corner to the far one.
    const PATHS: [([usize; 3], bool); 6] = [
        ([0, 1, 2], true),
        ([1, 2, 0], true),
        ([2, 0, 1], true),
        ([0, 2, 1], false),
        ([2, 1, 0], false),
        ([1, 0, 2], false),
    ];
    for z in 0..cubes[2] {
        for y in 0..cubes[1] {
            for x in 0..cubes[0] {
                for (path, even) in PATHS {
                    let mut at = [x, y, z];
                    let mut tet = [node(x, y, z); 4];
                    for (k, axis) in path.into_iter().enumerate() {
                        at[axis] += 1;
                        tet[k + 1] = node(at[0], at[1], at[2]);
                    }
                    if !even {
                        tet.swap(2, 3);
                    }
                    mesh.tets.push(tet);
                }
            }
        }
    }
    mesh
}
