//! What the user typed, nothing checked yet beyond its shape.
//!
//! The options of `mesh` exist three times as the same type, [`MeshOptions`]: the defaults, the
//! configuration file and the command line. [`MeshOptions::over`] lays one over the other.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use serde::{Deserialize, Deserializer, Serialize};

use crate::error::cause;
use crate::feature;
use crate::image::formats::{ReadOptions, SegyBytes};
use crate::improve::plane::relax::Scheme;
use crate::{Error, Result};

/// `atomesh --version`: the licence of the binary depends on what is linked into it.
fn version() -> &'static str {
    match (cfg!(feature = "tetgen"), cfg!(feature = "cgal")) {
        (true, true) => concat!(
            env!("CARGO_PKG_VERSION"),
            "\nOwn sources: MIT OR Apache-2.0. Linked with TetGen (AGPL-3.0) and CGAL's triangulations",
            "\n(GPL-3.0), so this program as a whole is AGPL-3.0. `--no-default-features` builds one",
            "\nwithout them, which makes no 3-D mesh."
        ),
        (true, false) => concat!(
            env!("CARGO_PKG_VERSION"),
            "\nOwn sources: MIT OR Apache-2.0. Linked with TetGen (AGPL-3.0), so this program as a",
            "\nwhole is AGPL-3.0. `--no-default-features` builds one without it, which makes no 3-D mesh."
        ),
        (false, true) => concat!(
            env!("CARGO_PKG_VERSION"),
            "\nOwn sources: MIT OR Apache-2.0. Linked with CGAL's triangulations (GPL-3.0), so this",
            "\nprogram as a whole is GPL-3.0. Built without TetGen: it makes no 3-D mesh."
        ),
        (false, false) => concat!(
            env!("CARGO_PKG_VERSION"),
            "\nMIT OR Apache-2.0. Built without TetGen: this program makes no 3-D mesh."
        ),
    }
}

/// The whole command line.
#[derive(Debug, Parser)]
#[command(
    name = "atomesh",
    version = version(),
    about = "Images, above all seismic volumes, straight to feature-aligned meshes",
    propagate_version = true,
    arg_required_else_help = true
)]
pub struct CommandLine {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
    /// Options that every verb has.
    #[command(flatten)]
    pub common: Common,
}

/// Options that every verb has.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Print nothing but errors (and the JSON, if asked for)
    #[arg(long, global = true, display_order = 900)]
    pub quiet: bool,
    /// Print the result as JSON on standard output
    #[arg(long, global = true, display_order = 900)]
    pub json: bool,
    /// Number of threads; all processors by default. The result does not depend on it
    #[arg(long, global = true, value_name = "N", display_order = 900)]
    pub threads: Option<usize>,
}

