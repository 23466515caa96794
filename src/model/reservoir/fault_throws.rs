//! Throws of faults: one for all of a fault, or one for each face as `atomesh surface --survey` measures
//! it.

use std::path::Path;

use super::ModelFrame;
use crate::Result;
use crate::files::vtk::VtkFile;
use crate::geometry::{norm, sub};
use crate::model::surface::names::{Selector, SurfaceNames};
use crate::surface_file::vtp::{is_numbered, labelled_rings, surface_name, surface_names};

/// Number of measured faces of which the throw at a place is the mean.
const NEIGHBOURS: usize = 6;
/// Smallest throw in metres. Faces with a smaller one have no fault rock.
pub(super) const MIN_THROW: f64 = 1e-3;

/// A place in the model's metres, and the throw there in metres.
type MeasuredThrow = ([f64; 3], f64);

/// The throws of some faults, in metres.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ThrowSource {
    /// One throw for the faults that the selector selects.
    Constant(Selector, f64),
    /// Faults by name, with places in the model's metres and the throw at each.
    Measured(Vec<(String, Vec<MeasuredThrow>)>),
}

/// Returns the throw of the faults in a file of surfaces (`.vtp`), face by face.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file is damaged, or has no throw of any face.
pub(super) fn read_throws(path: &Path, frame: &ModelFrame) -> Result<ThrowSource> {
    let file = VtkFile::read(path, "PolyData")?;
    let rings = labelled_rings(&file, "Polys", is_numbered(&file)?)?;
    let names = surface_names(&file);
    let data = file.piece()?.child("CellData");
    let mut arrays = data.iter().flat_map(|data| &data.children);
    let array = arrays.find(|array| array.attribute("Name") == Some("throw"));
    let remedy = "measure throw: atomesh surface MESH --survey IMAGE -o FILE.vtp";
    let array = array.ok_or_else(|| file.error("has no array throw", remedy))?;
    let throws = file.array(array)?.values.to_f64();
    let metres = frame.vertical_scale();
    let mut faults: Vec<(String, Vec<MeasuredThrow>)> = Vec::new();
    for ((label, ring), throw) in rings.iter().zip(throws) {
        if !throw.is_finite() || ring.is_empty() {
            continue;
        }
        let name = surface_name(*label, &names);
        let count = ring.len() as f64;
        let centre = std::array::from_fn(|k| ring.iter().map(|p| p[k]).sum::<f64>() / count);
        let place = (frame.to_model(centre), throw * metres);
        match faults.iter_mut().find(|(known, _)| *known == name) {
            Some((_, places)) => places.push(place),
            None => faults.push((name, vec![place])),
        }
    }
    if faults.is_empty() {
        return Err(file.error("has no throw of any face", remedy));
    }
    Ok(ThrowSource::Measured(faults))
}

/// The throw of one fault.
pub(super) enum SurfaceThrow<'a> {
    Constant(f64),
    Measured(&'a [([f64; 3], f64)]),
}

impl SurfaceThrow<'_> {
    /// Returns the throw of a surface; `None` if no source has one. The last source counts.
    pub fn of_surface<'a>(
        sources: &'a [ThrowSource],
        names: &SurfaceNames,
        surface: usize,
    ) -> Option<SurfaceThrow<'a>> {
        sources.iter().rev().find_map(|source| match source {
            ThrowSource::Constant(selector, throw) => selector
                .selects(names, surface)
                .then_some(SurfaceThrow::Constant(*throw)),
            ThrowSource::Measured(faults) => {
                let name = names.names.get(surface)?;
                let found = faults.iter().find(|(known, _)| known == name)?;
                Some(SurfaceThrow::Measured(&found.1))
            }
        })
    }

    /// Returns the throw at a place. Between measured faces, it is the mean of the nearest ones, weighted by
    /// the inverse square of their distances.
    pub fn at(&self, x: [f64; 3]) -> f64 {
        let places = match self {
            Self::Constant(throw) => return *throw,
            Self::Measured(places) => places,
        };
        let mut nearest: Vec<(f64, f64)> = Vec::with_capacity(NEIGHBOURS + 1);
        for (place, throw) in *places {
            let distance = norm(sub(*place, x));
            let index = nearest.partition_point(|(other, _)| *other <= distance);
            if index < NEIGHBOURS {
                nearest.insert(index, (distance, *throw));
                nearest.truncate(NEIGHBOURS);
            }
        }
        let scale = nearest
            .last()
            .map_or(1.0, |entry| entry.0)
            .max(f64::MIN_POSITIVE);
        let (mut sum, mut total) = (0.0, 0.0);
        for (distance, throw) in nearest {
            let weight = 1.0 / ((distance / scale).powi(2) + 1e-6);
            sum += weight * throw;
            total += weight;
        }
        sum / total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_throw_between_measured_faces_is_that_of_the_nearest() {
        let places: Vec<([f64; 3], f64)> = (0..40)
            .map(|i| ([f64::from(i), 0.0, 0.0], 10.0 + f64::from(i)))
            .collect();
        let throw = SurfaceThrow::Measured(&places);
        assert!((throw.at([7.0, 0.0, 0.0]) - 17.0).abs() < 1e-3);
        assert!((throw.at([7.5, 0.0, 0.0]) - 17.5).abs() < 0.1);
        // Beyond what is measured, the throw goes on.
        assert!((throw.at([60.0, 0.0, 0.0]) - 47.0).abs() < 1.0);
    }
}
