//! How features are asked for, and what is refused.

use super::FeatureKind;
use super::LabelOptions;
use super::MissingData;
use super::candidate::Voxel;
use super::detectors::Detector;
use super::detectors::paths::PathSeeds;
use super::volume::Volume;
use crate::error::{Error, Result, cause};
use crate::image::{Image, LiveMask, MaskedImage, Modality};
use crate::parallel::prelude::*;
use std::borrow::Cow;

/// How features are detected.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectionOptions<const D: usize> {
    /// What a feature is.
    pub kind: FeatureKind,
    /// Where the image comes from, if its geometry alone does not tell.
    pub modality: Modality,
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
    /// The largest, where the distance follows gaps between features: then these say how close atoms may
    /// stand ([`Features::spacing`](super::Features::spacing)). `None` where features do not decide it.
    pub gap_d_max: Option<f64>,
    /// Of [`FeatureKind::Labels`]: what is wanted of each.
    pub labels: Vec<LabelOptions>,
    /// Lattice-space distance between samples.
    pub step: [f64; D],
    /// Whether no common null values are recognised, nor traces that are zero throughout.
    pub keep_nulls: bool,
    /// Whether each rank is to have a share of the potential only.
    pub is_distributed: bool,
}

impl<const D: usize> Default for DetectionOptions<D> {
    fn default() -> Self {
        Self {
            kind: FeatureKind::Auto,
            modality: Modality::Unknown,
            scale: None,
            smoothing: None,
            threshold: None,
            weights: [1.0; 2],
            seeds: PathSeeds::default(),
            d_min: 8.0,
            gap_d_max: None,
            labels: Vec::new(),
            step: [1.0; D],
            keep_nulls: false,
            is_distributed: false,
        }
    }
}

impl<const D: usize> DetectionOptions<D> {
    /// Features of one kind, for a lattice whose least nominal distance is `d_min`; else as by default.
    pub fn with_kind(kind: FeatureKind, d_min: f64) -> Self {
        Self {
            kind,
            d_min,
            ..Self::default()
        }
    }
}

impl<const D: usize> DetectionOptions<D> {
    /// The least and the largest distance between atoms, if it follows gaps.
    pub(super) fn gap_distance_range(&self) -> Option<[f64; 2]> {
        self.gap_d_max
            .map(|most| [self.d_min, most.max(self.d_min)])
    }

    /// The least distance between atoms anywhere.
    pub(super) fn min_distance(&self) -> f64 {
        let wishes = self.labels.iter().filter_map(|wish| wish.distance);
        wishes.fold(self.d_min, f64::min)
    }

    /// The distance between atoms where nothing else is: what a feature's size is measured by.
    pub(super) fn d_max(&self) -> f64 {
        self.gap_distance_range()
            .map_or(self.d_min, |[_, most]| most)
    }
}

/// An image as detectors take it: its samples finite, and filled where there are no data.
pub(super) struct PreparedImage<'a, const D: usize> {
    pub image: Cow<'a, Image<D>>,
    /// Which samples hold data, unless all do.
    pub live_mask: Option<LiveMask<D>>,
    /// The share of the samples that hold no data.
    pub missing: Option<MissingData>,
    /// What was found to hold no data, and what becomes of it.
    pub notes: Vec<String>,
}

