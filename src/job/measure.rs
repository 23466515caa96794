//! The figures of what a job made.

use std::borrow::Cow;
use std::ops::Range;

use crate::parallel::prelude::*;

use super::join::Scene;
use crate::feature::{FeaturePoint, Features};
use crate::files::kept::fields;
use crate::mesh::Simplices;
use crate::mesh::check::{Check, Known, check_pieces, check_while};
use crate::mesh::part::Part;
use crate::mesh::piece::Piece;
use crate::observer::Patience;
use crate::ranks::Group;
use crate::report::{self, Fidelity, Judged, Lattice, Quality, Reference};
use crate::{Result, ranks};

/// How far the volume may be off the box's, and sides from flat, as a share.
pub const BOX_TOLERANCE: f64 = 1e-9;

/// A mesh in lattice space, and what it is compared with.
pub(super) struct Measured<'a, const D: usize, M> {
    pub mesh: &'a M,
    pub neighbors: Option<&'a [u32]>,
    /// The faces that it claims to lie on features, if it does.
    pub claimed: Option<&'a [u8]>,
    /// Its faces on features, where its lattice and its acute lines are asked for.
    pub feature_faces: Option<&'a [u8]>,
    pub scene: &'a Scene<'a, D>,
}

/// Figures of a mesh: those that were asked for, and measured to their end.
#[derive(Default)]
pub(super) struct Figures {
    pub judged: Option<Judged>,
    pub lattice: Option<Lattice>,
    pub quality: Option<Quality>,
    pub filling: Option<Check>,
    pub fidelity: Option<Fidelity>,
}

fields! { Figures as Figures { judged, lattice, quality, filling, fidelity } }

impl Figures {
    /// Adds what others are.
    fn add(&mut self, others: Self) {
        let Self {
            judged,
            lattice,
            quality,
            filling,
            fidelity,
        } = others;
        self.judged = judged.or(self.judged.take());
        self.lattice = lattice.or(self.lattice.take());
        self.quality = quality.or(self.quality.take());
        self.filling = filling.or(self.filling.take());
        self.fidelity = fidelity.or(self.fidelity.take());
    }
}

impl<const D: usize, M: Simplices<D>> Measured<'_, D, M> {
    /// Atoms and angles, shapes, validity and fidelity, as far as `patience` lasts: what was not measured to its end
    /// is left out. They take about as long each, and much of each is for one thread: so they are measured at the same
    /// time, and ranks measure some each.
    ///
    /// # Errors
    /// Those of [`report::fidelity`] and of [`ranks::share`].
    pub fn figures(&self, patience: &Patience<'_>) -> Result<Figures> {
        type Part<'a> = &'a (dyn Fn() -> Result<Figures> + Sync);
        let parts: [Part; 4] = [
            &|| Ok(self.lattice()),
            &|| {
                Ok(Figures {
                    quality: measured(patience, || report::quality_while(self.mesh, patience)),
                    ..Figures::default()
                })
            },
            &|| {
                Ok(Figures {
                    filling: measured(patience, || self.filling(patience)),
                    ..Figures::default()
                })
            },
            &|| {
                let fidelity = measured(patience, || self.fidelity(patience));
                Ok(Figures {
                    fidelity: fidelity.transpose()?.flatten(),
                    ..Figures::default()
                })
            },
        ];
        let measure = |own: Range<usize>, give: &mut dyn FnMut(Figures)| {
            let figures: Vec<_> = parts[own].par_iter().map(|part| part()).collect();
            figures
                .into_iter()
                .try_for_each(|part| part.map(&mut *give))
        };
        let mut all = Figures::default();
        ranks::share("figures", parts.len(), measure, &mut |part| all.add(part))?;
        Ok(all)
    }

    fn lattice(&self) -> Figures {
        let Some(faces) = self.feature_faces else {
            return Figures::default();
        };
        let (mesh, scene) = (self.mesh, self.scene);
        let at_node = |n: u32| scene.distance.at(mesh.nodes()[n as usize]);
        let (judged, lattice) = rayon::join(
            || report::judged(mesh, faces, scene.extent, at_node),
            || report::lattice(mesh, |x| scene.distance.at(x)),
        );
        Figures {
            judged: Some(judged),
            lattice: Some(lattice),
            ..Figures::default()
        }
    }

    fn filling(&self, patience: &Patience<'_>) -> Check {
        let known = Known {
            neighbors: self.neighbors,
            ..Known::default()
        };
        let (low, high) = ([0.0; D], self.scene.extent);
        check_while(self.mesh, known, low, high, BOX_TOLERANCE, patience)
    }

    fn fidelity(&self, patience: &Patience<'_>) -> Result<Option<Fidelity>> {
        let features: &Features<D> = self.scene.features;
        if features.of_all().points == 0 {
            return Ok(None);
        }
        let reference = Reference::from_features(features);
        let in_samples = in_samples(self.mesh, features);
        report::fidelity_while(&*in_samples, &reference, self.claimed, patience).map(Some)
    }
}

