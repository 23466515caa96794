//! Input of a detector: the image, the options and the grid whose layers ranks share.

use super::{Detector, Thresholds, faults};
use crate::error::{Error, Result, cause};
use crate::feature::volume::Volume;
use crate::feature::windows::Samples;
use crate::feature::{DetectionOptions, ResolvedOptions, SharedGrid, gaussian};
use crate::image::{Image, ImageSource, LiveMask};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Input of a detector.
#[derive(Debug, Clone, Copy)]
pub struct DetectorInput<'a, const D: usize> {
    /// The image. Its samples are finite and not all the same, and missing traces are filled. It is
    /// in memory, unless the detector [reads layers](Detector::is_streamable).
    pub source: ImageSource<'a, D>,
    /// Mask of the samples that hold data; `None` if all do.
    pub live_mask: Option<&'a LiveMask<D>>,
    /// Options: scale, thresholds, points of an object.
    pub options: &'a DetectionOptions<D>,
    /// Scales and thresholds of the whole image, if this is a part of one.
    pub resolved: Option<&'a ResolvedOptions>,
    /// Cancels the search; the result of a cancelled search is not used.
    pub cancel: &'a CancelToken<'a>,
    /// The grid of the image's samples, whose layers ranks share.
    pub grid: SharedGrid<'a, D>,
}

impl<'a, const D: usize> DetectorInput<'a, D> {
    /// Creates the input for a whole image that one process searches.
    pub fn new(
        source: ImageSource<'a, D>,
        options: &'a DetectionOptions<D>,
        cancel: &'a CancelToken<'a>,
    ) -> Self {
        Self {
            source,
            live_mask: None,
            options,
            resolved: None,
            cancel,
            grid: SharedGrid::of_one_process(source.dims()),
        }
    }

    /// Creates the input for a part of an image whose whole was searched before.
    pub fn for_part(
        image: &'a Image<D>,
        options: &'a DetectionOptions<D>,
        resolved: &'a ResolvedOptions,
        cancel: &'a CancelToken<'a>,
    ) -> Self {
        Self {
            resolved: Some(resolved),
            ..Self::new(ImageSource::InMemory(image), options, cancel)
        }
    }

    /// Returns the number of samples along each axis.
    pub fn dims(&self) -> [usize; D] {
        self.source.dims()
    }

    /// Returns the image in memory.
    ///
    /// # Errors
    /// Returns an [`Error::Feature`] if the image is not in memory.
    pub fn image(&self) -> Result<&'a Image<D>> {
        match self.source {
            ImageSource::InMemory(image) => Ok(image),
            ImageSource::Layered(_) => Err(Error::Feature(cause(
                "feature detection",
                "needs the whole image in memory",
                "allow more memory (--max-memory), or follow ridges, valleys, faults or horizons, which are found layer by layer",
            ))),
        }
    }

    /// Returns the samples in memory.
    ///
    /// # Errors
    /// Returns the errors of [`DetectorInput::image`].
    pub fn volume(&self) -> Result<Volume<'a, D>> {
        Ok(Volume::new(self.dims(), self.image()?.as_slice()))
    }

    /// Returns the samples times `sign`, to be read some layers at a time.
    ///
    /// # Errors
    /// Returns the errors of reading.
    pub fn samples(&self, sign: f32) -> Result<Samples<'a, D>> {
        let samples = match self.source {
            ImageSource::InMemory(image) if sign == 1.0 => {
                Samples::in_memory(image.dims(), image.as_slice())
            }
            ImageSource::InMemory(image) => {
                let signed: Vec<f32> = image.as_slice().par_iter().map(|s| sign * s).collect();
                Samples::in_memory(image.dims(), signed)
            }
            ImageSource::Layered(layers) => {
                return Samples::from_layers(layers, sign)
                    .with_grid(self.grid)
                    .load_if_small();
            }
        };
        Ok(samples.with_grid(self.grid))
    }

    /// Returns the width (samples) of the Gaussian under which derivatives are taken, for detectors
    /// that do not choose it by the noise.
    pub fn scale(&self) -> f64 {
        self.options.scale.unwrap_or(1.0)
    }

    /// Returns the samples smoothed over [`DetectorInput::scale`], to be read some layers at a
    /// time.
    ///
    /// # Errors
    /// Returns the errors of reading.
    pub fn smoothed_in_layers(&self) -> Result<Samples<'a, D>> {
        let mut samples = self.samples(1.0)?;
        samples.smooth(self.scale(), self.cancel);
        Ok(samples)
    }

    /// Returns the samples smoothed over [`DetectorInput::scale`], in memory.
    ///
    /// # Errors
    /// Returns the errors of [`DetectorInput::image`].
    pub fn smoothed(&self) -> Result<Vec<f32>> {
        let samples = self.image()?.as_slice();
        let (mut smoothed, scale) = (vec![0.0; samples.len()], [self.scale(); D]);
        gaussian::smooth_into(self.dims(), samples, &mut smoothed, scale, self.cancel);
        Ok(smoothed)
    }

    /// Returns the thresholds, unless they are to be chosen from the image.
    pub fn thresholds(&self) -> Option<Thresholds> {
        if let Some(resolved) = self.resolved {
            return Some(Thresholds {
                low: resolved.low,
                high: resolved.high,
                origin: "as in the whole image",
            });
        }
        self.options.threshold.map(|high| Thresholds {
            low: 0.5 * high,
            high,
            origin: "given",
        })
    }

    /// Returns the smallest area of a surface in square lattice units (in 2-D the smallest length),
    /// if it must cover `cells` squares of the distance between atoms, or one square of
    /// [`DetectionOptions::min_fault_size`] samples for a fault.
    pub fn min_area(&self, detector: &dyn Detector<D>) -> f64 {
        if let Some(resolved) = self.resolved {
            return resolved.min_area;
        }
        let (dims, options) = (self.dims(), self.options);
        let side = |k: usize| (dims[k] as f64 - 1.0) * options.step[k];
        let section = (0..D)
            .map(|k| (1..D).map(|l| side((k + l) % D)).product())
            .fold(0.0, f64::max);
        let min_area = if detector.is_fault() {
            // Lattice units per sample.
            let unit = options.step.iter().product::<f64>().powf(1.0 / D as f64);
            let area = |size: f64| (size * unit).powi(D as i32 - 1);
            if let Some(size) = options.min_fault_size {
                return area(size);
            }
            area(faults::MIN_FAULT_SIZE)
        } else {
            detector.min_surface_cells() * options.d_max().powi(D as i32 - 1)
        };
        // In a small image, smaller surfaces are large.
        min_area.min(0.25 * section)
    }
}
