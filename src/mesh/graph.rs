//! The connection graph: cells, and the faces through which they are connected. Flow and the
//! exporters to simulators use it, whatever the cells are.

use crate::parallel::prelude::*;

use super::TetMesh;
use super::poly::{FaceNeighbour, Lists, PolyMesh};
use crate::Result;
use crate::geometry::{NONE, add_scaled, dot, norm, sub, unit};

/// Cells and connections in one space: lattice or physical, as the code that owns the graph
/// documents.
///
/// Cells are in the order of the mesh, connections in the order of its inner faces.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Graph<const D: usize> {
    /// Volume of each cell (area in 2-D).
    pub volume: Vec<f64>,
    /// Position of each cell's unknowns: its atom, or its centroid for tetrahedra.
    pub site: Vec<[f64; D]>,
    /// Centroid of each cell.
    pub centroid: Vec<[f64; D]>,
    /// Region of each cell.
    pub region: Vec<i32>,
    /// Faces between two cells.
    pub connections: Vec<Connection<D>>,
    /// Faces of cells on the boundary.
    pub boundary: Vec<BoundaryFace<D>>,
}

/// A face between two cells a < b.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Connection<const D: usize> {
    /// The cells a and b.
    pub cells: [u32; 2],
    /// Index of the face in the mesh of polyhedra.
    pub face: u32,
    /// `true` if the face lies on a feature of the image (a fault, for example).
    pub on_feature: bool,
    /// Area of the face (length in 2-D).
    pub area: f64,
    /// Distances from the sites of a and b to the plane of the face. Both are positive if the plane
    /// lies between the sites.
    pub distance: [f64; 2],
    /// Point at which the line between the sites meets the plane of the face.
    pub point: [f64; D],
    /// Unit normal of the face, from a to b.
    pub normal: [f64; D],
}

/// A face of a cell on the boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryFace<const D: usize> {
    /// The cell.
    pub cell: u32,
    /// The side of the box, numbered in lattice space: 2 axis for the lower side, 2 axis + 1 for
    /// the upper side. `None` if the mesh does not know it.
    pub side: Option<u8>,
    /// Index of the face in the mesh of polyhedra.
    pub face: u32,
    /// Area of the face (length in 2-D).
    pub area: f64,
    /// Distance from the cell's site to the plane of the face.
    pub distance: f64,
    /// Centre of the face.
    pub point: [f64; D],
    /// Unit normal of the face, outwards.
    pub normal: [f64; D],
}

impl<const D: usize> Connection<D> {
    /// Returns the angle in degrees between the face's normal and the line between the sites. Where
    /// it is 0, the two-point flux is exact (for an isotropic permeability).
    pub fn angle_error(&self, site: &[[f64; D]]) -> f64 {
        let [a, b] = self.cells.map(|c| site[c as usize]);
        let line = sub(b, a);
        let along = dot(line, self.normal);
        let across = add_scaled(line, -along, self.normal);
        norm(across).atan2(along).to_degrees()
    }

    /// Returns the transmissibility of the two-point flux for permeability 1: the face's area over
    /// the distance between the sites along the face's normal.
    pub fn unit_transmissibility(&self) -> f64 {
        self.area / (self.distance[0] + self.distance[1])
    }
}

