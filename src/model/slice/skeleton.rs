//! The faces of a mesh, each once, and where they meet a plane. It makes no difference what the
//! cells are: a cell's section is bounded by the sections of its faces.

use crate::files::vtk::Values;
use crate::image::Geometry;
use crate::mesh::poly::PolyMesh;
use crate::report::Measured;
use crate::store::MeshFile;

/// The faces of a mesh (edges, in the plane), with nodes in sample indices.
#[derive(Debug, Clone, Default)]
pub struct Skeleton<const D: usize> {
    /// Node positions in sample indices, x first.
    pub nodes: Vec<[f64; D]>,
    /// The nodes of each face, face after face, in order round it.
    pub corners: Vec<u32>,
    /// Where each face ends in `corners`.
    pub ends: Vec<u32>,
    /// Whether each face lies on a feature.
    pub marked: Vec<bool>,
}

/// A point on a line of a section, and the next.
type Segment<const D: usize> = [[f64; D]; 2];

impl<const D: usize> Skeleton<D> {
    /// Of a mesh file (physical coordinates) in the sample indices of an image; faces that the file
    /// says lie on features are marked. `None` if the image's axes do not span space.
    pub fn new<M: Measured<D>>(file: &MeshFile<M>, geometry: &Geometry<D>) -> Option<Self> {
        let mesh = &file.mesh;
        let index = |&x: &[f64; D]| geometry.to_index(x);
        let nodes = mesh.nodes().iter().map(index).collect::<Option<_>>()?;
        let bits = file.cell_data.iter().find(|a| a.name == M::FEATURE_FACES);
        let bits = match bits.map(|array| &array.values) {
            Some(Values::U8(bits)) => bits.as_slice(),
            _ => &[],
        };
        let mut faces: Vec<([u32; D], bool)> = Vec::with_capacity(mesh.connectivity().len());
        for cell in 0..mesh.len() {
            for k in 0..=D {
                let mut face = mesh.face(cell, k);
                face.sort_unstable();
                let marked = bits.get(cell).is_some_and(|b| b >> k & 1 == 1);
                faces.push((face, !marked));
            }
        }
        // Of the two sides of a face, one that is marked comes first.
        faces.sort_unstable();
        faces.dedup_by_key(|(face, _)| *face);
        Some(Self {
            nodes,
            corners: faces.iter().flat_map(|(face, _)| *face).collect(),
            ends: (1..=faces.len() as u32).map(|f| D as u32 * f).collect(),
            marked: faces.iter().map(|(_, unmarked)| !unmarked).collect(),
        })
    }

    /// Of a file of polyhedra or polygons, likewise.
    pub fn of_cells(file: &MeshFile<PolyMesh<D>>, geometry: &Geometry<D>) -> Option<Self> {
        let mesh = &file.mesh;
        let index = |&x: &[f64; D]| geometry.to_index(x);
        Some(Self {
            nodes: mesh.nodes.iter().map(index).collect::<Option<_>>()?,
            corners: mesh.faces.items.clone(),
            ends: mesh.faces.offsets[1..].to_vec(),
            marked: mesh.on_feature.clone(),
        })
    }

    /// The faces, each as its nodes' positions and whether it is marked.
    fn faces(&self) -> impl Iterator<Item = (&[u32], bool)> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts
            .zip(&self.ends)
            .map(|(from, &to)| &self.corners[from as usize..to as usize])
            .zip(self.marked.iter().copied())
    }
}

impl Skeleton<2> {
    /// The edges, with whether each is marked.
    pub fn edges(&self) -> impl Iterator<Item = (Segment<2>, bool)> {
        self.faces().filter_map(|(face, marked)| match *face {
            [a, b] => Some(([a, b].map(|n| self.nodes[n as usize]), marked)),
            _ => None,
        })
    }
}

impl Skeleton<3> {
    /// Where the faces meet the plane on which coordinate `axis` is `at`: a segment of each convex
    /// face that the plane cuts, and whether the face is marked.
    ///
    /// A node exactly on the plane counts as beyond it, so that every cut face gives one segment
    /// and the segments of a cell close.
    pub fn section(&self, axis: usize, at: f64) -> impl Iterator<Item = (Segment<3>, bool)> {
        self.faces()
            .filter_map(move |(face, marked)| Some((self.cut(face, axis, at)?, marked)))
    }

    fn cut(&self, face: &[u32], axis: usize, at: f64) -> Option<Segment<3>> {
        let mut found = [[0.0; 3]; 2];
        let mut count = 0;
        for i in 0..face.len() {
            let [p, q] = [face[i], face[(i + 1) % face.len()]].map(|n| self.nodes[n as usize]);
            let (u, v) = (p[axis] - at, q[axis] - at);
            if (u < 0.0) == (v < 0.0) || count == 2 {
                continue;
            }
            let t = u / (u - v);
            found[count] = std::array::from_fn(|k| p[k] + t * (q[k] - p[k]));
            count += 1;
        }
        (count == 2).then_some(found)
    }
}
