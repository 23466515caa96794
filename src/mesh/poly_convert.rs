//! Conversion to meshes of polyhedra (polygons in 2-D): from simplices, and by lifting polygons to
//! prisms.

use super::Simplices;
use super::complex::NONE;
use super::poly::{FIRST_SIDE, PolyMesh};
use crate::error::{Error, Result, cause};
use crate::geometry::{dot, sub};

impl<const D: usize> PolyMesh<D> {
    /// Creates a mesh with the cells of a mesh of simplices, in the same order. Sites are
    /// centroids. Faces on the boundary have [`NONE`] beyond them.
    ///
    /// `feature_faces` has bit k of byte c set if face k of cell c lies on a feature. `region` has
    /// a number for each cell. Either may be empty.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if three cells share a face, or if the number of bytes or regions is
    /// wrong.
    pub fn from_simplices<M: Simplices<D>>(
        mesh: &M,
        feature_faces: &[u8],
        region: &[i32],
    ) -> Result<Self> {
        let count = mesh.len();
        let refuse = |problem: String, remedy: &str| Error::Mesh(cause("mesh", problem, remedy));
        let lengths = [
            ("feature bytes", feature_faces.len()),
            ("regions", region.len()),
        ];
        if let Some((noun, len)) = lengths.iter().find(|(_, len)| *len != 0 && *len != count) {
            let problem = format!("{len} {noun} for {count} {}", M::CELLS_NAME);
            return Err(refuse(problem, "give one for each"));
        }
        let neighbours = mesh.neighbours().map_err(|face| {
            let problem = format!("face {face:?} belongs to more than two {}", M::CELLS_NAME);
            refuse(problem, "give a mesh that atomesh validate passes")
        })?;
        let nodes = mesh.nodes();
        let mean = |corners: &[u32]| -> [f64; D] {
            let sum = |k: usize| corners.iter().map(|&n| nodes[n as usize][k]).sum::<f64>();
            std::array::from_fn(|k| sum(k) / corners.len() as f64)
        };
        let mut poly = Self {
            nodes: nodes.to_vec(),
            sites: (0..count).map(|c| mean(mesh.cell(c))).collect(),
            region: match region {
                [] => vec![0; count],
                _ => region.to_vec(),
            },
            ..Self::default()
        };
        let size = D + 1;
        for inner in [true, false] {
            for c in 0..count {
                let cell_neighbours = &neighbours[size * c..size * (c + 1)];
                let is_selected = |&k: &usize| match cell_neighbours[k] {
                    NONE => !inner,
                    other => inner && c < other as usize,
                };
                let mut faces: Vec<usize> = (0..size).filter(is_selected).collect();
                faces.sort_unstable_by_key(|&k| cell_neighbours[k]);
                for k in faces {
                    let beyond = if inner { cell_neighbours[k] } else { NONE };
                    poly.faces.push(mesh.face(c, k));
                    poly.face_cells.push([c as u32, beyond]);
                    let bits = feature_faces.get(c).copied().unwrap_or(0);
                    poly.on_feature.push(bits >> k & 1 == 1);
                    poly.orient_last_face_outwards();
                }
            }
        }
        Ok(poly)
    }

    /// Appends the nodes of a polygon to `ring`, in anticlockwise order. For 2-D meshes.
    pub fn append_ring(&self, cell: usize, faces: &[u32], ring: &mut Vec<u32>) {
        let edge = |f: u32| {
            let nodes = self.faces.get(f as usize);
            if self.face_cells[f as usize][0] as usize == cell {
                [nodes[0], nodes[1]]
            } else {
                [nodes[1], nodes[0]]
            }
        };
        let mut node = faces.first().map_or(0, |&f| edge(f)[0]);
        for _ in faces {
            ring.push(node);
            let mut edges = faces.iter().map(|&f| edge(f));
            node = edges.find(|e| e[0] == node).map_or(node, |e| e[1]);
        }
    }

    /// Reverses the last face if its normal points to its owner's site.
    fn orient_last_face_outwards(&mut self) {
        let f = self.face_cells.len() - 1;
        let shape = self.face_shape(f);
        let site = self.sites[self.face_cells[f][0] as usize];
        let out = sub(shape.centroid, site);
        if dot(out, shape.area_vector) < 0.0 {
            let start = self.faces.offsets[f] as usize;
            self.faces.items[start..].reverse();
        }
    }
}

