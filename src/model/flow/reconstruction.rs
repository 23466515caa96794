//! Flow inside polyhedra and polygons: each cut into tetrahedra or triangles round its site, with the
//! rates through the faces between them that go with those through the cell's own faces.
//!
//! Two-point fluxes say what passes the faces of a cell but not how it passes the cell, which
//! streamlines ask for. Of all rates inside that conserve fluid (sources are spread evenly over their
//! cell), these are the nearest to a constant velocity: its fluxes, and a correction that is the
//! gradient of a potential on the parts of the cell (as Prevost, Edwards & Blunt 2002 and Hægland et
//! al. 2007 cut cells). Where the velocity is constant it is exact.

use crate::parallel::prelude::*;

use super::cells::CellRates;
use super::face_rates::FaceRates;
use super::shape_functions::{area_vector, gradients};
use crate::geometry::dot;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;

/// Cells whose parts are put together at a time.
const CHUNK_CELLS: usize = 1 << 14;

/// Cells of a mesh in parts.
#[derive(Debug, Clone)]
pub struct CellReconstruction<const D: usize, M> {
    /// The parts, cell by cell: each has the cell's site, and a piece of one of its faces opposite.
    pub mesh: M,
    /// Rates through the faces of the parts.
    pub rates: FaceRates<D>,
    /// Where the parts of each cell begin, and where the last one's end.
    pub cell_start: Vec<u32>,
}

/// The parts of one cell.
#[derive(Default)]
struct CellParts {
    /// D + 1 nodes each, the site first.
    corners: Vec<u32>,
    /// Rates out through their faces.
    outflow: Vec<f64>,
    /// What is beyond.
    neighbors: Vec<u32>,
}

impl<const D: usize, M: Simplices<D>> CellReconstruction<D, M> {
    /// The parts of all cells of a mesh, with its graph, the rates through its faces, and the velocity
    /// of each cell.
    pub fn new(
        mesh: &PolyMesh<D>,
        graph: &Graph<D>,
        rates: &CellRates,
        velocity: &[[f64; D]],
    ) -> Self {
        let pieces = |f: u32| mesh.faces.get(f as usize).len() + 1 - D;
        let faces = mesh.faces_of_cells();
        // Parts are numbered cell by cell; each face knows the first of its parts on either side.
        let mut cell_start = Vec::with_capacity(mesh.sites.len() + 1);
        let mut of_face = vec![[NONE; 2]; mesh.face_cells.len()];
        let mut parts = 0;
        for cell in 0..mesh.sites.len() {
            cell_start.push(parts);
            for &f in faces.get(cell) {
                let own = mesh.face_cells[f as usize][0] as usize == cell;
                of_face[f as usize][usize::from(!own)] = parts;
                parts += pieces(f) as u32;
            }
        }
        cell_start.push(parts);
        let mut rate = vec![0.0; mesh.face_cells.len()];
        for (c, r) in graph.connections.iter().zip(&rates.connections) {
            rate[c.face as usize] = *r;
        }
        for (f, r) in graph.boundary.iter().zip(&rates.boundary) {
            rate[f.face as usize] = *r;
        }
        let mut nodes = mesh.nodes.clone();
        nodes.extend_from_slice(&mesh.sites);
        let site = |cell: usize| (mesh.nodes.len() + cell) as u32;
        let cut = |cell: usize| {
            let mut all = CellParts::default();
            for &f in faces.get(cell) {
                let ring = mesh.faces.get(f as usize);
                let shape = mesh.face_shape(f as usize);
                let own = mesh.face_cells[f as usize][0] as usize == cell;
                let sign = if own { 1.0 } else { -1.0 };
                let across = of_face[f as usize][usize::from(own)];
                for piece in 0..pieces(f) {
                    let mut outer: [u32; D] =
                        std::array::from_fn(|i| ring[if i == 0 { 0 } else { piece + i }]);
                    let share = face_area_share(mesh, &outer, &shape.area_vector);
                    if !own {
                        outer.swap(D - 2, D - 1);
                    }
                    all.corners.push(site(cell));
                    all.corners.extend(outer);
                    all.outflow.push(sign * rate[f as usize] * share);
                    all.outflow.extend([0.0; D]);
                    all.neighbors.push(match across {
                        NONE => NONE,
                        across => across + piece as u32,
                    });
                    all.neighbors.extend([NONE; D]);
                }
            }
            all
        };
        let count = mesh.sites.len();
        let mut all = CellParts::default();
        all.corners.reserve_exact(parts as usize * (D + 1));
        all.outflow.reserve_exact(parts as usize * (D + 1));
        all.neighbors.reserve_exact(parts as usize * (D + 1));
        // Some at a time: there are thirty parts a cell.
        for from in (0..count).step_by(CHUNK_CELLS) {
            let cells: Vec<CellParts> = (from..count.min(from + CHUNK_CELLS))
                .into_par_iter()
                .map(|cell| {
                    let mut parts = cut(cell);
                    solve_inner_rates::<D>(&mut parts, &nodes, cell_start[cell], velocity[cell]);
                    parts
                })
                .collect();
            for parts in cells {
                all.corners.extend(parts.corners);
                all.outflow.extend(parts.outflow);
                all.neighbors.extend(parts.neighbors);
            }
        }
        Self {
            mesh: M::from_parts(nodes, all.corners),
            rates: FaceRates {
                outflow: all.outflow,
                neighbors: all.neighbors,
            },
            cell_start,
        }
    }
}