impl<const D: usize> Graph<D> {
    /// Creates the graph of a mesh of polyhedra (in 2-D of polygons). Voronoi cells have an
    /// `angle_error` of 0 in the space in which they were made.
    ///
    /// In columns, a face between two sites exactly above one another is replaced by its vertical
    /// projection: flow along a column passes through that area, however the face dips.
    pub fn from_poly(mesh: &PolyMesh<D>) -> Self {
        let shapes = mesh.cell_shapes();
        let inner = mesh.inner_face_count();
        let in_columns = mesh.is_columnar();
        let connections = (0..inner)
            .into_par_iter()
            .map(|f| {
                let [a, b] = mesh.face_cells[f];
                let mut shape = mesh.face_shape(f);
                let [above, below] = [a, b].map(|cell| &mesh.sites[cell as usize]);
                if in_columns && above[..2] == below[..2] {
                    shape.centroid = mesh
                        .vertical_projection(f, *above)
                        .unwrap_or(shape.centroid);
                    shape.area_vector[..2].fill(0.0);
                }
                Connection {
                    face: f as u32,
                    on_feature: mesh.on_feature[f],
                    ..Connection::new(
                        [a, b],
                        [mesh.sites[a as usize], mesh.sites[b as usize]],
                        shape.area_vector,
                        shape.centroid,
                    )
                }
            })
            .collect();
        let boundary = (inner..mesh.face_cells.len())
            .into_par_iter()
            .map(|f| {
                let cell = mesh.face_cells[f][0];
                let shape = mesh.face_shape(f);
                let side = match mesh.face_neighbour(f) {
                    FaceNeighbour::Side(side) => Some(side as u8),
                    _ => None,
                };
                BoundaryFace {
                    face: f as u32,
                    ..BoundaryFace::new(
                        cell,
                        side,
                        mesh.sites[cell as usize],
                        shape.area_vector,
                        shape.centroid,
                    )
                }
            })
            .collect();
        Self {
            volume: shapes.iter().map(|s| s.0).collect(),
            centroid: shapes.iter().map(|s| s.1).collect(),
            site: mesh.sites.clone(),
            region: mesh.region.clone(),
            connections,
            boundary,
        }
    }

    /// Returns the largest [`Connection::angle_error`], and the mean weighted by area.
    pub fn angle_errors(&self) -> (f64, f64) {
        let (mut worst, mut sum, mut area) = (0.0f64, 0.0, 0.0);
        for connection in &self.connections {
            let error = connection.angle_error(&self.site);
            worst = worst.max(error);
            sum += error * connection.area;
            area += connection.area;
        }
        (worst, if area > 0.0 { sum / area } else { 0.0 })
    }
}

/// A face of a cell, seen from the cell.
#[derive(Debug, Clone, Copy)]
pub struct CellSide<const D: usize> {
    /// Number of the face: connections are numbered first, then boundary faces.
    pub face: u32,
    /// A point of the face's plane.
    pub point: [f64; D],
    /// Unit normal, outwards.
    pub normal: [f64; D],
    /// The cell beyond the face; `None` on the boundary.
    pub neighbour: Option<u32>,
}

impl<const D: usize> CellSide<D> {
    /// Returns how far a point lies beyond the face's plane.
    #[inline]
    pub fn offset(&self, point: [f64; D]) -> f64 {
        dot(sub(point, self.point), self.normal)
    }
}

/// Finds the cells that contain points. After the faces of all cells are listed once, each query is
/// fast. Cells are assumed to be convex.
pub struct Locator<'a, const D: usize> {
    graph: &'a Graph<D>,
    /// Faces of each cell.
    faces: Lists,
}

impl<'a, const D: usize> Locator<'a, D> {
    /// Creates a locator for the cells of a graph.
    pub fn new(graph: &'a Graph<D>) -> Self {
        let inner = graph.connections.iter().map(|c| c.cells);
        let outer = graph.boundary.iter().map(|f| [f.cell, NONE]);
        let cells: Vec<[u32; 2]> = inner.chain(outer).collect();
        Self {
            graph,
            faces: Lists::inverse(graph.volume.len(), &cells),
        }
    }

    /// Returns the cell that contains `point`: the one for which the point's largest offset beyond
    /// the faces' planes is smallest, with a tolerance for rounding.
    pub fn cell_at(&self, point: [f64; D]) -> Option<usize> {
        let Some(found_cell) = self.walk(point) else {
            return self.innermost_cell(point);
        };
        // Where faces are bent, a neighbour within two steps may contain the point better.
        let mut candidates = vec![found_cell];
        for _ in 0..2 {
            for i in 0..candidates.len() {
                let sides = self.sides(candidates[i] as u32);
                candidates.extend(sides.filter_map(|side| side.neighbour).map(|n| n as usize));
            }
            candidates.sort_unstable();
            candidates.dedup();
        }
        let offsets = (candidates.into_iter()).map(|cell| (self.max_offset(cell, point), cell));
        let innermost = offsets.min_by(|a, b| a.0.total_cmp(&b.0));
        innermost.map(|(_, cell)| cell)
    }

