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
use super::conserve::FaceRates;
use super::linear::{area_vector, gradients};
use crate::geometry::dot;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;

/// Cells whose parts are put together at a time.
const CHUNK: usize = 1 << 14;

/// Cells of a mesh in parts.
#[derive(Debug, Clone)]
pub struct Inside<const D: usize, M> {
    /// The parts, cell by cell: each has the cell's site, and a piece of one of its faces opposite.
    pub mesh: M,
    /// Rates through the faces of the parts.
    pub rates: FaceRates<D>,
    /// Where the parts of each cell begin, and where the last one's end.
    pub first: Vec<u32>,
}

/// The parts of one cell.
#[derive(Default)]
struct Parts {
    /// D + 1 nodes each, the site first.
    corners: Vec<u32>,
    /// Rates out through their faces.
    out: Vec<f64>,
    /// What is beyond.
    beyond: Vec<u32>,
}

impl<const D: usize, M: Simplices<D>> Inside<D, M> {
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
        let mut first = Vec::with_capacity(mesh.sites.len() + 1);
        let mut of_face = vec![[NONE; 2]; mesh.face_cells.len()];
        let mut parts = 0;
        for cell in 0..mesh.sites.len() {
            first.push(parts);
            for &f in faces.get(cell) {
                let own = mesh.face_cells[f as usize][0] as usize == cell;
                of_face[f as usize][usize::from(!own)] = parts;
                parts += pieces(f) as u32;
            }
        }
        first.push(parts);
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
            let mut all = Parts::default();
            for &f in faces.get(cell) {
                let ring = mesh.faces.get(f as usize);
                let shape = mesh.face_shape(f as usize);
                let own = mesh.face_cells[f as usize][0] as usize == cell;
                let sign = if own { 1.0 } else { -1.0 };
                let across = of_face[f as usize][usize::from(own)];
                for piece in 0..pieces(f) {
                    let mut outer: [u32; D] =
                        std::array::from_fn(|i| ring[if i == 0 { 0 } else { piece + i }]);
                    let share = piece_share(mesh, &outer, &shape.area_vector);
                    if !own {
                        outer.swap(D - 2, D - 1);
                    }
                    all.corners.push(site(cell));
                    all.corners.extend(outer);
                    all.out.push(sign * rate[f as usize] * share);
                    all.out.extend([0.0; D]);
                    all.beyond.push(match across {
                        NONE => NONE,
                        across => across + piece as u32,
                    });
                    all.beyond.extend([NONE; D]);
                }
            }
            all
        };
        let count = mesh.sites.len();
        let mut all = Parts::default();
        all.corners.reserve_exact(parts as usize * (D + 1));
        all.out.reserve_exact(parts as usize * (D + 1));
        all.beyond.reserve_exact(parts as usize * (D + 1));
        // Some at a time: there are thirty parts a cell.
        for from in (0..count).step_by(CHUNK) {
            let cells: Vec<Parts> = (from..count.min(from + CHUNK))
                .into_par_iter()
                .map(|cell| {
                    let mut parts = cut(cell);
                    balance::<D>(&mut parts, &nodes, first[cell], velocity[cell]);
                    parts
                })
                .collect();
            for parts in cells {
                all.corners.extend(parts.corners);
                all.out.extend(parts.out);
                all.beyond.extend(parts.beyond);
            }
        }
        Self {
            mesh: M::from_parts(nodes, all.corners),
            rates: FaceRates {
                out: all.out,
                neighbors: all.beyond,
            },
            first,
        }
    }
}

