//! Reconstructs the flow inside polyhedra and polygons. Each cell is cut into tetrahedra or
//! triangles around its site, and the rates through the faces between these parts follow from the
//! rates through the cell's own faces.
//!
//! Two-point fluxes give the rates through the faces of a cell but not the flow inside it, which
//! streamlines need. Of all inner rates that conserve fluid (sources are spread evenly over their
//! cell), these are the nearest to a constant velocity: the fluxes of that velocity plus a
//! correction, which is the gradient of a potential on the parts of the cell (cells are cut as in
//! Prevost, Edwards & Blunt 2002 and Hægland et al. 2007). The result is exact where the velocity
//! is constant.

use crate::parallel::prelude::*;

use super::cells::CellRates;
use super::face_rates::FaceRates;
use super::shape_functions::{area_vector, gradients};
use crate::geometry::dot;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::graph::Graph;
use crate::mesh::poly::{Lists, PolyMesh};

/// Number of cells whose parts are computed in one batch.
const CHUNK_CELLS: usize = 1 << 14;

/// Cells of a mesh, each cut into simplices.
#[derive(Debug, Clone)]
pub struct CellReconstruction<const D: usize, M> {
    /// The parts, cell by cell. The first node of each part is the cell's site; the others are a
    /// facet of one of the cell's faces.
    pub mesh: M,
    /// Rates through the faces of the parts.
    pub rates: FaceRates<D>,
    /// The first part of each cell, then the total number of parts.
    pub cell_start: Vec<u32>,
}

/// The parts of one cell.
#[derive(Default)]
struct CellParts {
    /// D + 1 nodes of each part, the site first.
    corners: Vec<u32>,
    /// Rates out of the parts through their faces.
    outflow: Vec<f64>,
    /// The part on the other side of each face.
    neighbours: Vec<u32>,
}

/// Numbers of the parts, cell by cell.
struct PartNumbers {
    /// The faces of each cell.
    faces: Lists,
    /// The first part of each cell, then the total number of parts.
    cell_start: Vec<u32>,
    /// The first part of each face on either side.
    first_part: Vec<[u32; 2]>,
}

/// Returns the number of parts of a cell at one of its faces.
fn parts_of_face<const D: usize>(mesh: &PolyMesh<D>, face: u32) -> usize {
    mesh.faces.get(face as usize).len() + 1 - D
}

/// Returns the rate through each face, out of its first cell.
fn face_rates<const D: usize>(mesh: &PolyMesh<D>, graph: &Graph<D>, rates: &CellRates) -> Vec<f64> {
    let mut rate = vec![0.0; mesh.face_cells.len()];
    for (c, r) in graph.connections.iter().zip(&rates.connections) {
        rate[c.face as usize] = *r;
    }
    for (f, r) in graph.boundary.iter().zip(&rates.boundary) {
        rate[f.face as usize] = *r;
    }
    rate
}

impl PartNumbers {
    fn new<const D: usize>(mesh: &PolyMesh<D>) -> Self {
        let faces = mesh.faces_of_cells();
        let mut cell_start = Vec::with_capacity(mesh.sites.len() + 1);
        let mut first_part = vec![[NONE; 2]; mesh.face_cells.len()];
        let mut part_count = 0;
        for cell in 0..mesh.sites.len() {
            cell_start.push(part_count);
            for &f in faces.get(cell) {
                let is_first_cell = mesh.face_cells[f as usize][0] as usize == cell;
                first_part[f as usize][usize::from(!is_first_cell)] = part_count;
                part_count += parts_of_face(mesh, f) as u32;
            }
        }
        cell_start.push(part_count);
        Self {
            faces,
            cell_start,
            first_part,
        }
    }

    /// Returns the number of parts of all cells.
    fn total(&self) -> usize {
        self.cell_start.last().map_or(0, |&count| count as usize)
    }