/// One verb each.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Image in, aligned mesh out (the main job)
    #[command(after_help = "Example:\n  atomesh mesh survey.sgy -o mesh.vtu --distance 8")]
    Mesh(Box<MeshArgs>),
    /// Only the image processing: writes the potential b(x)
    #[command(after_help = "Example:\n  atomesh feature faults.npy -o potential.vti --sigma 2")]
    Feature(FeatureArgs),
    /// What a file holds: dims, geometry, units, range, traces, missing data
    #[command(after_help = "Example:\n  atomesh info survey.sgy")]
    Info(InfoArgs),
    /// From one image format to another
    #[command(after_help = "Example:\n  atomesh convert survey.sgy survey.vti")]
    Convert(ConvertArgs),
    /// Quality and fidelity figures of a mesh
    #[command(after_help = "Example:\n  atomesh quality mesh.vtu --truth distance.npy")]
    Quality(QualityArgs),
    /// Checks a mesh by our own checker, TetGen and CGAL; says which passed
    #[command(after_help = "Example:\n  atomesh validate mesh.vtu")]
    Validate(ValidateArgs),
    /// Steady flow from sources to sinks, with faults closed, open, or in between
    #[command(
        after_help = "Example:\n  atomesh flow mesh.vtu --source 20,30,40 --sink 80,60,50 -o flow.vtu --streamlines lines.vtp"
    )]
    Flow(FlowArgs),
    /// Adds, moves and removes atoms of a mesh; only their neighbourhood changes
    #[command(
        after_help = "Example:\n  atomesh edit mesh.vtu survey.sgy -o edited.vtu --add 1500,2000,300 --remove 812"
    )]
    Edit(crate::cli::verbs::edit::EditArgs),
    /// Columns: the Voronoi cells of a map, drawn down through layers between horizons
    #[command(
        after_help = "Example:\n  atomesh columns map.vtu --horizon top.npy --horizon base.npy --layers 5 -o cells.vtu"
    )]
    Columns(crate::cli::verbs::columns::ColumnsArgs),
    /// A mesh for a reservoir simulator, or for another mesher
    #[command(
        after_help = "Example:\n  atomesh export cells.vtu --to opm -o CASE.DATA --porosity 0.2 --permeability 100 --permeability-unit mD --depth-at-top 2000"
    )]
    Export(Box<crate::cli::verbs::export::ExportArgs>),
    /// A picture of the mesh over its image: in 3-D its sections with three orthogonal planes
    #[command(after_help = "Example:\n  atomesh slice survey.sgy mesh.vtu -o sections.png")]
    Slice(SliceArgs),
    /// Faces on features, grouped into labelled surfaces: faults, horizons
    #[command(after_help = "Example:\n  atomesh surface mesh.vtu -o faults.vtp")]
    Surface(crate::cli::verbs::surface::SurfaceArgs),
    /// Paints cells from seeds, within layers but not across surfaces
    #[command(
        after_help = "Example:\n  atomesh paint mesh.vtu --seed 40,50,60 --seed 90,50,60 -o painted.vtu"
    )]
    Paint(crate::cli::verbs::paint::PaintArgs),
    /// Object and background by a minimum cut on the cells of a mesh
    #[command(
        after_help = "Example:\n  atomesh segment image.nrrd mesh.vtu --object 60,60,60 --background 5,5,5 -o segmented.vtu"
    )]
    Segment(crate::cli::verbs::segment::SegmentArgs),
    /// Synthetic volumes whose features are known exactly
    #[command(
        after_help = "Example:\n  atomesh synth faults -o faults.vti --truth distance.npy --dims 170,150,128"
    )]
    Synth(SynthArgs),
}

/// How to read an image whose file does not say it all.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct InputOptions {
    /// The file is bare samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g. 100x400x208:f32be
    #[arg(long, value_name = "DIMS:TYPE")]
    pub raw: Option<String>,
    /// SEG-Y: trace header byte of the inline number [default: 189]
    #[arg(long, value_name = "BYTE")]
    pub inline_byte: Option<usize>,
    /// SEG-Y: trace header byte of the crossline number [default: 193]
    #[arg(long, value_name = "BYTE")]
    pub crossline_byte: Option<usize>,
    /// SEG-Y: trace header byte of the x coordinate [default: 181]
    #[arg(long, value_name = "BYTE")]
    pub x_byte: Option<usize>,
    /// SEG-Y: trace header byte of the y coordinate [default: 185]
    #[arg(long, value_name = "BYTE")]
    pub y_byte: Option<usize>,
    /// SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    #[arg(long, value_name = "BYTE")]
    pub scalar_byte: Option<usize>,
    /// SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    #[arg(long, value_name = "BYTE")]
    pub delay_byte: Option<usize>,
    /// SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    #[arg(long, value_name = "BYTE")]
    pub interval_byte: Option<usize>,
}

impl InputOptions {
    /// What the reader is told.
    ///
    /// # Errors
    /// [`Error::Job`] if `--raw` cannot be understood or a byte lies outside a trace header.
    pub fn read_options(&self) -> Result<ReadOptions> {
        let standard = SegyBytes::default();
        let segy = SegyBytes {
            inline: self.inline_byte.unwrap_or(standard.inline),
            crossline: self.crossline_byte.unwrap_or(standard.crossline),
            x: self.x_byte.unwrap_or(standard.x),
            y: self.y_byte.unwrap_or(standard.y),
            scalar: self.scalar_byte.unwrap_or(standard.scalar),
            delay: self.delay_byte.unwrap_or(standard.delay),
            dt: self.interval_byte.unwrap_or(standard.dt),
        };
        let refuse = |place: String, fault: String| {
            let (problem, remedy) = fault.split_once("; ").unwrap_or((&fault, "see --help"));
            Error::Job(cause(place, problem, remedy))
        };
        segy.check()
            .map_err(|fault| refuse("SEG-Y header bytes".into(), fault))?;
        let raw = match &self.raw {
            Some(text) => Some(
                text.parse()
                    .map_err(|fault| refuse(format!("--raw {text}"), fault))?,
            ),
            None => None,
        };
        Ok(ReadOptions { raw, segy })
    }
}

