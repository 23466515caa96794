//! How features are asked for, and what is refused.

use super::FeatureKind;
use super::detectors::paths::PathSeeds;
use super::volume::Volume;
use crate::error::{Error, Result, cause};
use crate::image::Image;

/// How features are detected.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection<const D: usize> {
    /// What a feature is.
    pub kind: FeatureKind,
    /// Width (samples) of the Gaussian under which derivatives are taken; by kind if `None`.
    pub scale: Option<f64>,
    /// Width (samples) of the structure tensor's window; 4 (horizons) or 12 (faults) if `None`.
    pub smoothing: Option<f64>,
    /// Least strength of a feature, in units of the image; from the image itself if `None`.
    pub threshold: Option<f32>,
    /// Depths, in (0, 1], of the valleys of faults and of horizons where both are followed.
    pub weights: [f64; 2],
    /// What [`FeatureKind::Paths`] knows of the object.
    pub seeds: PathSeeds<D>,
    /// The least nominal distance between atoms, in lattice units: what the lattice resolves.
    pub d_min: f64,
    /// Lattice-space distance between samples.
    pub step: [f64; D],
}

impl<const D: usize> Default for Detection<D> {
    fn default() -> Self {
        Self {
            kind: FeatureKind::Auto,
            scale: None,
            smoothing: None,
            threshold: None,
            weights: [1.0; 2],
            seeds: PathSeeds::default(),
            d_min: 8.0,
            step: [1.0; D],
        }
    }
}

impl<const D: usize> Detection<D> {
    /// Features of one kind, for a lattice whose least nominal distance is `d_min`; else as by default.
    pub fn of(kind: FeatureKind, d_min: f64) -> Self {
        Self {
            kind,
            d_min,
            ..Self::default()
        }
    }
}

/// Refuses impossible wishes and images.
pub(super) fn check<const D: usize>(image: &Image<D>, asked: &Detection<D>) -> Result<()> {
    let positive = |x: f64| x > 0.0 && x.is_finite();
    let fail =
        |what: String, remedy: &str| Err(Error::Feature(cause("feature detection", what, remedy)));
    if !positive(asked.d_min) {
        return fail(
            format!("distance {} is not positive", asked.d_min),
            "give a few samples",
        );
    }
    if !asked.step.iter().all(|&h| positive(h)) {
        return fail(
            format!("step {:?} is not positive", asked.step),
            "give positive steps",
        );
    }
    for (name, value) in [("scale", asked.scale), ("smoothing", asked.smoothing)] {
        if let Some(value) = value
            && !(0.5..=100.0).contains(&value)
        {
            return fail(
                format!("{name} {value} is not in 0.5 .. 100"),
                "give samples, such as 1.5",
            );
        }
    }
    if !asked.weights.iter().all(|w| *w > 0.0 && *w <= 1.0) {
        return fail(
            format!("weights {:?} are not above 0 and at most 1", asked.weights),
            "give depths of valleys such as 1 and 0.5",
        );
    }
    if asked.threshold.is_some_and(|t| !t.is_finite()) {
        return fail(
            "the threshold is not a finite number".into(),
            "leave it out to have it chosen",
        );
    }
    let samples = image.as_slice();
    if let Some(i) = first_not_finite(samples) {
        let volume = Volume {
            dims: image.dims(),
            samples,
        };
        return Err(Error::Image(cause(
            format!("image sample {:?}", volume.coordinates(i)),
            format!("is {}", samples[i]),
            "fill missing samples before meshing",
        )));
    }
    if samples.iter().all(|s| *s == samples[0]) {
        return Err(Error::Image(cause(
            "image",
            "is constant, so it has no features",
            "check that the right file and data type were read",
        )));
    }
    Ok(())
}

/// The first sample that is NaN or infinite.
fn first_not_finite(samples: &[f32]) -> Option<usize> {
    // Without a way out of the inner loop it runs on many samples at once.
    let broken = |chunk: &[f32]| !chunk.iter().fold(true, |all, s| all & s.is_finite());
    let chunk = samples.chunks(4096).position(broken)? * 4096;
    let within = samples[chunk..].iter().position(|s| !s.is_finite())?;
    Some(chunk + within)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::detect;
    use crate::feature::scenes::{Sheet, ridge_image};
    use crate::image::Geometry;

    #[test]
    fn bad_input_is_refused_in_one_line() {
        let (dims, sheets) = ([16, 15, 14], [Sheet::plane([1.0, 0.0, 0.0], [8.0; 3])]);
        let image = ridge_image(dims, &sheets, 1.5, 0.1);
        let good = Detection::of(FeatureKind::Ridges, 4.0);
        let refused = |image: &Image<3>, change: &dyn Fn(&mut Detection<3>), names: &str| {
            let mut asked = good.clone();
            change(&mut asked);
            let message = detect(image, &asked).unwrap_err().to_string();
            assert!(
                !message.contains('\n') && message.contains("; ") && message.contains(names),
                "{names}: {message}"
            );
        };
        refused(&image, &|asked| asked.d_min = 0.0, "distance 0");
        refused(&image, &|asked| asked.step[1] = f64::NAN, "step");
        refused(&image, &|asked| asked.scale = Some(0.1), "scale 0.1");
        refused(
            &image,
            &|asked| asked.smoothing = Some(1e3),
            "smoothing 1000",
        );
        refused(
            &image,
            &|asked| asked.weights[0] = 0.0,
            "weights [0.0, 1.0]",
        );
        refused(
            &image,
            &|asked| asked.threshold = Some(f32::NAN),
            "threshold",
        );
        refused(
            &image,
            &|asked| asked.kind = FeatureKind::Labels,
            "different values",
        );
        let mut samples = image.as_slice().to_vec();
        samples[16 * 15 * 2 + 16 * 3 + 5] = f32::NAN;
        let broken = Image::new(dims, samples, Geometry::default());
        refused(&broken, &|_| (), "[5, 3, 2]");
        let flat = Image::new(dims, vec![3.0; 16 * 15 * 14], Geometry::default());
        refused(&flat, &|_| (), "constant");
    }
}
