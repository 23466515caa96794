use super::*;
use crate::mesh::poly::Beyond;

/// A small generator of uniform numbers in [0, 1); the tests need no quality.
pub(super) fn uniform(state: &mut u64) -> f64 {
    *state = state
        .wrapping_mul(6364136223846793005)
        .wrapping_add(1442695040888963407);
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

fn random(n: usize, extent: [f64; 3], seed: u64) -> Vec<[f64; 3]> {
    let mut state = seed;
    (0..n)
        .map(|_| extent.map(|e| e * (0.001 + 0.998 * uniform(&mut state))))
        .collect()
}

#[test]
fn one_atom_has_the_box() {
    let mesh = voronoi(&[[1.0, 0.5, 2.0]], [3.0, 2.0, 4.0]).unwrap();
    assert_eq!((mesh.nodes.len(), mesh.face_cells.len()), (8, 6));
    assert_eq!(mesh.cell_shapes()[0].0, 24.0);
}

#[test]
fn random_atoms() {
    for n in [2, 3, 5, 20, 1000] {
        let extent = [7.0, 11.0, 13.3];
        let mesh = voronoi(&random(n, extent, n as u64), extent).unwrap();
        let sum: f64 = mesh.cell_shapes().iter().map(|s| s.0).sum();
        assert!(
            (sum / (7.0 * 11.0 * 13.3) - 1.0).abs() < 1e-13,
            "{n}: {sum}"
        );
        for f in 0..mesh.face_cells.len() {
            if let Beyond::Side(side) = mesh.beyond(f) {
                let plane = if side % 2 == 0 { 0.0 } else { extent[side / 2] };
                for &n in mesh.faces.get(f) {
                    assert_eq!(mesh.nodes[n as usize][side / 2], plane);
                }
            }
        }
    }
}