/// The share of a face's area that a piece of it has.
fn face_area_share<const D: usize>(mesh: &PolyMesh<D>, piece: &[u32; D], area: &[f64; D]) -> f64 {
    let whole = dot(*area, *area);
    if D == 2 || whole == 0.0 {
        return 1.0;
    }
    let mut p = [[0.0; D]; 4];
    for (p, &node) in p[1..].iter_mut().zip(piece) {
        *p = mesh.nodes[node as usize];
    }
    // The area does not depend on where the top of the pyramid is.
    p[0] = std::array::from_fn(|k| p[1][k] - area[k]);
    let (g, _) = gradients(&p);
    dot(area_vector(g[0]), *area) / whole
}

/// Finds the rates between the parts of a cell, the first of which has the number `first`.
fn solve_inner_rates<const D: usize>(
    parts: &mut CellParts,
    nodes: &[[f64; D]],
    first: u32,
    velocity: [f64; D],
) {
    let count = parts.neighbors.len() / (D + 1);
    // Faces between parts, by the nodes that they have besides the site.
    let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(count * D);
    let mut volume = vec![0.0; count];
    let mut flux = vec![0.0; count * (D + 1)];
    for part in 0..count {
        let own = &parts.corners[part * (D + 1)..(part + 1) * (D + 1)];
        let mut p = [[0.0; D]; 4];
        for (p, &node) in p.iter_mut().zip(own) {
            *p = nodes[node as usize];
        }
        let (g, size) = gradients(&p);
        volume[part] = size.max(0.0);
        for k in 1..=D {
            flux[part * (D + 1) + k] = dot(velocity, area_vector(g[k]));
            let mut rest = (1..=D).filter(|&i| i != k).map(|i| own[i]);
            let (a, b) = (rest.next().unwrap_or(NONE), rest.next().unwrap_or(NONE));
            sides.push(([a.min(b), a.max(b)], (part * (D + 1) + k) as u32));
        }
    }
    sides.sort_unstable();
    let pairs: Vec<[usize; 2]> = sides
        .chunk_by(|a, b| a.0 == b.0)
        .filter_map(|same| match same {
            [a, b] => Some([a.1 as usize, b.1 as usize]),
            _ => None,
        })
        .collect();
    // Each part keeps its share of the cell's source; the rest is to go to its neighbours.
    let source: f64 = parts.outflow.iter().sum();
    let whole: f64 = volume.iter().sum();
    let mut excess: Vec<f64> = (0..count)
        .map(|part| source * volume[part] / whole - parts.outflow[part * (D + 1)])
        .collect();
    let mut laplacian = vec![0.0; count * count];
    for &[a, b] in &pairs {
        let (i, j) = (a / (D + 1), b / (D + 1));
        // Rounding makes the two fluxes differ a little.
        let rate = 0.5 * (flux[a] - flux[b]);
        (parts.outflow[a], parts.outflow[b]) = (rate, -rate);
        parts.neighbors[a] = first + j as u32;
        parts.neighbors[b] = first + i as u32;
        excess[i] -= rate;
        excess[j] += rate;
        laplacian[i * count + i] += 1.0;
        laplacian[j * count + j] += 1.0;
        laplacian[i * count + j] -= 1.0;
        laplacian[j * count + i] -= 1.0;
    }
    solve_singular(&mut laplacian, &mut excess);
    for &[a, b] in &pairs {
        let rate = excess[a / (D + 1)] - excess[b / (D + 1)];
        parts.outflow[a] += rate;
        parts.outflow[b] -= rate;
    }
}