/// The share of a face's area that a piece of it has.
fn piece_share<const D: usize>(mesh: &PolyMesh<D>, piece: &[u32; D], area: &[f64; D]) -> f64 {
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
fn balance<const D: usize>(parts: &mut Parts, nodes: &[[f64; D]], first: u32, velocity: [f64; D]) {
    let count = parts.beyond.len() / (D + 1);
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
    let source: f64 = parts.out.iter().sum();
    let whole: f64 = volume.iter().sum();
    let mut excess: Vec<f64> = (0..count)
        .map(|part| source * volume[part] / whole - parts.out[part * (D + 1)])
        .collect();
    let mut laplacian = vec![0.0; count * count];
    for &[a, b] in &pairs {
        let (i, j) = (a / (D + 1), b / (D + 1));
        // Rounding makes the two fluxes differ a little.
        let rate = 0.5 * (flux[a] - flux[b]);
        (parts.out[a], parts.out[b]) = (rate, -rate);
        parts.beyond[a] = first + j as u32;
        parts.beyond[b] = first + i as u32;
        excess[i] -= rate;
        excess[j] += rate;
        laplacian[i * count + i] += 1.0;
        laplacian[j * count + j] += 1.0;
        laplacian[i * count + j] -= 1.0;
        laplacian[j * count + i] -= 1.0;
    }
    eliminate(&mut laplacian, &mut excess);
    for &[a, b] in &pairs {
        let rate = excess[a / (D + 1)] - excess[b / (D + 1)];
        parts.out[a] += rate;
        parts.out[b] -= rate;
    }
}

/// Solves a symmetric system with constants as its kernel: the last unknown is 0.
fn eliminate(a: &mut [f64], b: &mut [f64]) {
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
    use crate::model::flow::{CellFlow, Faults, Rock, Streamlines, Tensor};
    use crate::observer::Patience;

    /// Places without order in the box `[0, extent]`.
    fn places<const D: usize>(count: usize, extent: [f64; D]) -> Vec<[f64; D]> {
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
    fn conserved<const D: usize, M: Simplices<D>>(
        inside: &Inside<D, M>,
        sources: &[f64],
        size: f64,
    ) {
        for cell in 0..inside.first.len() - 1 {
            let parts = inside.first[cell] as usize..inside.first[cell + 1] as usize;
            let whole: f64 = parts.clone().map(|part| inside.mesh.volume(part)).sum();
            for part in parts {
                let (out, beyond) = inside.rates.of(part);
                let source = sources[cell] * inside.mesh.volume(part) / whole;
                assert!((out.iter().sum::<f64>() - source).abs() < 1e-9 * size);
                for (k, &next) in beyond.iter().enumerate().filter(|(_, next)| **next != NONE) {
                    let (back, there) = inside.rates.of(next as usize);
                    let face = there.iter().position(|&c| c as usize == part);
                    let face = face.expect("parts know one another");
                    assert!((back[face] + out[k]).abs() < 1e-9 * size);
                }
            }
        }
    }

    fn uniform_flow<const D: usize, M: Simplices<D>>(
        mesh: &PolyMesh<D>,
        length: f64,
        section: f64,
    ) {
        let graph = Graph::from_poly(mesh);
        let rock = Rock::uniform(Tensor::isotropic(2.0), 1.0);
        let flow = CellFlow::new(&graph, &rock, Faults::OPEN).unwrap();
        let sides = [(0, length), (1, 0.0)];
        let found = flow.solve(&vec![0.0; graph.volume.len()], &sides).unwrap();
        let rates = flow.rates(&found.pressure[..graph.volume.len()], &sides);
        let inside: Inside<D, M> = Inside::new(mesh, &graph, &rates, &flow.velocity(&rates));
        conserved(&inside, &vec![0.0; graph.volume.len()], section);
        let all = Streamlines::through(&inside, &[], &[], 40, &Patience::endless());
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

    fn between_wells<const D: usize, M: Simplices<D>>(
        mesh: &PolyMesh<D>,
        from: [f64; D],
        to: [f64; D],
    ) {
        let graph = Graph::from_poly(mesh);
        let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
        let flow = CellFlow::new(&graph, &rock, Faults::OPEN).unwrap();
        let cells = [from, to].map(|x| graph.cell_at(x).unwrap());
        let mut sources = vec![0.0; graph.volume.len()];
        (sources[cells[0]], sources[cells[1]]) = (1.0, -1.0);
        let found = flow.solve(&sources, &[]).unwrap();
        let rates = flow.rates(&found.pressure, &[]);
        let inside: Inside<D, M> = Inside::new(mesh, &graph, &rates, &flow.velocity(&rates));
        conserved(&inside, &sources, 1.0);
        let wells = [(cells[0] as u32, 1.0), (cells[1] as u32, -1.0)];
        let all = Streamlines::through(&inside, &wells, &[from, to], 60, &Patience::endless());
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
        let mesh = voronoi_plane(&places(150, extent), extent).unwrap();
        uniform_flow::<2, TriMesh>(&mesh, 6.0, 4.0);
        between_wells::<2, TriMesh>(&mesh, [1.0, 1.2], [5.1, 2.8]);
    }

    #[cfg(feature = "tetgen")]
    #[test]
    fn through_polyhedra() {
        let extent = [6.0, 4.0, 3.0];
        let mesh = crate::mesh::voronoi::voronoi(&places(400, extent), extent).unwrap();
        uniform_flow::<3, crate::mesh::TetMesh>(&mesh, 6.0, 12.0);
        between_wells::<3, crate::mesh::TetMesh>(&mesh, [1.0, 1.2, 1.0], [5.1, 2.8, 2.0]);
    }
}