/// Which features of the image the mesh shall follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureChoice {
    /// Picked by what the image looks like; the report says what was picked
    Auto,
    /// Bright sheets: fault images, fractures, membranes
    Ridges,
    /// Dark sheets
    Valleys,
    /// Steps of brightness
    Edges,
    /// Steps of brightness, by non-maximum suppression and hysteresis
    Canny,
    /// The boundary of an object, by random shortest paths (2-D; needs --object)
    Paths,
    /// Peaks and troughs of seismic amplitude along the bedding's normal
    Horizons,
    /// Where the layers of seismic amplitude do not continue
    Faults,
    /// Both, each with its weight
    #[value(name = "faults+horizons")]
    #[serde(rename = "faults+horizons")]
    FaultsAndHorizons,
    /// Interfaces between labels, or the rim of a mask
    Labels,
    /// The image is b(x) already: -1 on features, 0 elsewhere
    Potential,
}

impl From<FeatureChoice> for feature::FeatureKind {
    fn from(choice: FeatureChoice) -> Self {
        match choice {
            FeatureChoice::Auto => Self::Auto,
            FeatureChoice::Ridges => Self::Ridges,
            FeatureChoice::Valleys => Self::Valleys,
            FeatureChoice::Edges => Self::Edges,
            FeatureChoice::Canny => Self::Canny,
            FeatureChoice::Paths => Self::Paths,
            FeatureChoice::Horizons => Self::Horizons,
            FeatureChoice::Faults => Self::Faults,
            FeatureChoice::FaultsAndHorizons => Self::FaultsAndHorizons,
            FeatureChoice::Labels => Self::Labels,
            FeatureChoice::Potential => Self::Potential,
        }
    }
}

/// How atoms are placed before they move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SeedingChoice {
    /// A regular lattice fitted to the box: face-centred cubic, triangular in 2-D
    Fcc,
    /// A regular lattice grown from fixed atoms (wells) and the sides of the box
    Grown,
    /// Delaunay refinement: isotropic
    Refine,
    /// On features, dense where they bend; few elsewhere. Image and features decide the distance
    Canny,
    /// Drawn by chance under the image, where its features are first (guide tables)
    Guide,
    /// Sites of a fine lattice projected onto features
    Projection,
}

/// How atoms are moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OptimizerChoice {
    /// Limited-memory BFGS (fast)
    Lbfgs,
    /// Steepest descent
    Descent,
    /// A genetic algorithm: a population of ten lattices (slow)
    Genetic,
}

impl From<OptimizerChoice> for crate::lattice::optimize::Method {
    fn from(choice: OptimizerChoice) -> Self {
        match choice {
            OptimizerChoice::Lbfgs => Self::Lbfgs,
            OptimizerChoice::Descent => Self::Descent,
            OptimizerChoice::Genetic => Self::Genetic,
        }
    }
}

/// Which evaluator of the lattice energy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PotentialChoice {
    /// Neighbour lists and exact gradients (fast)
    Pairwise,
    /// Accumulated on the image's grid, as published in 2001 (slow)
    Sampled,
}

/// How slivers are removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SliverChoice {
    /// Feature-keeping flips and smoothing
    Joe,
    /// Weights (CGAL's exudation, slow); the report compares both; 3-D only
    Exude,
    /// The bare Delaunay triangulation
    None,
}

/// How a triangulation is smoothed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SmoothChoice {
    /// Centroidal: each node to the weighted centroid of the triangles around it
    Cvt,
    /// Optimal Delaunay: half as far again
    Odt,
}

impl From<SmoothChoice> for Scheme {
    fn from(choice: SmoothChoice) -> Self {
        match choice {
            SmoothChoice::Cvt => Self::Cvt,
            SmoothChoice::Odt => Self::Odt,
        }
    }
}

