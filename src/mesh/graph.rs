//! The connection graph: cells, and what joins them. Flow and every exporter to a simulator start
//! from here, whatever the cells are.

use crate::parallel::prelude::*;

use super::TetMesh;
use super::poly::{FaceNeighbour, PolyMesh};
use crate::Result;
use crate::geometry::dot;

/// Cells and connections, in one space (lattice or physical; the owner says which).
///
/// Cells have the order of the mesh; connections that of its inner faces.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Graph<const D: usize> {
    /// Volume of each cell (area in 2-D).
    pub volume: Vec<f64>,
    /// The point at which the cell's unknowns are: its atom, or its centroid for tetrahedra.
    pub site: Vec<[f64; D]>,
    /// Centre of each cell's volume.
    pub centroid: Vec<[f64; D]>,
    /// Region of each cell.
    pub region: Vec<i32>,
    /// What joins two cells.
    pub connections: Vec<Connection<D>>,
    /// What a cell has in common with the boundary.
    pub boundary: Vec<BoundaryFace<D>>,
}

/// A face between two cells a < b.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Connection<const D: usize> {
    /// The cells a and b.
    pub cells: [u32; 2],
    /// The face in the mesh of polyhedra.
    pub face: u32,
    /// Whether the face lies on a feature of the image (a fault, say).
    pub on_feature: bool,
    /// Area of the face (length in 2-D).
    pub area: f64,
    /// Distances from the sites of a and b to the plane of the face, square to it; both positive
    /// when the plane lies between the sites.
    pub distance: [f64; 2],
    /// Where the line from site to site meets the plane of the face.
    pub point: [f64; D],
    /// Unit normal of the face, from a to b.
    pub normal: [f64; D],
}

/// A face of a cell on the boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryFace<const D: usize> {
    /// The cell.
    pub cell: u32,
    /// The side of the box: 2 axis for the lower one, 2 axis + 1 for the upper one, counted in
    /// lattice space; `None` if the mesh does not say.
    pub side: Option<u8>,
    /// The face in the mesh of polyhedra.
    pub face: u32,
    /// Area of the face (length in 2-D).
    pub area: f64,
    /// Distance from the cell's site to the plane of the face.
    pub distance: f64,
    /// Centre of the face.
    pub point: [f64; D],
    /// Unit normal, outwards.
    pub normal: [f64; D],
}

impl<const D: usize> Connection<D> {
    /// The angle in degrees between the face's normal and the line from site to site: 0 where the
    /// two-point flux is exact (for a permeability without direction).
    pub fn angle_error(&self, site: &[[f64; D]]) -> f64 {
        let [a, b] = self.cells.map(|c| site[c as usize]);
        let line: [f64; D] = std::array::from_fn(|k| b[k] - a[k]);
        let along = dot(line, self.normal);
        let across: [f64; D] = std::array::from_fn(|k| line[k] - along * self.normal[k]);
        dot(across, across).sqrt().atan2(along).to_degrees()
    }

    /// Transmissibility for permeability 1 by two-point flux: area over the distance from site to
    /// site square to the face.
    pub fn unit_transmissibility(&self) -> f64 {
        self.area / (self.distance[0] + self.distance[1])
    }
}

impl<const D: usize> Graph<D> {
    /// The graph of a mesh of polyhedra (polygons in 2-D): Voronoi cells connect with `angle_error`
    /// 0 in the space in which they were made.
    ///
    /// Where cells stand in columns, a face between sites that are exactly above one another counts as
    /// its shadow from above: what flows down a column passes that, however the face dips.
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

    /// The cell that holds a point: the one beyond whose faces' planes the point is least, if that is
    /// no more than rounding. Cells are taken to be convex.
    pub fn cell_at(&self, point: [f64; D]) -> Option<usize> {
        let mut outside = vec![f64::NEG_INFINITY; self.volume.len()];
        let mut beyond = |cell: u32, off: f64| {
            let outside = &mut outside[cell as usize];
            *outside = outside.max(off);
        };
        let off =
            |on: [f64; D], normal: [f64; D]| dot(std::array::from_fn(|k| point[k] - on[k]), normal);
        for c in &self.connections {
            let off = off(c.point, c.normal);
            beyond(c.cells[0], off);
            beyond(c.cells[1], -off);
        }
        for f in &self.boundary {
            beyond(f.cell, off(f.point, f.normal));
        }
        let least = outside.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
        let (cell, &off) = least?;
        (off <= 1e-6 * self.volume[cell].powf(1.0 / D as f64)).then_some(cell)
    }

