//! Helpers for the tests of surfaces: sheets of facets, and boxes of cells.
//!
//! - `grouping`: facets into surfaces, and their measures
//! - `painting`: the cells between surfaces: blocks, paint, enclosing facets
//! - `meshed`: surfaces in meshes of images

mod grouping;
mod meshed;
mod painting;

use super::adjacency::{CellAdjacency, enclosing_facets, find_cell};
use super::measure::MapAxes;
use super::*;
use crate::geometry;
use crate::geometry::grid_index::index_at;
use crate::geometry::{dot, norm, normal};
use crate::mesh::Mesh;
use crate::mesh::Simplices;
use crate::mesh::boxes::jittered_box;
use crate::mesh::poly::PolyMesh;
use crate::mesh::voronoi::voronoi_plane;
use crate::mesh::{TetMesh, TriMesh};
use crate::model::geodesics::{GeodesicSource, Geodesics};
use crate::model::paint::{blocks, clearance, contrast_factors, grow};

/// Returns a pseudo-random number in [0, 1).
fn random(seed: &mut u64) -> f64 {
    *seed = seed
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1u64 << 53) as f64
}

/// Adds a sheet of `n` by `m` squares, each cut in two. Node (i, j) is at `at(i, j)`; nodes at
/// existing positions are shared.
fn add_sheet(
    nodes: &mut Vec<[f64; 3]>,
    facets: &mut Vec<[u32; 3]>,
    [n, m]: [usize; 2],
    position: impl Fn(f64, f64) -> [f64; 3],
) {
    let mut node_index = |i: usize, j: usize| {
        let x = position(i as f64, j as f64);
        let known = nodes.iter().position(|y| norm(geometry::sub(x, *y)) < 1e-9);
        known.unwrap_or_else(|| {
            nodes.push(x);
            nodes.len() - 1
        }) as u32
    };
    for i in 0..n {
        for j in 0..m {
            let [a, b, c, d] =
                [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|(i, j)| node_index(i, j));
            facets.extend([[a, b, d], [a, d, c]]);
        }
    }
}

/// Returns two sheets with the areas 100 and 80 that cross along z at an angle of `degrees`.
fn crossing_sheets(degrees: f64) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    let (sin, cos) = degrees.to_radians().sin_cos();
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i - 5.0, 0.0, j]);
    add_sheet(&mut nodes, &mut facets, [8, 10], |i, j| {
        [(i - 4.0) * cos, (i - 4.0) * sin, j]
    });
    (nodes, facets)
}

fn areas<const D: usize>(surfaces: &Surfaces<D>, nodes: &[[f64; D]]) -> Vec<f64> {
    let up = MapAxes::from_axis(D - 1, true);
    measure(surfaces, nodes, &up, &[])
        .iter()
        .map(|m| m.area)
        .collect()
}

/// Returns a box of `dims` unit cubes, each of six tetrahedra around its diagonal (in 2-D squares,
/// each of two triangles).
fn cubes<const D: usize, M: Simplices<D>>(dims: [usize; D]) -> M {
    jittered_box(dims, dims.map(|n| n as f64), 0.0, |_| false)
}

/// Returns the facets in the plane where the coordinate `axis` is `coordinate`, except those for
/// whose centroid `is_omitted` is `true`.
fn plane_facets<const D: usize, F: Mesh<D>>(
    mesh: &F,
    axis: usize,
    coordinate: f64,
    is_omitted: impl Fn([f64; D]) -> bool + Sync,
) -> Vec<[u32; D]> {
    facet_selection::facets_where(mesh, |_, facet| {
        let x = facet.map(|n| mesh.nodes()[n as usize]);
        let centroid = std::array::from_fn(|k| x.iter().map(|x| x[k]).sum::<f64>() / D as f64);
        x.iter().all(|p| p[axis] == coordinate) && !is_omitted(centroid)
    })
}

/// Returns the cells of a mesh, separated by closed facets.
fn cells<const D: usize, F: Mesh<D>>(mesh: &F, closed: &[[u32; D]]) -> CellAdjacency<D> {
    CellAdjacency::new(mesh, &mesh.cells_of_faces().unwrap(), closed)
}

/// Returns the cell that contains a point.
fn cell_at<const D: usize, F: Mesh<D>>(mesh: &F, x: [f64; D]) -> u32 {
    find_cell(mesh, &mesh.cells_of_faces().unwrap(), x).unwrap()
}

/// Returns sites whose Voronoi cells are unit cubes (squares in 2-D).
fn cube_sites<const D: usize>(dims: [usize; D]) -> Vec<[f64; D]> {
    let middle = |i: usize| index_at(dims, i).map(|c| c as f64 + 0.5);
    (0..dims.iter().product()).map(middle).collect()
}

fn squares(dims: [usize; 2]) -> PolyMesh<2> {
    voronoi_plane(&cube_sites(dims), dims.map(|n| n as f64)).unwrap()
}

fn boxes(dims: [usize; 3]) -> PolyMesh<3> {
    crate::mesh::voronoi::voronoi(&cube_sites(dims), dims.map(|n| n as f64)).unwrap()
}

#[test]
fn removed_surfaces_leave_the_names_and_facets_of_the_others() {
    let mut surfaces = Surfaces::<2> {
        facets: vec![[0, 1], [1, 2], [2, 3], [3, 4], [4, 5]],
        start: vec![0, 2, 3, 4, 5],
        names: ["a", "b", "c"].map(String::from).to_vec(),
        interfaces: 1..3,
        ..Surfaces::default()
    };
    surfaces.remove(&[true, false, true, false]);
    assert_eq!(surfaces.facets, [[2, 3], [4, 5]]);
    assert_eq!(surfaces.start, [0, 1, 2]);
    assert_eq!(surfaces.names, ["b"]);
    assert_eq!(surfaces.interfaces, 0..1);
}
