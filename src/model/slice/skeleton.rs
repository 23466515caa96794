//! The faces of a mesh, each once, and where they meet a plane. It makes no difference what the
//! cells are: a cell's section is bounded by the sections of its faces.

use crate::image::Geometry;
use crate::mesh::poly::Lists;
use crate::store::{MeshFile, Stored};

/// The faces of a mesh (edges, in the plane), with nodes in sample indices.
#[derive(Debug, Clone, Default)]
pub struct Skeleton<const D: usize> {
    /// Node positions in sample indices, x first.
    pub nodes: Vec<[f64; D]>,
    /// The nodes of each face, in order round it.
    pub faces: Lists,
    /// Whether each face lies on a feature.
    pub marked: Vec<bool>,
}

/// A point on a line of a section, and the next.
type Segment<const D: usize> = [[f64; D]; 2];

impl<const D: usize> Skeleton<D> {
    /// Of a mesh file (physical coordinates) in the sample indices of an image; faces that the file
    /// says lie on features are marked. `None` if the image's axes are linearly dependent.
    pub fn new<M: Stored<D>>(file: &MeshFile<M>, geometry: &Geometry<D>) -> Option<Self> {
        let mesh = &file.mesh;
        let index = |&x: &[f64; D]| geometry.to_index(x);
        let nodes = mesh.nodes().iter().map(index).collect::<Option<_>>()?;
        let marks = mesh.marks(M::feature_faces(file, false).as_deref());
        let (faces, marked) = mesh.faces_once(&marks.unwrap_or_default());
        Some(Self {
            nodes,
            faces,
            marked,
        })
    }

    /// The faces, each as its nodes' positions and whether it is marked.
    fn faces(&self) -> impl Iterator<Item = (&[u32], bool)> {
        let numbered = self.marked.iter().enumerate();
        numbered.map(|(face, &marked)| (self.faces.get(face), marked))
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
