//! What detection settles on for a whole image, so that a part of it can be treated alike: a local
//! edit looks for features near the edit only, and must find those that the whole image has there.

use serde::{Deserialize, Serialize};

use super::sheets::Open;
use super::{Features, Kind, Options, both, check, empty, follow, refuse_too_many};
use crate::error::{Error, Result, cause};
use crate::image::Image;

/// Scale and thresholds for one kind of feature, found from a whole image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct Settled {
    /// The kind of feature, never [`Kind::Auto`] and only one.
    pub kind: Kind,
    /// Width in samples of the Gaussian under which sheets are sought.
    pub scale: f64,
    /// Strength down to which a sheet is followed.
    pub low: f32,
    /// Strength that a sheet has somewhere.
    pub high: f32,
    /// Least area of a sheet, in square lattice units (in 2-D length).
    pub min_area: f64,
    /// Of labels: the value of a thin mask, whose middle is the feature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<f32>,
}

/// How far (samples) detection looks to either side: beyond this from where a part of an image was
/// cut, the features are those of the whole image.
pub fn reach(settled: &[Settled]) -> usize {
    let reach = |s: &Settled| match s.kind {
        // Averages over windows of 4 samples.
        Kind::Horizons => 14,
        // Normals averaged over 12 samples, on amplitudes balanced over 6, and a plane of 12.
        Kind::Faults => 60,
        _ => (3.0 * s.scale).ceil() as usize + 3,
    };
    settled.iter().map(reach).max().unwrap_or(0)
}

/// Finds the features of a part of an image as [`detect`](super::detect) finds those of the whole,
/// for which it `settled` on scales and thresholds. `open` tells the sides beyond which the image
/// goes on: sheets that reach them are kept however small they are here.
///
/// # Errors
/// Those of [`detect`](super::detect), but that a part may well be constant.
pub fn detect_part<const D: usize>(
    part: &Image<D>,
    options: &Options<D>,
    settled: &[Settled],
    open: &Open<D>,
) -> Result<Features<D>> {
    refuse_too_many(part.dims(), options.kind)?;
    let continued = part.continued();
    let part = continued.as_ref().unwrap_or(part);
    let samples = part.as_slice();
    if samples.iter().all(|s| *s == samples[0]) {
        return Ok(empty(part.dims(), options));
    }
    check(part, options)?;
    if settled.iter().any(|one| one.kind == Kind::Paths) {
        return Err(Error::Feature(cause(
            "feature 'paths'",
            "comes from paths through the whole image and cannot be found again in a part",
            "mesh the image anew",
        )));
    }
    let mut found = Vec::new();
    for one in settled {
        let known = Some((one, open));
        found.push(follow(part, one.kind, options, known, Vec::new())?);
    }
    let mut found = found.into_iter();
    Ok(match (found.next(), found.next()) {
        (Some(first), Some(second)) => both(first, second, options.weights),
        (Some(only), None) => only,
        _ => empty(part.dims(), options),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;

    #[test]
    fn a_constant_part_has_no_features() {
        let part = Image::new([20, 20], vec![3.0; 400], Geometry::default());
        let found = detect_part(&part, &Options::default(), &[], &[[true; 2]; 2]).unwrap();
        assert!(found.points.is_empty() && found.potential.samples.iter().all(|b| *b == 0.0));
    }
}