/// Returns the image as detectors take it.
///
/// # Errors
/// [`Error::Feature`] for impossible wishes, [`Error::Image`] for an image that cannot be searched.
pub(super) fn prepare_image<'a, const D: usize>(
    image: &'a Image<D>,
    asked: &DetectionOptions<D>,
) -> Result<PreparedImage<'a, D>> {
    validate_options(asked)?;
    if !fills_gaps(image, asked.kind, asked.modality) {
        let image = image
            .with_missing_filled()
            .map_or(Cow::Borrowed(image), Cow::Owned);
        let samples = image.as_slice();
        if let Some(i) = first_non_finite(samples) {
            let volume = Volume::new(image.dims(), samples);
            return Err(non_finite_error(volume.coordinates(i), samples[i]));
        }
        return Ok(PreparedImage {
            image,
            live_mask: None,
            missing: None,
            notes: Vec::new(),
        });
    }
    let (image, mut notes) = match image.mark_dead(!asked.keep_nulls)? {
        Some(MaskedImage { image, notes }) => (Cow::Owned(image), notes),
        None => (Cow::Borrowed(image), Vec::new()),
    };
    let Some(live) = image.live_mask()? else {
        return Ok(PreparedImage {
            image,
            live_mask: None,
            missing: None,
            notes,
        });
    };
    let mut image = image.into_owned();
    let dims = image.dims();
    if let Some(samples) = image.samples.as_slice_mut() {
        live.fill(dims, samples, true);
    }
    let [without_features, bridged] = live.gap_shares();
    notes.push(format!(
        "{:.2} % of the samples hold no data: small gaps are bridged ({:.2} %), in the rest \
         ({:.2} %) no features are sought",
        100.0 * (without_features + bridged),
        100.0 * bridged,
        100.0 * without_features
    ));
    Ok(PreparedImage {
        image: Cow::Owned(image),
        live_mask: Some(live),
        missing: Some(MissingData {
            bridged,
            without_features,
        }),
        notes,
    })
}

/// Returns whether gaps in the image are filled where such features are sought: not between labels, where
/// nothing can be put in, nor in what is b(x) itself.
pub(crate) fn fills_gaps<const D: usize>(
    image: &Image<D>,
    kind: FeatureKind,
    modality: Modality,
) -> bool {
    match kind {
        FeatureKind::Labels | FeatureKind::Mask | FeatureKind::Paths | FeatureKind::Potential => {
            false
        }
        FeatureKind::Auto => {
            let modality = modality.or_detect(&image.geometry);
            image.label_evidence(modality).is_none()
        }
        _ => true,
    }
}

/// The error of a sample that is NaN or infinite.
pub(super) fn non_finite_error<const D: usize>(at: [usize; D], value: f32) -> Error {
    Error::Image(cause(
        format!("image sample {at:?}"),
        format!("is {value}"),
        "fill missing samples before meshing",
    ))
}

/// Whether all samples of an image are the same.
pub(super) fn is_constant<const D: usize>(image: &Image<D>) -> bool {
    let samples = image.as_slice();
    let labels = image.labels.as_ref();
    let differ = labels.is_some_and(|labels| labels.values.len() > 1);
    !differ && samples.iter().all(|s| *s == samples[0])
}

/// Refuses an image that has no features of any kind.
pub(super) fn ensure_not_constant<const D: usize>(image: &Image<D>) -> Result<()> {
    if is_constant(image) {
        return Err(Error::Image(cause(
            "image",
            "is constant, so it has no features",
            "check that the right file and data type were read",
        )));
    }
    Ok(())
}

/// Most samples of an image that is searched in memory: what is done there numbers them by 32 bits.
pub(super) const MAX_IN_MEMORY_SAMPLES: usize = u32::MAX as usize;

/// Most samples of an image in which a detector finds features.
pub(super) fn max_samples<const D: usize>(detector: &dyn Detector<D>) -> usize {
    match detector.kind() {
        _ if detector.is_streamable() => Voxel::MAX_COUNT,
        // It numbers them twice.
        FeatureKind::Paths => MAX_IN_MEMORY_SAMPLES / 2,
        _ => MAX_IN_MEMORY_SAMPLES,
    }
}

/// Refuses an image with more samples than can be numbered.
pub(super) fn ensure_sample_count<const D: usize>(dims: [usize; D], most: usize) -> Result<()> {
    let samples = dims
        .iter()
        .fold(1u128, |all, &n| all.saturating_mul(n as u128));
    if samples <= most as u128 && dims.iter().all(|&n| n <= i32::MAX as usize) {
        return Ok(());
    }
    Err(Error::Image(cause(
        "image",
        format!("has {samples} samples ({dims:?}); such features can be found among {most}"),
        "mesh a part of it, or take every other sample",
    )))
}

/// Refuses wishes that no image can meet.
pub(super) fn validate_options<const D: usize>(asked: &DetectionOptions<D>) -> Result<()> {
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
            "omit it for an automatic one",
        );
    }
    Ok(())
}

