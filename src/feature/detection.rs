//! Options of feature detection, and checks of the options and of the image.

use super::FeatureKind;
use super::LabelOptions;
use super::detectors::paths::PathSeeds;
use super::given::SharedPoints;
use super::volume::Volume;
use super::{MIN_FAULT_DIP, MissingData};
use crate::error::{Error, Result, cause};
use crate::image::{Image, LiveMask, MaskedImage, Modality};
use crate::parallel::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Evidence for faults in seismic amplitudes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum FaultEvidence {
    /// The network, or semblance in surveys whose traces are far apart
    #[default]
    Auto,
    /// The probability of a fault by a convolutional network, which was trained on synthetic images
    Network,
    /// Layers that do not continue across a plane: low semblance
    Semblance,
}

/// Options of feature detection.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectionOptions<const D: usize> {
    /// The kind of features to find.
    pub kind: FeatureKind,
    /// Where the image comes from, if its geometry alone does not say.
    pub modality: Modality,
    /// Width (samples) of the Gaussian under which derivatives are taken; the default of the kind
    /// if `None`.
    pub scale: Option<f64>,
    /// Width (samples) of the structure tensor's window; 4 (horizons) or 12 (faults) if `None`.
    pub smoothing: Option<f64>,
    /// Smallest strength of a feature, or lowest value of an isosurface, in units of the image; chosen
    /// from the image if `None`.
    pub threshold: Option<f32>,
    /// Further values of isosurfaces, for [`FeatureKind::Isosurface`].
    pub further_levels: Vec<f32>,
    /// How faults are recognised in seismic amplitudes.
    pub fault_evidence: FaultEvidence,
    /// Smallest dip of a fault in the world, in degrees. Two-way time is converted to depth at 2,000
    /// m/s.
    pub min_dip: f64,
    /// Smallest area of a fault in squares of this many samples (in 2-D its smallest length, in
    /// samples); the default of [`FeatureKind::Faults`] if `None`.
    pub min_fault_size: Option<f64>,
    /// Smallest confidence of a fault or horizon (see [`Confidences`](super::Confidences)); `None` keeps
    /// all.
    pub min_confidence: Option<f64>,
    /// Depths, in (0, 1], of the valleys of faults and of horizons if both are followed.
    pub weights: [f64; 2],
    /// Points of the object and of the background, for [`FeatureKind::Paths`].
    pub seeds: PathSeeds<D>,
    /// Smallest nominal distance between atoms, in lattice units: the resolution of the lattice.
    pub d_min: f64,
    /// Largest distance between atoms, in lattice units, if the distance follows the gaps between
    /// features (see [`Features::spacing`](super::Features::spacing)); `None` if features do not
    /// decide the distance.
    pub gap_d_max: Option<f64>,
    /// Width, in samples, of the filter that smooths the boundaries of labels, which may then lie more than
    /// half a sample beside the samples; `None` for one sample within that bound.
    pub label_smoothing: Option<f64>,
    /// Options for single labels, for [`FeatureKind::Labels`].
    pub labels: Vec<LabelOptions>,
    /// Number of samples below which a connected part of a label joins the labels around it.
    pub min_part: usize,
    /// Distance between samples in lattice space, along each axis.
    pub step: [f64; D],
    /// `true` if common null values and traces that are zero throughout are data.
    pub keep_nulls: bool,
    /// `true` if faults and horizons are searched for in chaotic zones, too.
    pub keep_chaos: bool,
    /// `true` if ridges are searched for at all orientations where surfaces may cross or run close to each
    /// other.
    pub seeks_crossings: bool,
    /// `true` if each rank gets only a share of the potential.
    pub is_distributed: bool,
    /// Surfaces that the user gives.
    pub given: SharedPoints<D>,
}