/// Where atoms end up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AlignChoice {
    /// On features, which tetrahedra's faces then follow
    On,
    /// Beside features, which the faces of Voronoi cells then follow
    Alongside,
}

/// What the mesh is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CellsChoice {
    /// Tetrahedra; triangles in 2-D
    #[value(alias = "triangles")]
    Tets,
    /// Voronoi cells (PEBI): polyhedra; polygons in 2-D
    #[value(alias = "pebi")]
    Voronoi,
}

/// `atomesh mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// The image: SEG-Y, .npy, .vti, .nrrd, .mha, .nii, .tif, .inr, .png (2-D), or bare samples with --raw
    #[arg(value_name = "IMAGE", required_unless_present = "print_config")]
    pub image: Option<PathBuf>,
    /// The job's options.
    #[command(flatten)]
    pub options: MeshOptions,
    /// Options from a TOML file; those typed here win
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Print the effective options as TOML and stop
    #[arg(long)]
    pub print_config: bool,
}

/// The options of `mesh` that a configuration file can hold.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct MeshOptions {
    /// The mesh to write [default: the image's name with .vtu, in this folder]
    #[arg(short, long, value_name = "MESH.vtu")]
    pub output: Option<PathBuf>,
    /// Nominal distance between atoms, in samples; or MIN:MAX with --distance-from [default: 8]
    #[arg(long, value_name = "D")]
    #[serde(deserialize_with = "text_or_number")]
    pub distance: Option<String>,
    /// What a distance MIN:MAX follows: features (MIN on them, growing away from them), image (MIN
    /// where it is lowest, MAX where it is highest), laplacian (of the potential), or a file with a
    /// distance per sample
    #[arg(long, value_name = "WHAT")]
    pub distance_from: Option<String>,
    /// The features to follow [default: auto]
    #[arg(long, value_name = "KIND")]
    pub feature: Option<FeatureChoice>,
    /// Scale of the features in samples [default: by the kind of feature]
    #[arg(long, value_name = "S")]
    pub sigma: Option<f64>,
    /// Least strength of a feature, in units of the feature image [default: automatic, printed]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub threshold: Option<f32>,
    /// Weights F,H in (0, 1] of faults and horizons where both are followed [default: 1,1]
    #[arg(long, value_name = "F,H")]
    pub feature_weights: Option<String>,
    /// Paths: a point of the object, in physical coordinates; may be repeated
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub object: Option<Vec<String>>,
    /// Paths: a point of the background; may be repeated [default: the image's outermost samples]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub background: Option<Vec<String>>,
    /// Keep the potential b(x)
    #[arg(long, value_name = "FILE.vti")]
    pub potential_out: Option<PathBuf>,
    /// Atoms on features, or alongside [default: on; alongside with --cells voronoi]
    #[arg(long, value_name = "WHERE")]
    pub align: Option<AlignChoice>,
    /// Cells of the mesh [default: tets; voronoi with --align alongside]
    #[arg(long, value_name = "KIND")]
    pub cells: Option<CellsChoice>,
    /// Weight of the image against the lattice in [0, 1]: a number, or an image file [default: 0.5]
    #[arg(long, value_name = "B")]
    #[serde(deserialize_with = "text_or_number")]
    pub beta: Option<String>,
    /// How atoms are placed at first [default: fcc]
    #[arg(long, value_name = "HOW")]
    pub seeding: Option<SeedingChoice>,
    /// Most atoms that --seeding guide places [default: as many as find room]
    #[arg(long, value_name = "N")]
    pub max_atoms: Option<usize>,
    /// Fixed atoms (wells, sources): a CSV file of x,y,z (x,y in 2-D) in the image's physical coordinates
    #[arg(long, value_name = "FILE.csv")]
    pub atoms_from: Option<PathBuf>,
    /// A well: fixed atoms along the way in a CSV file of lines x,y,z,radius (x,y,radius in 2-D), in the
    /// image's physical coordinates; may be repeated
    #[arg(long, value_name = "FILE.csv")]
    pub well: Option<Vec<PathBuf>>,
    /// Distance between atoms at wells, in samples, from where it grows to --distance
    #[arg(long, value_name = "D")]
    pub well_distance: Option<f64>,
    /// Evaluator of the lattice energy [default: pairwise]
    #[arg(long, value_name = "HOW")]
    pub potential: Option<PotentialChoice>,
    /// Weight in [0, 1] of the energy between atoms against their Laplacian coordinates, which make the
    /// lattice more regular; 0.7 is usual with them [default: 1, without]
    #[arg(long, value_name = "K")]
    pub kappa: Option<f64>,
    /// How atoms are moved [default: lbfgs]
    #[arg(long, value_name = "HOW")]
    pub optimizer: Option<OptimizerChoice>,
    /// Number of first passes on a smoother potential [default: 0]
    #[arg(long, value_name = "N")]
    pub coarse_to_fine: Option<usize>,
    /// Smallest dihedral angle aimed at, in degrees, the largest being 180 minus it; in 2-D the
    /// smallest angle [default: 30]
    #[arg(long, value_name = "DEGREES")]
    pub min_dihedral: Option<f64>,
    /// How slivers are removed [default: joe]
    #[arg(long, value_name = "HOW")]
    pub slivers: Option<SliverChoice>,
    /// Voronoi cells without their smallest faces: nodes nearer to one another than this share of the
    /// cells' radius are welded [default: 0]
    #[arg(long, value_name = "SHARE")]
    pub weld: Option<f64>,
    /// Smooth the triangles of a 2-D image where it is even; nodes on features stay
    #[arg(long, value_name = "HOW")]
    pub smooth: Option<SmoothChoice>,
    /// Lattice space: samples, physical, or a scale per axis SX,SY,SZ (SX,SY in 2-D) [default: samples]
    #[arg(long, value_name = "SPACE")]
    pub metric: Option<String>,
    /// Seed of the random perturbations [default: 1]
    #[arg(long, value_name = "N")]
    pub rng_seed: Option<u64>,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Write the lattice after each round, for ParaView
    #[arg(long, value_name = "FILE.pvd")]
    pub trace: Option<PathBuf>,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

