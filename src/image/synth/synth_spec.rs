//! The options of `atomesh synth`, as one value.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize};

use super::{Options, SyntheticImage, SyntheticKind, layer_depths, make, make_2d};
use crate::error::cause;
use crate::files::output::check_output;
use crate::image::formats::segy::write_synthetic;
use crate::image::formats::{self, AnyImage, IMAGE_EXTENSIONS};
use crate::option_text::{deserialize_text, serde_as_text};
use crate::{Error, Result};

/// Options of `atomesh synth`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SynthSpec {
    /// Also write the exact distance to the features
    #[arg(long, value_name = "DIST.npy")]
    pub truth: Option<PathBuf>,
    /// Also write the depth of each sample before folding and faulting, which is constant along a
    /// reflector (amplitude and network-amplitude)
    #[arg(long, value_name = "DEPTH.npy")]
    pub layers: Option<PathBuf>,
    /// Number of samples along x, y and z; NX,NY makes a 2-D image
    #[arg(long, value_name = "NX,NY,NZ", default_value_t = Self::default().dims)]
    pub dims: SynthDims,
    /// Number of faults or shells [default: 4; for a network 2 to 6, from its seed]
    #[arg(long, value_name = "N")]
    pub count: Option<usize>,
    /// Ratio of the signal to the rms of the noise; inf for no noise
    #[arg(long, value_name = "RATIO", default_value_t = Self::default().signal_to_noise)]
    #[serde(deserialize_with = "deserialize_ratio")]
    pub signal_to_noise: f64,
    /// Standard deviation of the features' profile, in samples
    #[arg(long, value_name = "SAMPLES", default_value_t = Self::default().width)]
    pub width: f64,
    /// Seed of all random numbers
    #[arg(long, value_name = "N", default_value_t = Self::default().rng_seed)]
    pub rng_seed: u64,
}

impl Default for SynthSpec {
    fn default() -> Self {
        let Options {
            dims,
            seed,
            count,
            signal_to_noise,
            width,
        } = Options::default();
        Self {
            truth: None,
            layers: None,
            dims: SynthDims::Space(dims),
            count,
            signal_to_noise,
            width,
            rng_seed: seed,
        }
    }
}

/// Reads a ratio, which JSON cannot hold as a number if it is infinite.
fn deserialize_ratio<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> std::result::Result<f64, D::Error> {
    deserialize_text(deserializer, [","; 2])
}

/// Number of samples along each axis of a synthetic image, x first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SynthDims {
    /// A 2-D image.
    Plane([usize; 2]),
    /// A 3-D image.
    Space([usize; 3]),
}

impl FromStr for SynthDims {
    type Err = String;

    /// Parses `NX,NY,NZ`, or `NX,NY`: at least two samples along each axis, and at most 2^32 in all.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let refuse = |problem: &str| {
            let remedy = "give two or three whole numbers such as 256,256 or 96,80,64";
            format!("{problem}; {remedy}")
        };
        let numbers: std::result::Result<Vec<usize>, _> =
            text.split(',').map(|word| word.trim().parse()).collect();
        let dims = match text.split(',').count() {
            2 | 3 => numbers.map_err(|_| refuse("is not made of whole numbers"))?,
            count => return Err(refuse(&format!("has {count} values, not 2 or 3"))),
        };
        if dims.iter().any(|&dim| dim < 2) {
            return Err(refuse("has an axis of fewer than 2 samples"));
        }
        let samples = (dims.iter()).try_fold(1_usize, |product, &dim| product.checked_mul(dim));
        // 2^32 samples take 16 GiB; an allocation beyond that would fail without a message.
        if samples.is_none_or(|samples| samples as u64 > 1 << 32) {
            return Err("is more than 2^32 samples; give smaller dimensions".into());
        }
        Ok(match dims[..] {
            [nx, ny, nz] => Self::Space([nx, ny, nz]),
            _ => Self::Plane([dims[0], dims[1]]),
        })
    }
}

impl Display for SynthDims {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plane([nx, ny]) => write!(f, "{nx},{ny}"),
            Self::Space([nx, ny, nz]) => write!(f, "{nx},{ny},{nz}"),
        }
    }
}

serde_as_text!(SynthDims: [","; 2]);