impl<const D: usize> Default for DetectionOptions<D> {
    fn default() -> Self {
        Self {
            kind: FeatureKind::Auto,
            modality: Modality::Unknown,
            scale: None,
            smoothing: None,
            threshold: None,
            further_levels: Vec::new(),
            fault_evidence: FaultEvidence::default(),
            min_dip: MIN_FAULT_DIP,
            min_fault_size: None,
            min_confidence: None,
            weights: [1.0; 2],
            seeds: PathSeeds::default(),
            d_min: 8.0,
            gap_d_max: None,
            label_smoothing: None,
            labels: Vec::new(),
            min_part: 0,
            step: [1.0; D],
            keep_nulls: false,
            keep_chaos: false,
            seeks_crossings: true,
            is_distributed: false,
            given: None,
        }
    }
}

impl<const D: usize> DetectionOptions<D> {
    /// Returns the default options for features of one kind and a lattice whose smallest nominal
    /// distance is `d_min`.
    pub fn with_kind(kind: FeatureKind, d_min: f64) -> Self {
        Self {
            kind,
            d_min,
            ..Self::default()
        }
    }
}

impl<const D: usize> DetectionOptions<D> {
    /// Returns the smallest and the largest distance between atoms, if the distance follows gaps.
    pub(super) fn gap_distance_range(&self) -> Option<[f64; 2]> {
        self.gap_d_max.map(|max| [self.d_min, max.max(self.d_min)])
    }

    /// Returns the smallest distance between atoms in the whole image, that in single labels
    /// included.
    pub(super) fn min_distance(&self) -> f64 {
        let distances = self.labels.iter().filter_map(|label| label.distance);
        distances.fold(self.d_min, f64::min)
    }

    /// Returns the distance between atoms away from features: the unit in which the size of a
    /// feature is measured.
    pub(super) fn d_max(&self) -> f64 {
        self.gap_distance_range().map_or(self.d_min, |[_, max]| max)
    }
}

/// An image as detectors expect it: all samples are finite, and filled where there are no data.
pub(super) struct PreparedImage<'a, const D: usize> {
    pub image: Cow<'a, Image<D>>,
    /// Mask of the samples that hold data; `None` if all do.
    pub live_mask: Option<LiveMask<D>>,
    /// Shares of the samples that hold no data.
    pub missing: Option<MissingData>,
    /// Lines for the report: which samples hold no data, and what is done about them.
    pub notes: Vec<String>,
}