/// The first sample that is NaN or infinite.
pub(super) fn first_non_finite(samples: &[f32]) -> Option<usize> {
    // Without a way out of the inner loop it runs on many samples at once.
    let broken = |chunk: &[f32]| !chunk.iter().fold(true, |all, s| all & s.is_finite());
    let chunk = samples.par_chunks(4096).position_first(broken)? * 4096;
    let within = samples[chunk..].iter().position(|s| !s.is_finite())?;
    Some(chunk + within)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::feature::{detect, detect_with_cancel, detectors};
    use crate::image::{Geometry, ImageLayers, ImageSource};
    use crate::progress::CancelToken;
    use std::ops::Range;

    #[test]
    fn images_whose_samples_cannot_be_numbered_are_refused() {
        let large = |dims: [usize; 3], kind| {
            let detector = detectors::detector_for::<3>(kind).unwrap();
            ensure_sample_count(dims, max_samples(detector))
        };
        // What finds in layers numbers far more samples than a disk has.
        for kind in [FeatureKind::Ridges, FeatureKind::Horizons] {
            assert!(large([1 << 16; 3], kind).is_ok());
            for dims in [[1 << 16, 1 << 16, (1 << 16) + 1], [usize::MAX; 3]] {
                let error = large(dims, kind).unwrap_err().to_string();
                assert!(error.contains("found among 281474976710656"), "{error}");
            }
            assert!(large([1 << 31, 1, 1], kind).is_err(), "31 bits an axis");
        }
        let labels = |dims| large(dims, FeatureKind::Labels);
        assert!(labels([65_537, 65_535, 1]).is_ok());
        assert!(labels([2048, 2048, 1024]).is_err());
        // Shortest paths run through two copies of the image.
        let paths = |n| large([n, 1 << 16, 1], FeatureKind::Paths);
        assert!(paths((1 << 15) - 1).is_ok() && paths(1 << 15).is_err());
    }

    /// More layers than are searched in memory, of which none can be had.
    struct OversizedLayers(Geometry<3>);

    impl ImageLayers<3> for OversizedLayers {
        fn dims(&self) -> [usize; 3] {
            [2048, 2048, 1024]
        }

        fn geometry(&self) -> &Geometry<3> {
            &self.0
        }

        fn read_rows(&self, _: usize, _: Range<usize>, _: &mut [f32]) -> Result<()> {
            unreachable!("refused before it is read")
        }

        fn load(&self) -> Result<Image<3>> {
            unreachable!("refused before it is loaded")
        }
    }

    #[test]
    fn what_needs_more_in_memory_than_can_be_numbered_is_refused_unread() {
        let layers = OversizedLayers(Geometry::default());
        for kind in [FeatureKind::Labels, FeatureKind::Canny, FeatureKind::Paths] {
            let asked = DetectionOptions::with_kind(kind, 8.0);
            let patience = &CancelToken::never();
            let error =
                detect_with_cancel(ImageSource::Layered(&layers), &asked, patience).unwrap_err();
            assert!(error.to_string().contains("4294967296 samples"), "{error}");
        }
    }

    #[test]
    fn bad_input_is_refused_in_one_line() {
        let (dims, sheets) = (
            [16, 15, 14],
            [ExactSurface::plane([1.0, 0.0, 0.0], [8.0; 3])],
        );
        let image = ridge_image(dims, &sheets, 1.5, 0.1);
        let good = DetectionOptions::with_kind(FeatureKind::Ridges, 4.0);
        let refused = |image: &Image<3>, change: &dyn Fn(&mut DetectionOptions<3>), names: &str| {
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
        let mut labels: Vec<f32> = (0..16 * 15 * 14).map(|i| (i / 2000) as f32).collect();
        labels[16 * 15 * 2 + 16 * 3 + 5] = f32::NAN;
        let broken = Image::new(dims, labels, Geometry::default());
        refused(
            &broken,
            &|asked| asked.kind = FeatureKind::Auto,
            "[5, 3, 2]",
        );
        let empty = Image::new(dims, vec![f32::NAN; 16 * 15 * 14], Geometry::default());
        refused(&empty, &|_| (), "no sample that holds data");
        let flat = Image::new(dims, vec![3.0; 16 * 15 * 14], Geometry::default());
        refused(&flat, &|_| (), "constant");
    }
}