impl MeshOptions {
    /// The options of a job for which nothing was typed. What is absent here is found from the
    /// image: the threshold, the feature scale, the name of the output.
    pub fn defaults() -> Self {
        Self {
            distance: Some("8".into()),
            feature: Some(FeatureChoice::Auto),
            beta: Some("0.5".into()),
            seeding: Some(SeedingChoice::Fcc),
            potential: Some(PotentialChoice::Pairwise),
            kappa: Some(1.0),
            optimizer: Some(OptimizerChoice::Lbfgs),
            coarse_to_fine: Some(0),
            min_dihedral: Some(30.0),
            slivers: Some(SliverChoice::Joe),
            weld: Some(0.0),
            metric: Some("samples".into()),
            rng_seed: Some(1),
            ..Self::default()
        }
    }

    /// As TOML, all that decides the result, and nothing of where it is written.
    ///
    /// # Errors
    /// [`Error::Job`] if a path is no UTF-8.
    pub fn reproducible(&self) -> Result<String> {
        let outputs = Self {
            output: None,
            report: None,
            trace: None,
            potential_out: None,
            ..self.clone()
        };
        outputs.to_toml()
    }

    /// As a configuration file holds them.
    ///
    /// # Errors
    /// [`Error::Job`] if a path is no UTF-8.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self)
            .map_err(|e| Error::Job(cause("options", e, "use file names that are valid UTF-8")))
    }

    /// These options, and those of `below` where these are silent.
    ///
    /// # Errors
    /// [`Error::Job`] if an option cannot be written as TOML (a path that is no UTF-8).
    pub fn over(&self, below: &Self) -> Result<Self> {
        let table = |options: &Self| {
            toml::Table::try_from(options)
                .map_err(|e| Error::Job(cause("options", e, "use file names that are valid UTF-8")))
        };
        let mut merged = table(below)?;
        for (key, value) in table(self)? {
            match (merged.get_mut(&key), value) {
                (Some(toml::Value::Table(lower)), toml::Value::Table(upper)) => lower.extend(upper),
                (_, value) => {
                    merged.insert(key, value);
                }
            }
        }
        merged.try_into().map_err(|e: toml::de::Error| {
            Error::Job(cause("options", e.message(), "see atomesh mesh --help"))
        })
    }
}