/// Solves a symmetric system with constants as its kernel: the last unknown is 0.
fn solve_singular(a: &mut [f64], b: &mut [f64]) {
    let n = b.len();
    for i in 0..n.saturating_sub(1) {
        let pivot = a[i * n + i];
        if pivot <= 0.0 {
            continue;
        }
        for r in i + 1..n {
            let factor = a[r * n + i] / pivot;
            if factor == 0.0 {
                continue;
            }
            b[r] -= factor * b[i];
            let (above, below) = a.split_at_mut(r * n);
            let row = &above[i * n..(i + 1) * n];
            (i..n).for_each(|c| below[c] -= factor * row[c]);
        }
    }
    if let Some(last) = b.last_mut() {
        *last = 0.0;
    }
    for i in (0..n.saturating_sub(1)).rev() {
        let known: f64 = (i + 1..n).map(|c| a[i * n + c] * b[c]).sum();
        let pivot = a[i * n + i];
        b[i] = if pivot > 0.0 {
            (b[i] - known) / pivot
        } else {
            0.0
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriMesh;
    use crate::mesh::voronoi::voronoi_plane;
    use crate::model::flow::{CellFlow, FaultLaw, Rock, Streamlines, Tensor};
    use crate::progress::CancelToken;

    /// Places without order in the box `[0, extent]`.
    fn random_points<const D: usize>(count: usize, extent: [f64; D]) -> Vec<[f64; D]> {
        let mut state = 11u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..count)
            .map(|_| extent.map(|e| e * (0.01 + 0.98 * uniform())))
            .collect()
    }

    /// Fluid is conserved in every part, and what leaves one enters the next.
    fn check_conservation<const D: usize, M: Simplices<D>>(
        inside: &CellReconstruction<D, M>,
        sources: &[f64],
        size: f64,
    ) {
        for cell in 0..inside.cell_start.len() - 1 {
            let parts = inside.cell_start[cell] as usize..inside.cell_start[cell + 1] as usize;
            let whole: f64 = parts.clone().map(|part| inside.mesh.volume(part)).sum();
            for part in parts {
                let (out, beyond) = inside.rates.faces_of(part);
                let source = sources[cell] * inside.mesh.volume(part) / whole;
                assert!((out.iter().sum::<f64>() - source).abs() < 1e-9 * size);
                for (k, &next) in beyond.iter().enumerate().filter(|(_, next)| **next != NONE) {
                    let (back, there) = inside.rates.faces_of(next as usize);
                    let face = there.iter().position(|&c| c as usize == part);
                    let face = face.expect("parts know one another");
                    assert!((back[face] + out[k]).abs() < 1e-9 * size);
                }
            }
        }
    }

    fn check_uniform_flow<const D: usize, M: Simplices<D>>(
        mesh: &PolyMesh<D>,
        length: f64,
        section: f64,
    ) {
        let graph = Graph::from_poly(mesh);
        let rock = Rock::uniform(Tensor::isotropic(2.0), 1.0);
        let flow = CellFlow::new(&graph, &rock, FaultLaw::OPEN).unwrap();
        let sides = [(0, length), (1, 0.0)];
        let found = flow.solve(&vec![0.0; graph.volume.len()], &sides).unwrap();
        let rates = flow.rates(&found.pressure[..graph.volume.len()], &sides);
        let inside: CellReconstruction<D, M> =
            CellReconstruction::new(mesh, &graph, &rates, &flow.velocity(&rates));
        check_conservation(&inside, &vec![0.0; graph.volume.len()], section);
        let all = Streamlines::trace_polyhedra(&inside, &[], &[], 40, &CancelToken::never());
        assert!((all.rate * 40.0 - 2.0 * section).abs() < 1e-6 * section);
        let mut begin = 0;
        for &end in &all.ends {
            let line = &all.points[begin..end as usize];
            assert!(line[0][0].abs() < 1e-9 && (line[line.len() - 1][0] - length).abs() < 1e-9);
            let off = |x: &[f64; D]| (1..D).map(|k| (x[k] - line[0][k]).abs()).sum::<f64>();
            assert!(line.iter().all(|x| off(x) < 1e-5), "{line:?}");
            assert!((all.time[end as usize - 1] - length / 2.0).abs() < 1e-5);
            begin = end as usize;
        }
    }

    fn check_well_to_well<const D: usize, M: Simplices<D>>(
        mesh: &PolyMesh<D>,
        from: [f64; D],
        to: [f64; D],
    ) {
        let graph = Graph::from_poly(mesh);
        let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
        let flow = CellFlow::new(&graph, &rock, FaultLaw::OPEN).unwrap();
        let cells = [from, to].map(|x| graph.cell_at(x).unwrap());
        let mut sources = vec![0.0; graph.volume.len()];
        (sources[cells[0]], sources[cells[1]]) = (1.0, -1.0);
        let found = flow.solve(&sources, &[]).unwrap();
        let rates = flow.rates(&found.pressure, &[]);
        let inside: CellReconstruction<D, M> =
            CellReconstruction::new(mesh, &graph, &rates, &flow.velocity(&rates));
        check_conservation(&inside, &sources, 1.0);
        let wells = [(cells[0] as u32, 1.0), (cells[1] as u32, -1.0)];
        let all =
            Streamlines::trace_polyhedra(&inside, &wells, &[from, to], 60, &CancelToken::never());
        assert!((all.rate * 60.0 - 1.0).abs() < 1e-9);
        let mut begin = 0;
        let mut arrived = 0;
        for &end in &all.ends {
            let line = &all.points[begin..end as usize];
            assert_eq!(line[0], from);
            arrived += usize::from(line[line.len() - 1] == to);
            begin = end as usize;
        }
        assert_eq!((all.ends.len(), arrived), (60, 60));
    }

    #[test]
    fn through_polygons() {
        let extent = [6.0, 4.0];
        let mesh = voronoi_plane(&random_points(150, extent), extent).unwrap();
        check_uniform_flow::<2, TriMesh>(&mesh, 6.0, 4.0);
        check_well_to_well::<2, TriMesh>(&mesh, [1.0, 1.2], [5.1, 2.8]);
    }

    #[cfg(feature = "tetgen")]
    #[test]
    fn through_polyhedra() {
        let extent = [6.0, 4.0, 3.0];
        let mesh = crate::mesh::voronoi::voronoi(&random_points(400, extent), extent).unwrap();
        check_uniform_flow::<3, crate::mesh::TetMesh>(&mesh, 6.0, 12.0);
        check_well_to_well::<3, crate::mesh::TetMesh>(&mesh, [1.0, 1.2, 1.0], [5.1, 2.8, 2.0]);
    }
}