/// Makes an image whose features are known exactly, as `atomesh synth` does. Also writes the files
/// of the options `truth` and `layers`.
///
/// ```
/// use atomesh::image::synth::{SynthSpec, SyntheticKind, synth};
///
/// let spec = SynthSpec { dims: "20,24".parse()?, ..SynthSpec::default() };
/// let image = synth(SyntheticKind::Sphere, &spec)?.into_image::<2>();
/// assert_eq!(image.map(|image| image.dims()), Some([20, 24]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`make`] and [`layer_depths`], and [`Error::Io`](crate::Error::Io) for a
/// file that cannot be written.
pub fn synth(kind: SyntheticKind, spec: &SynthSpec) -> Result<AnyImage> {
    let options = spec.options();
    if let Some(path) = &spec.layers {
        let depths = layer_depths(kind, &options)?;
        match spec.dims {
            SynthDims::Plane(_) => formats::write(path, &depths.flatten())?,
            SynthDims::Space(_) => formats::write(path, &depths)?,
        }
    }
    Ok(match spec.dims {
        SynthDims::Plane(_) => AnyImage::Plane(spec.image(make_2d(kind, &options)?)?.into()),
        SynthDims::Space(_) => AnyImage::Space(spec.image(make(kind, &options)?)?.into()),
    })
}

impl SynthSpec {
    /// Checks that the outputs have the right endings and names of their own.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`](crate::Error::Io) that names the option.
    pub fn check_files(&self, output: &Path) -> Result<()> {
        let endings = [&IMAGE_EXTENSIONS[..], &["sgy"]].concat();
        check_output(output, "--output", &endings, &[])?;
        let mut others = vec![output];
        for (path, option) in [(&self.truth, "--truth"), (&self.layers, "--layers")] {
            if let Some(path) = path {
                check_output(path, option, &["npy"], &others)?;
                others.push(path);
            }
        }
        Ok(())
    }

    /// Writes an image that [`synth`] made, also as a survey (.sgy).
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a survey with two axes, and [`Error::Io`](crate::Error::Io) if the
    /// file cannot be written.
    pub fn write(image: &AnyImage, path: &Path) -> Result<()> {
        match image {
            _ if formats::extension(path) != "sgy" => image.write(path),
            AnyImage::Space(loaded) => write_synthetic(path, &loaded.image),
            AnyImage::Plane(_) => Err(Error::Job(cause(
                format!("--output {}", path.display()),
                "a survey has three axes, and this image has two",
                "give three dimensions, or another ending",
            ))),
        }
    }

    fn options(&self) -> Options {
        Options {
            dims: match self.dims {
                SynthDims::Plane([nx, ny]) => [nx, ny, 1],
                SynthDims::Space(dims) => dims,
            },
            seed: self.rng_seed,
            count: self.count,
            signal_to_noise: self.signal_to_noise,
            width: self.width,
        }
    }

    /// Writes the truth, if it is requested, and returns the image.
    fn image<const D: usize>(&self, made: SyntheticImage<D>) -> Result<crate::image::Image<D>> {
        if let Some(path) = &self.truth {
            made.truth.write(path)?;
        }
        Ok(made.image)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dims_that_overflow_are_refused() {
        assert_eq!("3, 4,5".parse(), Ok(SynthDims::Space([3, 4, 5])));
        for wrong in [
            "4294967296,4294967296,4294967296",
            "1,5,5",
            "3",
            "3,4,5,6",
            "-3,4,5",
            "a,b,c",
        ] {
            assert!(wrong.parse::<SynthDims>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn options_are_read_from_json() {
        let spec: SynthSpec =
            serde_json::from_str(r#"{"dims": [9, 8], "signal-to-noise": "inf", "width": 2}"#)
                .unwrap();
        assert_eq!(spec.dims, SynthDims::Plane([9, 8]));
        assert_eq!(spec.signal_to_noise, f64::INFINITY);
    }

    #[test]
    fn truth_and_layers_are_written_beside_the_image() {
        let folder = tempfile::tempdir().unwrap();
        let [truth, layers] = ["truth.npy", "layers.npy"].map(|name| folder.path().join(name));
        let spec = SynthSpec {
            truth: Some(truth.clone()),
            layers: Some(layers.clone()),
            dims: "20,24,16".parse().unwrap(),
            count: Some(1),
            ..SynthSpec::default()
        };
        let image = synth(SyntheticKind::Amplitude, &spec).unwrap();
        let options = spec.options();
        let expected = make(SyntheticKind::Amplitude, &options).unwrap();
        assert_eq!(image.into_image::<3>().unwrap(), expected.image);
        assert_eq!(
            crate::image::synth::Truth::<3>::read(&truth).unwrap().0,
            expected.truth
        );
        let depths = formats::read_any(&layers, &formats::ReadOptions::default()).unwrap();
        let expected = layer_depths(SyntheticKind::Amplitude, &options).unwrap();
        assert_eq!(depths.into_image::<3>().unwrap().samples, expected.samples);
    }
}