    /// Returns the cell that [`cell_at`](Self::cell_at) is to find, from all cells.
    fn innermost_cell(&self, point: [f64; D]) -> Option<usize> {
        let cells = 0..self.graph.volume.len();
        let offsets = cells.map(|cell| (self.max_offset(cell, point), cell));
        let (offset, cell) = offsets.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (offset <= 1e-6 * self.graph.volume[cell].powf(1.0 / D as f64)).then_some(cell)
    }

    /// Returns the largest offset of a point beyond the planes of a cell's faces.
    fn max_offset(&self, cell: usize, point: [f64; D]) -> f64 {
        let offsets = self.sides(cell as u32).map(|side| side.offset(point));
        offsets.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Returns the faces of a cell, in the order of their numbers.
    #[inline]
    pub fn sides(&self, cell: u32) -> impl Iterator<Item = CellSide<D>> + '_ {
        let (inner, outer) = (&self.graph.connections, &self.graph.boundary);
        self.faces.get(cell as usize).iter().map(move |&face| {
            let (point, normal, neighbour) = match inner.get(face as usize) {
                Some(c) if c.cells[0] == cell => (c.point, c.normal, Some(c.cells[1])),
                Some(c) => (c.point, c.normal.map(|n| -n), Some(c.cells[0])),
                None => {
                    let face = &outer[face as usize - inner.len()];
                    (face.point, face.normal, None)
                }
            };
            CellSide {
                face,
                point,
                normal,
                neighbour,
            }
        })
    }

    /// Walks from a cell with a nearby site to the cell that contains the point well inside, each
    /// time through the face beyond whose plane the point lies farthest. Returns `None` if the
    /// point lies on a face or outside the mesh, or if the walk does not end.
    fn walk(&self, point: [f64; D]) -> Option<usize> {
        let cells = self.graph.volume.len();
        let squared_distance = |cell: usize| {
            let site = self.graph.site[cell];
            (0..D).map(|k| (site[k] - point[k]).powi(2)).sum::<f64>()
        };
        // The stride makes the number of tested start cells about the length of the walk.
        let stride = (cells as f64).powf(1.0 - 1.0 / (D as f64 + 1.0)) as usize;
        let starts = (0..cells).step_by(stride.max(1));
        let mut cell =
            starts.min_by(|&a, &b| squared_distance(a).total_cmp(&squared_distance(b)))?;
        for _ in 0..cells {
            let (next_cell, offset) = self
                .sides(cell as u32)
                .map(|side| (side.neighbour, side.offset(point)))
                .max_by(|a, b| a.1.total_cmp(&b.1))?;
            let size = self.graph.volume[cell].powf(1.0 / D as f64);
            match next_cell {
                _ if offset < -1e-9 * size => return Some(cell),
                Some(next) if offset > 1e-9 * size => cell = next as usize,
                // The point is on a face, or outside the mesh.
                _ => return None,
            }
        }
        None
    }
}

impl Graph<3> {
    /// Creates the graph of a mesh of tetrahedra. Sites are centroids, so that each site is on its
    /// own side of every face. Connections are not normal to the faces; `angle_error` measures the
    /// deviation.
    ///
    /// `feature_faces` has bit k of byte t set if face k of tetrahedron t lies on a feature.
    /// `region` has a number for each tetrahedron. Either may be empty. The `side` of boundary
    /// faces is `None`.
    ///
    /// # Errors
    /// Returns the errors of [`PolyMesh::from_simplices`].
    pub fn from_tets(mesh: &TetMesh, feature_faces: &[u8], region: &[i32]) -> Result<Self> {
        let mesh = PolyMesh::from_simplices(mesh, feature_faces, region)?;
        Ok(Self::from_poly(&mesh))
    }
}