/// The figures of a mesh that is in pieces, as [`Measured::figures`] has those of a whole one, on every member of the
/// group; `judged.cells` are those of this piece. Of the piece, `claimed` and `feature_faces` have a byte for each
/// tetrahedron; of the features, each has a share, and `near` are the points near the piece.
///
/// # Errors
/// Those of [`report::fidelity`] and of the group.
pub(super) fn figures_of_pieces(
    piece: &Piece,
    claimed: Option<&[u8]>,
    feature_faces: &[u8],
    scene: &Scene<'_, 3>,
    near: &[FeaturePoint<3>],
    group: &dyn Group,
    patience: &Patience<'_>,
) -> Result<Figures> {
    let claims = report::Claims::new(&piece.mesh, claimed)?;
    let part = Part::of(piece, group);
    let d = |x: [f64; 3]| scene.distance.at(x);
    let at_node = |n: u32| d(piece.mesh.nodes[n as usize]);
    let judged = report::judged_of_part(&part, feature_faces, scene.extent, &at_node)?;
    let lattice = report::lattice_of_part(&part, d)?;
    let quality = measured_by_all(group, patience, || report::quality_of_part(&part, patience))?;
    let filling = measured_by_all(group, patience, || {
        let (low, high) = ([0.0; 3], scene.extent);
        check_pieces(piece, group, low, high, BOX_TOLERANCE, patience)
    })?;
    let features = scene.features;
    let fidelity = match features.of_all().points {
        0 => None,
        _ => measured_by_all(group, patience, || {
            let reference = Reference::from_share(features, near);
            let in_samples = in_samples(&piece.mesh, features);
            let part = part.with_mesh(&*in_samples);
            report::fidelity_of_part(&part, &reference, claims, patience)
        })?,
    };
    Ok(Figures {
        judged: Some(judged),
        lattice: Some(lattice),
        quality,
        filling,
        fidelity,
    })
}

/// What `measure` gives, if all of the group have patience from before it until after: it asks the others, who must
/// not be left alone.
fn measured_by_all<T>(
    group: &dyn Group,
    patience: &Patience<'_>,
    measure: impl FnOnce() -> Result<T>,
) -> Result<Option<T>> {
    let over = || -> Result<bool> { Ok(group.all("patience", patience.over())?.contains(&true)) };
    if over()? {
        return Ok(None);
    }
    let figures = measure()?;
    Ok((!over()?).then_some(figures))
}

/// What `measure` gives, if `patience` lasts from before it until after.
pub(super) fn measured<T>(patience: &Patience<'_>, measure: impl FnOnce() -> T) -> Option<T> {
    if patience.over() {
        return None;
    }
    let figures = measure();
    (!patience.over()).then_some(figures)
}

/// A mesh in samples of what it follows.
fn in_samples<'a, const D: usize, M: Simplices<D>>(
    mesh: &'a M,
    features: &Features<D>,
) -> Cow<'a, M> {
    scaled(mesh, features.potential.step.map(|s| 1.0 / s))
}

/// A mesh with each axis scaled.
pub fn scaled<const D: usize, M: Simplices<D>>(mesh: &M, scale: [f64; D]) -> Cow<'_, M> {
    if scale == [1.0; D] {
        return Cow::Borrowed(mesh);
    }
    let stretch = |x: &[f64; D]| std::array::from_fn(|k| x[k] * scale[k]);
    Cow::Owned(mesh.with_nodes(mesh.nodes().iter().map(stretch).collect()))
}

#[cfg(test)]
#[path = "measure_tests.rs"]
mod tests;