impl PolyMesh<2> {
    /// Returns a layer of prisms between z = 0 and z = `thickness`, one on each polygon and in the
    /// same order, with sites at half height. Edges become upright faces, which lie on features if
    /// the edges do.
    pub fn extrude(&self, thickness: f64) -> PolyMesh<3> {
        let count = self.nodes.len() as u32;
        let lift = |z: f64| move |&[x, y]: &[f64; 2]| [x, y, z];
        let mut layer = PolyMesh {
            nodes: (self.nodes.iter().map(lift(0.0)))
                .chain(self.nodes.iter().map(lift(thickness)))
                .collect(),
            sites: self.sites.iter().map(lift(0.5 * thickness)).collect(),
            region: self.region.clone(),
            ..PolyMesh::default()
        };
        let inner = self.inner_face_count();
        let add_upright_face = |layer: &mut PolyMesh<3>, f: usize| {
            let [p, q] = [0, 1].map(|i| self.faces.get(f)[i]);
            layer.faces.push([p, q, q + count, p + count]);
            layer.face_cells.push(self.face_cells[f]);
            layer.on_feature.push(self.on_feature[f]);
        };
        (0..inner).for_each(|f| add_upright_face(&mut layer, f));
        let lists = self.faces_of_cells();
        let mut ring = Vec::new();
        for cell in 0..self.sites.len() {
            let cell_faces = lists.get(cell);
            let outer = cell_faces.iter().filter(|&&f| f as usize >= inner);
            outer.for_each(|&f| add_upright_face(&mut layer, f as usize));
            ring.clear();
            self.append_ring(cell, cell_faces, &mut ring);
            for (side, up) in [(4, false), (5, true)] {
                if up {
                    layer.faces.push(ring.iter().map(|&n| n + count))
                } else {
                    layer.faces.push(ring.iter().rev().copied())
                }
                layer.face_cells.push([cell as u32, FIRST_SIDE + side]);
                layer.on_feature.push(false);
            }
        }
        layer
    }
}

#[cfg(test)]
mod tests {
    use super::super::TriMesh;
    use super::super::check::check;
    use super::super::graph::Graph;
    use super::super::poly::samples::two_cells;
    use super::*;
    use crate::mesh::boxes::kuhn_box;

    #[test]
    fn tetrahedra_fill_the_box_as_polyhedra() {
        let mesh = kuhn_box([1; 3], 1.0);
        let mut poly = PolyMesh::from_simplices(&mesh, &[1; 6], &[3; 6]).unwrap();
        assert_eq!((poly.inner_face_count(), poly.face_cells.len()), (6, 18));
        poly.assign_sides([0.0; 3], [1.0; 3]);
        let report = check(&poly, [0.0; 3], [1.0; 3], 1e-12);
        assert!(report.passed(), "{report:?}");
        assert_eq!(poly.region, [3; 6]);
        // Face 0, opposite node 0, is on the boundary for each tetrahedron.
        let marked = poly.on_feature.iter().filter(|mark| **mark).count();
        assert!(marked == 6 && poly.on_feature[..6].iter().all(|mark| !mark));
        assert!(PolyMesh::from_simplices(&mesh, &[1], &[]).is_err());
    }

    #[test]
    fn prisms_on_polygons_and_triangles_fill_the_box() {
        let mesh = two_cells::<2>(0.75);
        let layer = mesh.extrude(3.0);
        let report = check(&layer, [0.0; 3], [2.0, 1.0, 3.0], 1e-12);
        assert!(report.passed(), "{report:?}");
        assert!(layer.on_feature[0]);
        assert_eq!(Graph::from_poly(&layer).volume, [2.25, 3.75]);

        let square = TriMesh {
            nodes: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let mut poly = PolyMesh::<2>::from_simplices(&square, &[], &[]).unwrap();
        poly.assign_sides([0.0; 2], [1.0; 2]);
        let report = check(&poly.extrude(0.5), [0.0; 3], [1.0, 1.0, 0.5], 1e-12);
        assert!(report.passed(), "{report:?}");
    }
}