    /// The largest and the mean [`Connection::angle_error`], weighted by area.
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

/// Finds the cells that hold points: a little work for each point, once the faces of all cells are
/// listed.
pub struct Locator<'a, const D: usize> {
    graph: &'a Graph<D>,
    /// Where the faces of each cell start in `faces`, and one more at the end.
    starts: Vec<u32>,
    /// Connections, then boundary faces.
    faces: Vec<u32>,
}

impl<'a, const D: usize> Locator<'a, D> {
    /// Of the cells of a graph.
    pub fn new(graph: &'a Graph<D>) -> Self {
        let sides = || {
            let inner = graph
                .connections
                .iter()
                .map(|c| (c.cells[0], Some(c.cells[1])));
            let outer = graph.boundary.iter().map(|f| (f.cell, None));
            inner.chain(outer).zip(0u32..)
        };
        let mut starts = vec![0u32; graph.volume.len() + 2];
        for ((a, b), _) in sides() {
            for cell in [Some(a), b].into_iter().flatten() {
                starts[cell as usize + 2] += 1;
            }
        }
        for i in 2..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut faces = vec![0; starts[starts.len() - 1] as usize];
        for ((a, b), face) in sides() {
            for cell in [Some(a), b].into_iter().flatten() {
                // The start of the next cell counts up to its place.
                let place = &mut starts[cell as usize + 1];
                faces[*place as usize] = face;
                *place += 1;
            }
        }
        starts.pop();
        Self {
            graph,
            starts,
            faces,
        }
    }

    /// As [`Graph::cell_at`], which looks at all cells.
    pub fn cell_at(&self, point: [f64; D]) -> Option<usize> {
        let Some(found) = self.walk(point) else {
            return self.graph.cell_at(point);
        };
        // Where faces are bent, a cell beside it may hold the point better.
        let mut near = vec![found];
        for _ in 0..2 {
            for i in 0..near.len() {
                near.extend(
                    self.face_distances(near[i], point)
                        .filter_map(|(next, _)| next),
                );
            }
            near.sort_unstable();
            near.dedup();
        }
        let outside = |cell: usize| {
            let off = self.face_distances(cell, point).map(|(_, off)| off);
            off.fold(f64::NEG_INFINITY, f64::max)
        };
        let deepest = near.into_iter().map(|cell| (outside(cell), cell));
        deepest
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, cell)| cell)
    }

    /// What lies beyond each face of a cell, and how far a point is beyond the face's plane.
    fn face_distances(
        &self,
        cell: usize,
        point: [f64; D],
    ) -> impl Iterator<Item = (Option<usize>, f64)> + '_ {
        let [start, end] = [cell, cell + 1].map(|c| self.starts[c] as usize);
        let off = move |on: [f64; D], normal: [f64; D]| {
            dot(std::array::from_fn(|k| point[k] - on[k]), normal)
        };
        self.faces[start..end].iter().map(move |&face| {
            let face = face as usize;
            let Some(c) = self.graph.connections.get(face) else {
                let f = &self.graph.boundary[face - self.graph.connections.len()];
                return (None, off(f.point, f.normal));
            };
            let off = off(c.point, c.normal);
            if c.cells[0] as usize == cell {
                (Some(c.cells[1] as usize), off)
            } else {
                (Some(c.cells[0] as usize), -off)
            }
        })
    }

    /// Goes from a cell whose site is near through the faces that a point is farthest beyond, to the
    /// cell that holds it, well inside. `None` where there is none, or the way leads nowhere.
    fn walk(&self, point: [f64; D]) -> Option<usize> {
        let cells = self.graph.volume.len();
        let far = |cell: usize| {
            let site = self.graph.site[cell];
            (0..D).map(|k| (site[k] - point[k]).powi(2)).sum::<f64>()
        };
        // About as many cells to begin from as there are then to go through.
        let every = (cells as f64).powf(1.0 - 1.0 / (D as f64 + 1.0)) as usize;
        let beginnings = (0..cells).step_by(every.max(1));
        let mut cell = beginnings.min_by(|&a, &b| far(a).total_cmp(&far(b)))?;
        for _ in 0..cells {
            let (beyond, off) = self
                .face_distances(cell, point)
                .max_by(|a, b| a.1.total_cmp(&b.1))?;
            let size = self.graph.volume[cell].powf(1.0 / D as f64);
            match beyond {
                _ if off < -1e-9 * size => return Some(cell),
                Some(next) if off > 1e-9 * size => cell = next,
                // On a face, or outside.
                _ => return None,
            }
        }
        None
    }
}