/// `atomesh feature`.
#[derive(Debug, Args)]
pub struct FeatureArgs {
    /// The image
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// The potential b(x), as .vti or .npy; .png in 2-D
    #[arg(short, long, value_name = "OUT.vti")]
    pub output: PathBuf,
    /// The features to find
    #[arg(long, value_name = "KIND", default_value = "auto")]
    pub feature: FeatureChoice,
    /// Nominal distance between atoms, in samples: the potential's valleys are a quarter as wide
    #[arg(long, value_name = "D", default_value_t = 8.0)]
    pub distance: f64,
    /// Scale of the features in samples [default: by the kind of feature]
    #[arg(long, value_name = "S")]
    pub sigma: Option<f64>,
    /// Least strength of a feature, in units of the feature image [default: automatic, printed]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub threshold: Option<f32>,
    /// Weights F,H in (0, 1] of faults and horizons where both are followed [default: 1,1]
    #[arg(long, value_name = "F,H")]
    pub feature_weights: Option<String>,
    /// Paths: a point of the object, in physical coordinates; may be repeated
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub object: Vec<String>,
    /// Paths: a point of the background; may be repeated [default: the image's outermost samples]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub background: Vec<String>,
    /// Paths: write the share of them that passes each sample, as .vti, .npy or .png
    #[arg(long, value_name = "OUT.png")]
    pub confidence_out: Option<PathBuf>,
    /// Paths: seed of the random points
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub rng_seed: u64,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// `atomesh info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// An image or a mesh
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// `atomesh convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// The image to read
    #[arg(value_name = "IN")]
    pub input_file: PathBuf,
    /// The image to write: .vti or .npy; .png in 2-D
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// `atomesh quality`.
#[derive(Debug, Args)]
pub struct QualityArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// Exact distance to the features, as `synth --truth` writes it
    #[arg(long, value_name = "DIST.npy")]
    pub truth: Option<PathBuf>,
}

/// `atomesh validate`.
#[derive(Debug, Args)]
pub struct ValidateArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
}

/// `atomesh flow`.
#[derive(Debug, Args)]
pub struct FlowArgs {
    /// A mesh written by atomesh; its coordinates are taken for metres
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, torn along faults, with pressure (Pa) and Darcy velocity (m/s)
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// A point (X,Y in 2-D) where fluid enters, with its rate in m^3/s [default: 0.001]; may be
    /// repeated
    #[arg(long, value_name = "X,Y,Z[:RATE]", allow_hyphen_values = true)]
    pub source: Vec<String>,
    /// A point where fluid leaves [default rate: all that comes in, or 0.001 with --pressure]
    #[arg(long, value_name = "X,Y,Z[:RATE]", allow_hyphen_values = true)]
    pub sink: Vec<String>,
    /// Pressure (Pa) of a side of the box: xmin, xmax, ymin ..., the image's axes, x the fastest in
    /// memory. Sides without one let nothing through
    #[arg(long, value_name = "SIDE=P")]
    pub pressure: Vec<String>,
    /// How faults resist flow across them: closed, open, or the factor, from 0 to 1, of the
    /// permeability there [default: closed]
    #[arg(long, value_name = "HOW", allow_hyphen_values = true)]
    pub faults: Option<String>,
    /// Thickness (m) of the layer that the factor of --faults is for [default: from cell to cell]
    #[arg(long, value_name = "W")]
    pub fault_thickness: Option<f64>,
    /// The factor of one fault, by the number that `atomesh surface MESH` gives it; may be repeated;
    /// or a CSV file of lines surface,factor[,thickness]
    #[arg(long, value_name = "N:FACTOR", allow_hyphen_values = true)]
    pub fault_multiplier: Vec<String>,
    /// The surfaces that --faults is for: faults, horizons, all, or numbers N,N,... Others are open
    #[arg(long, value_name = "WHICH", default_value = "faults")]
    pub barriers: String,
    /// Permeability in m^2 (1 mD is 9.87e-16 m^2): K; KX,KY,KZ; KXX,KYY,KZZ,KXY,KYZ,KXZ (in 2-D K;
    /// KX,KY; KXX,KYY,KXY); a CSV file of lines region,K; or a cell array of the mesh
    #[arg(
        long,
        value_name = "K",
        default_value = "1e-13",
        allow_hyphen_values = true
    )]
    pub permeability: String,
    /// Viscosity in Pa s
    #[arg(
        long,
        value_name = "MU",
        default_value_t = 0.001,
        allow_hyphen_values = true
    )]
    pub viscosity: f64,
    /// Write streamlines that carry equal rates, for ParaView
    #[arg(long, value_name = "FILE.vtp")]
    pub streamlines: Option<PathBuf>,
    /// Number of streamlines
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub lines: usize,
}

