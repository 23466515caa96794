//! The verb `feature`: runs only the detection of features.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::{Value, json};

use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{
    IMAGE_EXTENSIONS, check_output, format_dims, path_text, potential_image,
};
use crate::cli::console::Console;
use crate::error::cause;
use crate::feature::{FeatureKind, Features, LineKind, MIN_LENGTH};
use crate::image::formats::InputOptions;
use crate::image::formats::{AnyImage, LoadedImage};
use crate::image::{Geometry, Modality};
use crate::job::MeshSpec;
use crate::job::spec::{FeatureWeights, NominalDistance, PointValue};
use crate::store::write_feature_lines;
use crate::{Error, Result, feature};

/// Arguments of `atomesh feature`.
#[derive(Debug, Args)]
pub struct FeatureArgs {
    /// The image
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// The potential b(x) to write: .vti, .npy, .nrrd, .mha, .nii or .nii.gz; .png in 2-D
    #[arg(short, long, value_name = "OUT.vti")]
    pub output: PathBuf,
    /// Also write the lines (in 2-D points) at which features cross, branch off one another and
    /// end, with the angle and the two feature surfaces: .vtp
    #[arg(long, value_name = "LINES.vtp")]
    pub lines: Option<PathBuf>,
    /// The features to find
    #[arg(long, value_name = "KIND", default_value = "auto")]
    pub feature: FeatureKind,
    /// Nominal distance between atoms, in samples. The valleys of the potential are a quarter as
    /// wide
    #[arg(long, value_name = "D", default_value_t = 8.0)]
    pub distance: f64,
    /// Scale of the features, in samples [default: depends on the kind of feature]
    #[arg(long, value_name = "S")]
    pub sigma: Option<f64>,
    /// Smallest strength of a feature, in units of the feature image; for an isosurface, its value
    /// [default: automatic; it is printed]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub threshold: Option<f32>,
    /// Weights F,H of faults and horizons, each in (0, 1], if both are followed
    #[arg(long, value_name = "F,H", default_value_t)]
    pub feature_weights: FeatureWeights,
    /// A point of the object, in physical coordinates, for --feature paths; may be repeated
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub object: Vec<PointValue>,
    /// A point of the background, for --feature paths; may be repeated [default: the image's
    /// outermost samples]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub background: Vec<PointValue>,
    /// Also write the fraction of paths that passes through each sample, for --feature paths: .vti,
    /// .npy, .nrrd, .mha, .nii or .png
    #[arg(long, value_name = "OUT.png")]
    pub confidence_out: Option<PathBuf>,
    /// Seed of the random numbers, for --feature paths
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub rng_seed: u64,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// Runs the verb.
pub fn feature(args: &FeatureArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "--output", &IMAGE_EXTENSIONS, &[&args.image])?;
    if let Some(path) = &args.lines {
        check_output(path, "--lines", &["vtp"], &[&args.image, &args.output])?;
    }
    if let Some(path) = &args.confidence_out {
        check_output(
            path,
            "--confidence-out",
            &IMAGE_EXTENSIONS,
            &[&args.image, &args.output],
        )?;
        if args.feature != FeatureKind::Paths {
            return Err(Error::Job(cause(
                "--confidence-out",
                "applies to --feature paths only",
                "add --feature paths, or omit it",
            )));
        }
    }
    match console.read_image(&args.image, &args.input)? {
        AnyImage::Plane(loaded) => detect_features(args, loaded, console),
        AnyImage::Space(loaded) => detect_features(args, loaded, console),
    }
}

fn detect_features<const D: usize>(
    args: &FeatureArgs,
    loaded: LoadedImage<D>,
    console: &mut Console,
) -> Result<()> {
    let spec = MeshSpec {
        distance: NominalDistance::Constant(args.distance),
        feature: args.feature,
        sigma: args.sigma,
        threshold: args.threshold,
        feature_weights: args.feature_weights,
        object: args.object.clone(),
        background: args.background.clone(),
        rng_seed: args.rng_seed,
        input: args.input.clone(),
        ..MeshSpec::default()
    };
    spec.validate().map_err(with_option_name::<MeshSpec>)?;
    let mut options = spec
        .detection_options([1.0; D])
        .map_err(with_option_name::<MeshSpec>)?;
    options.modality = Modality::detect(loaded.format, &loaded.image.geometry);
    for note in &loaded.notes {
        console.note(note);
    }
    loaded.image.check(&args.image.display().to_string())?;
    console.begin_stage("finding features");
    let features = feature::detect(&loaded.image, &options)?;
    let potential = potential_image(features.potential.to_dense(), &loaded.image.geometry);
    if let (Some(path), Some(confidence)) = (&args.confidence_out, &features.confidence) {
        console.write_image(
            path,
            potential_image(confidence.clone(), &loaded.image.geometry),
        )?;
    }
    let lines = match &args.lines {
        Some(path) => Some(write_lines(path, &features, &loaded.image.geometry)?),
        None => None,
    };
    let dims = potential.dims().to_vec();
    console.write_image(&args.output, potential)?;
    let path = args.output.display();
    console.result(
        format_args!(
            "{}\nwrote {path}: {} samples{}",
            features.notes.join("\n"),
            format_dims(&dims),
            lines
                .as_ref()
                .map_or_else(String::new, |lines| lines.text.clone()),
        ),
        &json!({
            "file": path_text(&args.output),
            "dims": dims,
            "points": features.points.len(),
            "sigma": features.sigma,
            "notes": features.notes,
            "lines": lines.map(|lines| lines.json),
        }),
    );
    Ok(())
}

/// The report on lines that were written.
struct LinesSummary {
    text: String,
    json: Value,
}

/// Writes the lines at which features meet and end.
fn write_lines<const D: usize>(
    path: &Path,
    features: &Features<D>,
    geometry: &Geometry<D>,
) -> Result<LinesSummary> {
    let lines = feature::lines(features)?;
    // The lattice space of this verb has a step of one sample.
    write_feature_lines(path, &lines, |x| geometry.to_physical(x))?;
    let summarise = |kind: LineKind| {
        let lines = lines.iter().filter(move |line| line.kind == kind);
        let (count, length) = lines.fold((0, 0.0), |(count, length), line| {
            (count + 1, length + line.length)
        });
        let shown = match D {
            2 => format!("{count}"),
            _ => format!("{count} ({length:.0} samples long)"),
        };
        (shown, json!({ "count": count, "length": length }))
    };
    let [crossings, branches, tips] =
        [LineKind::Crossing, LineKind::Branch, LineKind::Tip].map(summarise);
    let omitted = match D {
        2 => String::new(),
        _ => format!("; lines shorter than {MIN_LENGTH:.0} samples are omitted"),
    };
    Ok(LinesSummary {
        text: format!(
            "\nwrote {}: crossings {}, branches {}, tips {}{omitted}",
            path.display(),
            crossings.0,
            branches.0,
            tips.0,
        ),
        json: json!({
            "file": path_text(path),
            "crossings": crossings.1,
            "branches": branches.1,
            "tips": tips.1,
        }),
    })
}