impl<const D: usize> Connection<D> {
    /// Creates a connection from the face's area vector (from a to b) and centre, and the sites of
    /// the two cells.
    pub(crate) fn new(
        cells: [u32; 2],
        [a, b]: [[f64; D]; 2],
        area_vector: [f64; D],
        centre: [f64; D],
    ) -> Self {
        let (area, mut normal) = (norm(area_vector), unit(area_vector));
        let line = sub(b, a);
        let length = norm(line);
        // The normal of such a small or narrow face is dominated by rounding.
        if area < (1e-4 * length).powi(D as i32 - 1) {
            normal = unit(line);
        }
        let distance = [dot(sub(centre, a), normal), dot(sub(b, centre), normal)];
        let fraction = distance[0] / (distance[0] + distance[1]);
        Self {
            cells,
            face: 0,
            on_feature: false,
            area,
            distance,
            point: std::array::from_fn(|k| a[k] + fraction * (b[k] - a[k])),
            normal,
        }
    }
}

impl<const D: usize> BoundaryFace<D> {
    pub(crate) fn new(
        cell: u32,
        side: Option<u8>,
        site: [f64; D],
        area_vector: [f64; D],
        point: [f64; D],
    ) -> Self {
        let (area, normal) = (norm(area_vector), unit(area_vector));
        Self {
            cell,
            side,
            face: 0,
            area,
            distance: dot(sub(point, site), normal),
            point,
            normal,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::poly::samples::two_cells;
    use super::*;

    fn two_boxes<const D: usize>() {
        let graph = Graph::from_poly(&two_cells::<D>(0.75));
        assert_eq!(graph.volume, [0.75, 1.25]);
        let [connection] = graph.connections[..] else {
            panic!("one connection")
        };
        let mut point = [0.5; D];
        point[0] = 0.75;
        let mut normal = [0.0; D];
        normal[0] = 1.0;
        let expected = Connection {
            cells: [0, 1],
            face: 0,
            on_feature: true,
            area: 1.0,
            distance: [0.5, 0.5],
            point,
            normal,
        };
        assert_eq!(connection, expected);
        assert_eq!(graph.angle_errors(), (0.0, 0.0));
        assert_eq!(connection.unit_transmissibility(), 1.0);
        let lower = &graph.boundary[0];
        assert_eq!((lower.cell, lower.side, lower.distance), (0, Some(0), 0.25));
        assert_eq!(graph.boundary.len(), 4 * D - 2);
    }

    #[test]
    fn two_boxes_have_one_connection() {
        two_boxes::<2>();
        two_boxes::<3>();
    }

    #[test]
    fn stretching_space_shows_as_an_angle() {
        // In a sheared space the line between the sites is oblique to the face.
        let sheared = two_cells::<3>(0.75).mapped(|[x, y, z]| [x, y + x, z], false);
        let (worst, mean) = Graph::from_poly(&sheared).angle_errors();
        assert!((worst - 45.0).abs() < 1e-12 && (mean - 45.0).abs() < 1e-12);
    }

    #[test]
    fn tetrahedra_connect_through_their_common_face() {
        let nodes = vec![
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
        ];
        let mesh = TetMesh {
            nodes,
            tets: vec![[0, 1, 2, 3], [0, 2, 1, 4]],
        };
        let graph = Graph::from_tets(&mesh, &[8, 0], &[]).unwrap();
        assert!(graph.volume.iter().all(|v| (v - 1.0 / 6.0).abs() < 1e-15));
        assert_eq!(graph.boundary.len(), 6);
        assert!(graph.boundary.iter().all(|f| f.distance > 0.0));
        let [c] = graph.connections[..] else {
            panic!("one connection")
        };
        assert!(c.on_feature && c.face == 0);
        let is_close = |a: f64, b: f64| (a - b).abs() < 1e-15;
        assert!(
            is_close(c.area, 0.5) && is_close(c.distance[0], 0.25) && is_close(c.distance[1], 0.25)
        );
        assert_eq!(c.normal, [0.0, 0.0, -1.0]);
        assert!((0..3).all(|k| is_close(c.point[k], [0.25, 0.25, 0.0][k])));
        assert_eq!(graph.angle_errors().0, 0.0);
        assert!(Graph::from_tets(&mesh, &[1], &[]).is_err());
    }
}