/// `atomesh slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// The image that was meshed
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// Its mesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The picture to write
    #[arg(short, long, value_name = "OUT.png")]
    pub output: PathBuf,
    /// The point in which the planes meet, in physical coordinates [default: the middle]
    #[arg(long, value_name = "X,Y,Z", allow_negative_numbers = true)]
    pub at: Option<String>,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// `atomesh synth`.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// What to make
    #[arg(value_name = "KIND", value_parser = synth_kind())]
    pub kind: String,
    /// The image to write: .vti or .npy; .png in 2-D
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Also write the exact distance to the features
    #[arg(long, value_name = "DIST.npy")]
    pub truth: Option<PathBuf>,
    /// Number of samples along x, y and z; NX,NY makes a 2-D image
    #[arg(long, value_name = "NX,NY,NZ", default_value = "128,128,128")]
    pub dims: String,
    /// Number of faults or shells
    #[arg(long, value_name = "N", default_value_t = 4)]
    pub count: usize,
    /// Signal over the rms of the noise; inf for none
    #[arg(long, value_name = "RATIO", default_value_t = 4.0)]
    pub signal_to_noise: f64,
    /// Width of the features: the standard deviation of their profile, in samples
    #[arg(long, value_name = "SAMPLES", default_value_t = 1.5)]
    pub width: f64,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub rng_seed: u64,
}

fn synth_kind() -> clap::builder::PossibleValuesParser {
    crate::image::synth::Kind::ALL.map(|(name, _)| name).into()
}

/// TOML may say `distance = 8` or `distance = "4:12"`.
fn text_or_number<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> std::result::Result<Option<String>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "give a text or a number")]
    enum TextOrNumber {
        Text(String),
        Whole(i64),
        Number(f64),
    }
    Ok(Some(match TextOrNumber::deserialize(deserializer)? {
        TextOrNumber::Text(text) => text,
        TextOrNumber::Whole(number) => number.to_string(),
        TextOrNumber::Number(number) => number.to_string(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        CommandLine::command().debug_assert();
    }

    #[test]
    fn the_command_line_wins_over_the_file_and_the_file_over_the_defaults() {
        let typed = MeshOptions {
            sigma: Some(2.0),
            ..MeshOptions::default()
        };
        let file: MeshOptions =
            toml::from_str("distance = 5\nsigma = 1.0\nbeta = 0.25\n[input]\nraw = \"2x3x4:u8\"")
                .unwrap();
        let merged = typed
            .over(&file)
            .unwrap()
            .over(&MeshOptions::defaults())
            .unwrap();
        assert_eq!(merged.sigma, Some(2.0));
        assert_eq!(merged.distance.as_deref(), Some("5"));
        assert_eq!(merged.beta.as_deref(), Some("0.25"));
        assert_eq!(merged.input.raw.as_deref(), Some("2x3x4:u8"));
        assert_eq!(merged.slivers, Some(SliverChoice::Joe));
    }

    #[test]
    fn options_survive_toml() {
        let mut options = MeshOptions::defaults();
        options.input.inline_byte = Some(9);
        options.threshold = Some(-0.5);
        let text = toml::to_string(&options).unwrap();
        assert_eq!(toml::from_str::<MeshOptions>(&text).unwrap(), options);
    }

    #[test]
    fn a_misspelt_key_is_refused() {
        assert!(toml::from_str::<MeshOptions>("distanse = 5").is_err());
    }
}
