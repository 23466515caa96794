//! The faces of a mesh, each once, and their sections with a plane. The kind of cells makes no
//! difference: the section of a cell is bounded by the sections of its faces.

use super::shape::cut_ring;
use crate::image::Geometry;
use crate::mesh::poly::Lists;
use crate::model::surface::SurfaceKind;
use crate::store::{MeshFile, Storable};

/// The faces of a mesh (in 2-D its edges), with nodes in sample indices.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Skeleton<const D: usize> {
    /// Node positions in sample indices, x first.
    pub nodes: Vec<[f64; D]>,
    /// Nodes of each face, in cyclic order.
    pub faces: Lists,
    /// Kind of feature on which each face lies, if any.
    pub kinds: Vec<Option<SurfaceKind>>,
}

/// Both ends of a line.
type Segment<const D: usize> = [[f64; D]; 2];

impl<const D: usize> Skeleton<D> {
    /// Creates the skeleton of a mesh file (physical coordinates) in the sample indices of an
    /// image, with the faces on features that the file records. Returns `None` if the image's axes
    /// are linearly dependent.
    pub fn new<M: Storable<D>>(file: &MeshFile<M>, geometry: &Geometry<D>) -> Option<Self> {
        let mesh = &file.mesh;
        let to_index = |&x: &[f64; D]| geometry.to_index(x);
        let nodes = mesh.nodes().iter().map(to_index).collect::<Option<_>>()?;
        let feature_marks = mesh.feature_marks(M::feature_faces(file, false).as_deref());
        let (faces, on_feature) = mesh.unique_faces(&feature_marks.unwrap_or_default());
        let (_, on_horizon) = mesh.unique_faces(&M::horizons(file, false));
        let kind = |(&feature, &horizon)| match (feature, horizon) {
            (_, true) => Some(SurfaceKind::Horizon),
            (true, false) => Some(SurfaceKind::Fault),
            (false, false) => None,
        };
        Some(Self {
            nodes,
            faces,
            kinds: on_feature.iter().zip(&on_horizon).map(kind).collect(),
        })
    }

    /// Returns the faces, each as its nodes and the kind of feature on which it lies.
    fn faces(&self) -> impl Iterator<Item = (&[u32], Option<SurfaceKind>)> {
        let numbered = self.kinds.iter().enumerate();
        numbered.map(|(face, &kind)| (self.faces.get(face), kind))
    }
}

impl Skeleton<2> {
    /// Returns the edges, each with the kind of feature on which it lies.
    pub fn edges(&self) -> impl Iterator<Item = (Segment<2>, Option<SurfaceKind>)> {
        self.faces().filter_map(|(face, kind)| match *face {
            [a, b] => Some(([a, b].map(|n| self.nodes[n as usize]), kind)),
            _ => None,
        })
    }
}

impl Skeleton<3> {
    /// Returns the sections of the faces with the plane on which coordinate `axis` is `position`: a
    /// segment of each convex face that the plane cuts, and the kind of feature on which the face
    /// lies.
    ///
    /// A node exactly on the plane counts as above it, so that every cut face has one segment and
    /// the segments of a cell form a closed line.
    pub fn section(
        &self,
        axis: usize,
        position: f64,
    ) -> impl Iterator<Item = (Segment<3>, Option<SurfaceKind>)> {
        self.faces().filter_map(move |(face, kind)| {
            let corner = |i: usize| self.nodes[face[i] as usize];
            Some((cut_ring(face.len(), corner, axis, position)?, kind))
        })
    }
}
