//! The box, the features and the nominal distance to which meshes are made.

use std::borrow::Cow;

use crate::Result;
use crate::feature::{FeaturePoint, Features};
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::{self, SealReport};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;
use crate::progress::CancelToken;

/// The box, the features and the nominal distance with which atoms are joined.
#[derive(Debug, Clone, Copy)]
pub struct MeshScene<'a, const D: usize> {
    /// The far corner of the box.
    pub extent: [f64; D],
    /// The features that the mesh follows.
    pub features: &'a Features<D>,
    /// Nominal distance between nodes.
    pub distance: &'a Distance<D>,
}

/// Radius of the patches from which local planes of features are fitted, in units of d. It is
/// clamped to 2 to 6.5 samples; from 3 samples on, a patch of a curve contains four points.
const PATCH_RADIUS: f64 = 0.8;

/// Distance from a feature, in units of d, below which atoms are snapped onto it before they are
/// joined.
const SNAP_RADIUS: f64 = 0.35;

impl<const D: usize> MeshScene<'_, D> {
    /// Returns feature points as local planes. Curves in the plane become surfaces that are
    /// perpendicular to it.
    pub(super) fn planes_of(&self, points: &[FeaturePoint<D>]) -> FeaturePlanes {
        let min_radius = if D == 2 { 3.0 } else { 2.0 };
        let radius = (PATCH_RADIUS * self.distance.min()).clamp(min_radius, 6.5);
        FeaturePlanes::new(points, self.extent, radius, self.search_radius())
    }

    /// Returns the features as local planes.
    pub(super) fn local_planes(&self) -> FeaturePlanes {
        self.planes_of(&self.features.points)
    }

    /// Returns the distance within which features are searched. An edge is at most 1.7 d long, and a
    /// feature that it intersects is within half of that from one of its ends.
    pub(super) fn search_radius(&self) -> f64 {
        0.85 * self.distance.max() + 1.5
    }

    /// Returns the distance within which atoms are snapped onto features.
    pub(super) fn snap_distance(&self) -> f64 {
        SNAP_RADIUS * self.distance.min()
    }

    /// Snaps the atoms that are close to a feature onto it. Returns the features as local planes.
    pub(crate) fn snap(&self, positions: &mut [[f64; D]], kinds: &[AtomKind]) -> FeaturePlanes {
        let planes = self.local_planes();
        let max_distance = self.snap_distance();
        improve::snap_to_features(positions, kinds, self.extent, &planes, max_distance);
        planes
    }

    /// Returns the points of the feature surface of this number.
    pub(super) fn surface_points(&self, surface: u32) -> Vec<FeaturePoint<D>> {
        let points = self.features.points.iter().zip(&self.features.surface);
        let selected = points.filter(|(_, number)| **number == surface);
        selected.map(|(point, _)| *point).collect()
    }

    /// Adds the faces that close holes in these feature surfaces to the faces on features (`marks`).
    ///
    /// # Errors
    /// Returns the errors of [`seal`](crate::improve::seal).
    pub(crate) fn close_holes<M: Simplices<D>>(
        &self,
        mesh: &M,
        neighbours: &[u32],
        points: &[FeaturePoint<D>],
        marks: &mut [u8],
        cancel: &CancelToken<'_>,
    ) -> Result<SealReport> {
        let (view, d_max) = (MeshView::from_mesh(mesh), self.distance.max());
        let distance = |_: &[[f64; D]]| Ok(Cow::Borrowed(self.distance));
        improve::seal(
            &view,
            neighbours,
            points,
            self.extent,
            d_max,
            distance,
            marks,
            cancel,
        )
    }
}