impl Graph<3> {
    /// The graph of a mesh of tetrahedra: sites are centroids, so that both are on their own sides
    /// of every face, and connections are not square to it; `angle_error` says by how much.
    ///
    /// `feature_faces` has bit k of byte t set if face k of tetrahedron t lies on a feature; `region`
    /// a number for each tetrahedron; either may be empty. `side` of boundary faces is `None`.
    ///
    /// # Errors
    /// As [`PolyMesh::from_simplices`].
    pub fn from_tets(mesh: &TetMesh, feature_faces: &[u8], region: &[i32]) -> Result<Self> {
        let mesh = PolyMesh::from_simplices(mesh, feature_faces, region)?;
        Ok(Self::from_poly(&mesh))
    }
}

/// Length and direction of a vector.
fn length_and_direction<const D: usize>(v: [f64; D]) -> (f64, [f64; D]) {
    let length = dot(v, v).sqrt();
    (
        length,
        v.map(|c| if length > 0.0 { c / length } else { 0.0 }),
    )
}

impl<const D: usize> Connection<D> {
    /// From the face's area vector (a to b) and centre, and the cells' sites.
    fn new(
        cells: [u32; 2],
        [a, b]: [[f64; D]; 2],
        area_vector: [f64; D],
        centre: [f64; D],
    ) -> Self {
        let (area, mut normal) = length_and_direction(area_vector);
        let (length, line) = length_and_direction(std::array::from_fn(|k| b[k] - a[k]));
        // The normal of a face this small, or this narrow, is mere rounding.
        if area < (1e-4 * length).powi(D as i32 - 1) {
            normal = line;
        }
        let distance = [
            dot(std::array::from_fn(|k| centre[k] - a[k]), normal),
            dot(std::array::from_fn(|k| b[k] - centre[k]), normal),
        ];
        let share = distance[0] / (distance[0] + distance[1]);
        Self {
            cells,
            face: 0,
            on_feature: false,
            area,
            distance,
            point: std::array::from_fn(|k| a[k] + share * (b[k] - a[k])),
            normal,
        }
    }
}

impl<const D: usize> BoundaryFace<D> {
    fn new(
        cell: u32,
        side: Option<u8>,
        site: [f64; D],
        area_vector: [f64; D],
        point: [f64; D],
    ) -> Self {
        let (area, normal) = length_and_direction(area_vector);
        Self {
            cell,
            side,
            face: 0,
            area,
            distance: dot(std::array::from_fn(|k| point[k] - site[k]), normal),
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
        let want = Connection {
            cells: [0, 1],
            face: 0,
            on_feature: true,
            area: 1.0,
            distance: [0.5, 0.5],
            point,
            normal,
        };
        assert_eq!(connection, want);
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
        // The line from site to site is oblique in a sheared space.
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
        let off = |a: f64, b: f64| (a - b).abs() < 1e-15;
        assert!(off(c.area, 0.5) && off(c.distance[0], 0.25) && off(c.distance[1], 0.25));
        assert_eq!(c.normal, [0.0, 0.0, -1.0]);
        assert!((0..3).all(|k| off(c.point[k], [0.25, 0.25, 0.0][k])));
        assert_eq!(graph.angle_errors().0, 0.0);
        assert!(Graph::from_tets(&mesh, &[1], &[]).is_err());
    }
}