/// Returns the image as detectors expect it.
///
/// # Errors
/// Returns an [`Error::Feature`] if the options are invalid, and an [`Error::Image`] if the image
/// cannot be searched.
pub(super) fn prepare_image<'a, const D: usize>(
    image: &'a Image<D>,
    options: &DetectionOptions<D>,
) -> Result<PreparedImage<'a, D>> {
    validate_options(options)?;
    if !fills_gaps(image, options.kind, options.modality) {
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
    let (image, mut notes) = match image.mark_dead(!options.keep_nulls)? {
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
         ({:.2} %) no features are searched for",
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

/// Returns `true` if gaps in the image are filled before features of this kind are searched for. They are
/// not filled between labels, where no value makes sense, nor in an image that is b(x) itself.
pub(crate) fn fills_gaps<const D: usize>(
    image: &Image<D>,
    kind: FeatureKind,
    modality: Modality,
) -> bool {
    match kind.detectors::<D>() {
        // The image decides on the kind.
        [] => {
            let modality = modality.or_detect(&image.geometry);
            image.label_evidence(modality).is_none()
        }
        detectors => detectors.iter().all(|detector| detector.fills_gaps()),
    }
}

/// Returns the error of a sample that is NaN or infinite.
pub(super) fn non_finite_error<const D: usize>(at: [usize; D], value: f32) -> Error {
    Error::Image(cause(
        format!("image sample {at:?}"),
        format!("is {value}"),
        "give missing samples a value before meshing",
    ))
}

/// Returns `true` if all samples of an image are the same.
pub(super) fn is_constant<const D: usize>(image: &Image<D>) -> bool {
    let samples = image.as_slice();
    let labels = image.labels.as_ref();
    let labels_differ = labels.is_some_and(|labels| labels.values.len() > 1);
    !labels_differ && samples.iter().all(|s| *s == samples[0])
}

/// Returns an error if the image is constant, so that it has no features of any kind.
pub(super) fn ensure_not_constant<const D: usize>(image: &Image<D>) -> Result<()> {
    if is_constant(image) {
        return Err(Error::Image(cause(
            "image",
            "has the same value everywhere, so that it has no features",
            "check that the right file and data type were read, or give --feature none for a mesh of the plain box",
        )));
    }
    Ok(())
}

/// Largest number of samples of an image that is searched in memory: algorithms in memory index
/// samples by 32 bits.
pub(super) const MAX_IN_MEMORY_SAMPLES: u64 = u32::MAX as u64;

/// Returns an error if the image has more samples than can be indexed.
pub(super) fn ensure_sample_count<const D: usize>(dims: [usize; D], max: u64) -> Result<()> {
    let samples = dims
        .iter()
        .fold(1u128, |product, &n| product.saturating_mul(n as u128));
    if samples <= u128::from(max) && dims.iter().all(|&n| n <= i32::MAX as usize) {
        return Ok(());
    }
    Err(Error::Image(cause(
        "image",
        format!(
            "has {samples} samples ({dims:?}), but these features can be found in at most {max}"
        ),
        "mesh a part of it, or take every other sample",
    )))
}

/// Returns an error if an option is outside its range.
pub(super) fn validate_options<const D: usize>(options: &DetectionOptions<D>) -> Result<()> {
    let positive = |x: f64| x > 0.0 && x.is_finite();
    let fail = |problem: String, remedy: &str| {
        Err(Error::Feature(cause("feature detection", problem, remedy)))
    };
    if !positive(options.d_min) {
        return fail(
            format!("distance {} is not positive", options.d_min),
            "give a few samples",
        );
    }
    if !options.step.iter().all(|&h| positive(h)) {
        return fail(
            format!(
                "the step {:?} between samples is not positive",
                options.step
            ),
            "give positive steps",
        );
    }
    for (name, value) in [
        ("scale", options.scale),
        ("smoothing", options.smoothing),
        ("label smoothing", options.label_smoothing),
    ] {
        if let Some(value) = value
            && !(0.5..=100.0).contains(&value)
        {
            return fail(
                format!("{name} {value} is not in 0.5 .. 100"),
                "give samples, such as 1.5",
            );
        }
    }
    if !(0.0..90.0).contains(&options.min_dip) {
        return fail(
            format!("smallest dip {} is not in 0 .. 90", options.min_dip),
            "give degrees, such as 30",
        );
    }
    if options
        .min_fault_size
        .is_some_and(|size| !(size >= 0.0 && size.is_finite()))
    {
        return fail(
            "the smallest size of a fault is not 0 or more".into(),
            "give samples, such as 20",
        );
    }
    if !options.weights.iter().all(|w| *w > 0.0 && *w <= 1.0) {
        return fail(
            format!(
                "the weights {:?} of features are not above 0 and at most 1",
                options.weights
            ),
            "give weights such as 1 and 0.5",
        );
    }
    let mut thresholds = options.threshold.iter().chain(&options.further_levels);
    if thresholds.any(|t| !t.is_finite()) {
        return fail(
            "the threshold is not a finite number".into(),
            "omit it for an automatic one",
        );
    }
    Ok(())
}

/// Returns the index of the first sample that is NaN or infinite.
pub(super) fn first_non_finite(samples: &[f32]) -> Option<usize> {
    // The inner loop has no early exit, so that the compiler vectorises it.
    let has_non_finite = |chunk: &[f32]| !chunk.iter().fold(true, |all, s| all & s.is_finite());
    let chunk = samples.par_chunks(4096).position_first(has_non_finite)? * 4096;
    let offset = samples[chunk..].iter().position(|s| !s.is_finite())?;
    Some(chunk + offset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::feature::{SharedGrid, detect, detect_with_cancel, detectors};
    use crate::image::{Geometry, ImageLayers, ImageSource};
    use crate::progress::CancelToken;
    use std::ops::Range;

    #[test]
    fn images_with_too_many_samples_are_refused() {
        let check_count = |dims: [usize; 3], kind| {
            let detector = detectors::detector_for::<3>(kind).unwrap();
            ensure_sample_count(dims, detector.max_samples())
        };
        // Detectors that read layers can index far more samples than a disk holds.
        for kind in [FeatureKind::Ridges, FeatureKind::Horizons] {
            assert!(check_count([1 << 16; 3], kind).is_ok());
            for dims in [[1 << 16, 1 << 16, (1 << 16) + 1], [usize::MAX; 3]] {
                let error = check_count(dims, kind).unwrap_err().to_string();
                assert!(
                    error.contains("found in at most 281474976710656"),
                    "{error}"
                );
            }
            assert!(
                check_count([1 << 31, 1, 1], kind).is_err(),
                "31 bits an axis"
            );
        }
        let labels = |dims| check_count(dims, FeatureKind::Labels);
        assert!(labels([65_537, 65_535, 1]).is_ok());
        assert!(labels([2048, 2048, 1024]).is_err());
        // Shortest paths search two copies of the image.
        let paths = |n| check_count([n, 1 << 16, 1], FeatureKind::Paths);
        assert!(paths((1 << 15) - 1).is_ok() && paths(1 << 15).is_err());
    }

    /// An image with more layers than can be searched in memory; reading any of them fails the
    /// test.
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
    fn oversized_in_memory_searches_are_refused_before_reading() {
        let layers = OversizedLayers(Geometry::default());
        for kind in [FeatureKind::Labels, FeatureKind::Canny, FeatureKind::Paths] {
            let options = DetectionOptions::with_kind(kind, 8.0);
            let cancel = &CancelToken::never();
            let source = ImageSource::Layered(&layers);
            let grid = SharedGrid::of_one_process(source.dims());
            let error = detect_with_cancel(source, &options, grid, cancel).unwrap_err();
            assert!(error.to_string().contains("4294967296 samples"), "{error}");
        }
    }

    #[test]
    fn bad_input_is_refused_in_one_line() {
        let (dims, surfaces) = (
            [16, 15, 14],
            [ExactSurface::plane([1.0, 0.0, 0.0], [8.0; 3])],
        );
        let image = ridge_image(dims, &surfaces, 1.5, 0.1);
        let valid = DetectionOptions::with_kind(FeatureKind::Ridges, 4.0);
        let assert_refused =
            |image: &Image<3>, change: &dyn Fn(&mut DetectionOptions<3>), expected: &str| {
                let mut options = valid.clone();
                change(&mut options);
                let message = detect(image, &options).unwrap_err().to_string();
                assert!(
                    !message.contains('\n') && message.contains("; ") && message.contains(expected),
                    "{expected}: {message}"
                );
            };
        assert_refused(&image, &|options| options.d_min = 0.0, "distance 0");
        assert_refused(&image, &|options| options.step[1] = f64::NAN, "step");
        assert_refused(&image, &|options| options.scale = Some(0.1), "scale 0.1");
        assert_refused(
            &image,
            &|options| options.smoothing = Some(1e3),
            "smoothing 1000",
        );
        assert_refused(
            &image,
            &|options| options.weights[0] = 0.0,
            "weights [0.0, 1.0]",
        );
        assert_refused(
            &image,
            &|options| options.threshold = Some(f32::NAN),
            "threshold",
        );
        assert_refused(
            &image,
            &|options| options.kind = FeatureKind::Labels,
            "different values",
        );
        let mut labels: Vec<f32> = (0..16 * 15 * 14).map(|i| (i / 2000) as f32).collect();
        labels[16 * 15 * 2 + 16 * 3 + 5] = f32::NAN;
        let broken = Image::new(dims, labels, Geometry::default());
        assert_refused(
            &broken,
            &|options| options.kind = FeatureKind::Auto,
            "[5, 3, 2]",
        );
        let empty = Image::new(dims, vec![f32::NAN; 16 * 15 * 14], Geometry::default());
        assert_refused(&empty, &|_| (), "no sample that holds data");
        let flat = Image::new(dims, vec![3.0; 16 * 15 * 14], Geometry::default());
        assert_refused(&flat, &|_| (), "the same value everywhere");
    }
}