    /// Cuts a cell into parts; `rate` has the rate through each face.
    fn cut_cell<const D: usize>(&self, mesh: &PolyMesh<D>, cell: usize, rate: &[f64]) -> CellParts {
        let mut parts = CellParts::default();
        for &f in self.faces.get(cell) {
            let ring = mesh.faces.get(f as usize);
            let shape = mesh.face_shape(f as usize);
            let is_first_cell = mesh.face_cells[f as usize][0] as usize == cell;
            let sign = if is_first_cell { 1.0 } else { -1.0 };
            let opposite_part = self.first_part[f as usize][usize::from(is_first_cell)];
            for facet in 0..parts_of_face(mesh, f) {
                let mut outer: [u32; D] =
                    std::array::from_fn(|i| ring[if i == 0 { 0 } else { facet + i }]);
                let share = face_area_share(mesh, &outer, &shape.area_vector);
                if !is_first_cell {
                    outer.swap(D - 2, D - 1);
                }
                parts.corners.push((mesh.nodes.len() + cell) as u32);
                parts.corners.extend(outer);
                parts.outflow.push(sign * rate[f as usize] * share);
                parts.outflow.extend([0.0; D]);
                parts.neighbours.push(match opposite_part {
                    NONE => NONE,
                    first => first + facet as u32,
                });
                parts.neighbours.extend([NONE; D]);
            }
        }
        parts
    }
}

impl<const D: usize, M: Simplices<D>> CellReconstruction<D, M> {
    /// Cuts all cells of a mesh into parts. `graph` is the graph of the mesh, `rates` the rates
    /// through its faces, and `velocity` the velocity of each cell.
    pub fn new(
        mesh: &PolyMesh<D>,
        graph: &Graph<D>,
        rates: &CellRates,
        velocity: &[[f64; D]],
    ) -> Self {
        let numbers = PartNumbers::new(mesh);
        let part_count = numbers.total();
        let rate = face_rates(mesh, graph, rates);
        let mut nodes = mesh.nodes.clone();
        nodes.extend_from_slice(&mesh.sites);
        let count = mesh.sites.len();
        let mut all_parts = CellParts::default();
        all_parts.corners.reserve_exact(part_count * (D + 1));
        all_parts.outflow.reserve_exact(part_count * (D + 1));
        all_parts.neighbours.reserve_exact(part_count * (D + 1));
        // In batches, because there are about thirty parts in each cell.
        for chunk_start in (0..count).step_by(CHUNK_CELLS) {
            let cells: Vec<CellParts> = (chunk_start..count.min(chunk_start + CHUNK_CELLS))
                .into_par_iter()
                .map(|cell| {
                    let mut parts = numbers.cut_cell(mesh, cell, &rate);
                    let first_part = numbers.cell_start[cell];
                    solve_inner_rates::<D>(&mut parts, &nodes, first_part, velocity[cell]);
                    parts
                })
                .collect();
            for parts in cells {
                all_parts.corners.extend(parts.corners);
                all_parts.outflow.extend(parts.outflow);
                all_parts.neighbours.extend(parts.neighbours);
            }
        }
        Self {
            mesh: M::from_parts(nodes, all_parts.corners),
            rates: FaceRates {
                outflow: all_parts.outflow,
                neighbours: all_parts.neighbours,
            },
            cell_start: numbers.cell_start,
        }
    }
}

/// Returns the fraction of a face's area that one of its facets has.
fn face_area_share<const D: usize>(mesh: &PolyMesh<D>, facet: &[u32; D], area: &[f64; D]) -> f64 {
    let squared_area = dot(*area, *area);
    if D == 2 || squared_area == 0.0 {
        return 1.0;
    }
    let mut p = [[0.0; D]; 4];
    for (p, &node) in p[1..].iter_mut().zip(facet) {
        *p = mesh.nodes[node as usize];
    }
    // The area does not depend on the position of the pyramid's apex.
    p[0] = std::array::from_fn(|k| p[1][k] - area[k]);
    let (g, _) = gradients(&p);
    dot(area_vector(g[0]), *area) / squared_area
}

/// Computes the rates between the parts of a cell. The first part has the number `first_part`.
fn solve_inner_rates<const D: usize>(
    parts: &mut CellParts,
    nodes: &[[f64; D]],
    first_part: u32,
    velocity: [f64; D],
) {
    let count = parts.neighbours.len() / (D + 1);
    // Faces between parts, each with its nodes other than the site.
    let mut inner_faces: Vec<([u32; 2], u32)> = Vec::with_capacity(count * D);
    let mut volume = vec![0.0; count];
    let mut flux = vec![0.0; count * (D + 1)];
    for part in 0..count {
        let corners = &parts.corners[part * (D + 1)..(part + 1) * (D + 1)];
        let mut p = [[0.0; D]; 4];
        for (p, &node) in p.iter_mut().zip(corners) {
            *p = nodes[node as usize];
        }
        let (g, size) = gradients(&p);
        volume[part] = size.max(0.0);
        for k in 1..=D {
            flux[part * (D + 1) + k] = dot(velocity, area_vector(g[k]));
            let mut other_nodes = (1..=D).filter(|&i| i != k).map(|i| corners[i]);
            let (a, b) = (
                other_nodes.next().unwrap_or(NONE),
                other_nodes.next().unwrap_or(NONE),
            );
            inner_faces.push(([a.min(b), a.max(b)], (part * (D + 1) + k) as u32));
        }
    }
    inner_faces.sort_unstable();
    // Two faces of a cell with three common nodes on one line may both have the diagonal between
    // the outer two. It joins facets of the same face, whose parts have successive numbers.
    let pairs: Vec<[usize; 2]> = inner_faces
        .chunk_by(|a, b| a.0 == b.0)
        .flat_map(|same| same.as_chunks().0)
        .map(|[a, b]| [a.1 as usize, b.1 as usize])
        .collect();
    // Each part keeps its share of the cell's source; the excess flows to its neighbours.
    let source: f64 = parts.outflow.iter().sum();
    let total_volume: f64 = volume.iter().sum();
    let mut excess: Vec<f64> = (0..count)
        .map(|part| source * volume[part] / total_volume - parts.outflow[part * (D + 1)])
        .collect();
    let mut laplacian = vec![0.0; count * count];
    for &[a, b] in &pairs {
        let (i, j) = (a / (D + 1), b / (D + 1));
        // The two fluxes differ by rounding.
        let rate = 0.5 * (flux[a] - flux[b]);
        (parts.outflow[a], parts.outflow[b]) = (rate, -rate);
        parts.neighbours[a] = first_part + j as u32;
        parts.neighbours[b] = first_part + i as u32;
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

/// Solves a symmetric system whose kernel are the constant vectors. The last unknown is set to 0.
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
    use crate::geometry::random::Random;
    use crate::mesh::TriMesh;
    use crate::mesh::graph::Locator;
    use crate::mesh::voronoi::voronoi_plane;
    use crate::model::flow::{CellFlow, FaultLaw, Rock, Streamlines, Tensor};
    use crate::progress::CancelToken;

    /// Returns pseudo-random points in the box `[0, extent]`.
    fn random_points<const D: usize>(count: usize, extent: [f64; D]) -> Vec<[f64; D]> {
        let mut random = Random::new(11);
        let mut point = || extent.map(|e| e * random.range(0.01, 0.99));
        (0..count).map(|_| point()).collect()
    }

    /// Checks that fluid is conserved in every part, and that neighbouring parts have opposite
    /// rates.
    fn check_conservation<const D: usize, M: Simplices<D>>(
        reconstruction: &CellReconstruction<D, M>,
        sources: &[f64],
        size: f64,
    ) {
        for cell in 0..reconstruction.cell_start.len() - 1 {
            let parts = reconstruction.cell_start[cell] as usize
                ..reconstruction.cell_start[cell + 1] as usize;
            let total_volume: f64 = parts
                .clone()
                .map(|part| reconstruction.mesh.volume(part))
                .sum();
            for part in parts {
                let (outflow, neighbours) = reconstruction.rates.faces_of(part);
                let source = sources[cell] * reconstruction.mesh.volume(part) / total_volume;
                assert!((outflow.iter().sum::<f64>() - source).abs() < 1e-9 * size);
                for (k, &next) in neighbours
                    .iter()
                    .enumerate()
                    .filter(|(_, next)| **next != NONE)
                {
                    let (opposite_outflow, opposite_neighbours) =
                        reconstruction.rates.faces_of(next as usize);
                    let face = opposite_neighbours.iter().position(|&c| c as usize == part);
                    let face = face.expect("parts know one another");
                    assert!((opposite_outflow[face] + outflow[k]).abs() < 1e-9 * size);
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
        let solution = flow.solve(&vec![0.0; graph.volume.len()], &sides).unwrap();
        let rates = flow.rates(&solution.pressure[..graph.volume.len()], &sides);
        let reconstruction: CellReconstruction<D, M> =
            CellReconstruction::new(mesh, &graph, &rates, &flow.velocity(&rates));
        check_conservation(&reconstruction, &vec![0.0; graph.volume.len()], section);
        let streamlines =
            Streamlines::trace_polyhedra(&reconstruction, &[], &[], 40, &CancelToken::never());
        assert!((streamlines.rate * 40.0 - 2.0 * section).abs() < 1e-6 * section);
        let mut begin = 0;
        for &end in &streamlines.ends {
            let line = &streamlines.points[begin..end as usize];
            assert!(line[0][0].abs() < 1e-9 && (line[line.len() - 1][0] - length).abs() < 1e-9);
            let offset = |x: &[f64; D]| (1..D).map(|k| (x[k] - line[0][k]).abs()).sum::<f64>();
            assert!(line.iter().all(|x| offset(x) < 1e-5), "{line:?}");
            assert!((streamlines.time[end as usize - 1] - length / 2.0).abs() < 1e-5);
            begin = end as usize;
        }
    }

    fn check_well_to_well<const D: usize, M: Simplices<D>>(
        mesh: &PolyMesh<D>,
        source: [f64; D],
        sink: [f64; D],
    ) {
        let graph = Graph::from_poly(mesh);
        let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
        let flow = CellFlow::new(&graph, &rock, FaultLaw::OPEN).unwrap();
        let locator = Locator::new(&graph);
        let cells = [source, sink].map(|x| locator.cell_at(x).unwrap());
        let mut sources = vec![0.0; graph.volume.len()];
        (sources[cells[0]], sources[cells[1]]) = (1.0, -1.0);
        let solution = flow.solve(&sources, &[]).unwrap();
        let rates = flow.rates(&solution.pressure, &[]);
        let reconstruction: CellReconstruction<D, M> =
            CellReconstruction::new(mesh, &graph, &rates, &flow.velocity(&rates));
        check_conservation(&reconstruction, &sources, 1.0);
        let wells = [(cells[0] as u32, 1.0), (cells[1] as u32, -1.0)];
        let streamlines = Streamlines::trace_polyhedra(
            &reconstruction,
            &wells,
            &[source, sink],
            60,
            &CancelToken::never(),
        );
        assert!((streamlines.rate * 60.0 - 1.0).abs() < 1e-9);
        let mut begin = 0;
        let mut arrived = 0;
        for &end in &streamlines.ends {
            let line = &streamlines.points[begin..end as usize];
            assert_eq!(line[0], source);
            arrived += usize::from(line[line.len() - 1] == sink);
            begin = end as usize;
        }
        assert_eq!((streamlines.ends.len(), arrived), (60, 60));
    }

    #[test]
    fn reconstruction_in_polygons_is_conservative() {
        let extent = [6.0, 4.0];
        let mesh = voronoi_plane(&random_points(150, extent), extent).unwrap();
        check_uniform_flow::<2, TriMesh>(&mesh, 6.0, 4.0);
        check_well_to_well::<2, TriMesh>(&mesh, [1.0, 1.2], [5.1, 2.8]);
    }

    #[test]
    fn reconstruction_in_polyhedra_is_conservative() {
        let extent = [6.0, 4.0, 3.0];
        let mesh = crate::mesh::voronoi::voronoi(&random_points(400, extent), extent).unwrap();
        check_uniform_flow::<3, crate::mesh::TetMesh>(&mesh, 6.0, 12.0);
        check_well_to_well::<3, crate::mesh::TetMesh>(&mesh, [1.0, 1.2, 1.0], [5.1, 2.8, 2.0]);
    }
}
