//! The options of `atomesh mesh`, as one value.
//!
//! A [`MeshSpec`] has a field for each option, with its unit, its default and its help text. The
//! command line, configuration files, `--print-config`, the record in mesh files and Python's
//! keywords are all generated from this type. To add an option, add a field with its default,
//! extend [`validate`](MeshSpec::validate), and use it as `params.spec.FIELD`.
//!
//! - `config`: options from a configuration file
//! - `lengths`: options in units of length
//! - `values`: types of option values that are more than one number or word
//! - `validate`: checks of options and their combinations

mod config;
mod lengths;
mod validate;
mod values;

use std::num::NonZeroUsize;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::cover::Cover;
use super::params::{Evaluator, Optimizer};
use crate::error::cause;
use crate::feature::{
    DetectionOptions, FaultEvidence, FeatureKind, LabelOptions, MIN_FAULT_DIP, PathSeeds,
};
use crate::image::LabelValue;
use crate::image::formats::InputOptions;
use crate::improve::{Effort, SliverMethod, Target};
use crate::mesh::delaunay::DelaunayKernel;
use crate::mesh_file::CellChoice;
pub use crate::mesh_file::RegionNames;
pub use crate::option_text::{
    InvalidValue, Length, NumberOrFile, PointValue, SignedAxis, ThresholdValues,
};
use crate::published::relax::Scheme;
pub use crate::surface_file::FileOption;
use crate::{Error, Result};
pub(crate) use values::DEFAULT_DISTANCES;
pub use values::{DistanceSource, FeatureWeights, Metric, NominalDistance, Padding, PeriodicAxes};

/// Headings of the command line's help; options without one come first.
const FEATURES: &str = "Features";
const ATOMS: &str = "Atoms";
const SHAPES: &str = "Shapes of cells";
const FILES: &str = "More files to write";

/// Options of `atomesh mesh`. Lengths are in samples unless an option says otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct MeshSpec {
    /// The mesh to write [default: the image's name with .vtu, in this folder]
    #[arg(short, long, value_name = "MESH.vtu")]
    pub output: Option<PathBuf>,
    /// Nominal distance between atoms, in samples: one number, or MIN:MAX; or in a unit of length, such as 3mm,
    /// 0.5mm:2mm or 40ft, if the image has one
    #[arg(long, value_name = "D", default_value_t = defaults().distance)]
    pub distance: NominalDistance,
    /// Source of a distance MIN:MAX: gaps (MAX, decreasing to MIN where features run close together
    /// or cross at shallow angles), features (MIN on them, increasing away from them), image (MIN
    /// where it is darkest, or brightest if bright features are followed), laplacian (of the
    /// potential), or a file with a distance for each sample
    #[arg(long, value_name = "WHAT", default_value_t = defaults().distance_from)]
    pub distance_from: DistanceSource,
    /// How much work goes into the mesh: draft is for trying options out, best for the last mesh. A
    /// preset of other options, which override it [default: normal]
    #[arg(long, value_name = "HOW", value_enum)]
    pub effort: Option<Effort>,
    /// The features to follow
    #[arg(long, value_name = "KIND", default_value_t = defaults().feature, value_enum)]
    pub feature: FeatureKind,
    /// Faults and horizons to follow as they are, beside the features that are found (none with --feature
    /// none): FILE for all its surfaces, FILE:NAME for one, or to name the only one. GOCAD .ts and .pl,
    /// .vtp, .obj, grids (IRAP, ZMAP+, CPS-3, Surfer, ESRI ASCII), fault sticks and points x,y,z, which are
    /// brought to the image's coordinates. What the file does not say follows it: ,fault or ,horizon;
    /// ,unit=ft (of z) or ,unit=m,m,ft; ,z=up or ,z=down; ,domain=time or ,domain=depth; ,null=-999. May be
    /// repeated
    #[arg(long, value_name = "FILE[:NAME][,...]", help_heading = FEATURES)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub surface: Vec<FileOption>,
    /// Continue faults of --surface that end within this distance of a side of the image or of another
    /// such fault, in samples or in a unit of length; 0 leaves them as they are [default: the distance between atoms]
    #[arg(long, value_name = "DIST", help_heading = FEATURES)]
    pub extend_faults: Option<Length>,
    /// Scale of the features, in samples [default: depends on the kind of feature]
    #[arg(long, value_name = "S", help_heading = FEATURES)]
    pub sigma: Option<f64>,
    /// Smooths the boundaries of labels over this many samples, also beyond the half sample that is
    /// allowed otherwise [default: as little as the steps of the samples ask for]
    #[arg(long, value_name = "S", help_heading = FEATURES)]
    pub label_smoothing: Option<f64>,
    /// Smallest strength of a feature, in units of the feature image; for an isosurface, its value, or
    /// several values in ascending order with commas between them, which divide the image into regions
    /// [default: automatic; it is printed]
    #[arg(long, value_name = "T[,T]", allow_hyphen_values = true, help_heading = FEATURES)]
    pub threshold: Option<ThresholdValues>,
    /// How faults are recognised in seismic amplitudes
    #[arg(
            long,
            value_name = "EVIDENCE",
            default_value_t = defaults().fault_evidence,
            value_enum,
            help_heading = FEATURES
        )]
    pub fault_evidence: FaultEvidence,
    /// Smallest dip of a fault, in degrees; two-way time is converted to depth with --velocity, or else
    /// at 2,000 m/s
    #[arg(long, value_name = "DEGREES", default_value_t = defaults().min_dip, help_heading = FEATURES)]
    pub min_dip: f64,
    /// Smallest size of a fault in samples, whatever the distance between atoms: its area is at least
    /// the square of it, in 2-D its length [default: 20]
    #[arg(long, value_name = "SAMPLES", help_heading = FEATURES)]
    pub min_fault_size: Option<f64>,
    /// Smallest confidence of a fault or horizon in seismic amplitudes: leave out those below. Noise has
    /// up to 1
    #[arg(long, value_name = "C", help_heading = FEATURES)]
    pub min_confidence: Option<f64>,
    /// Seek faults and horizons in chaotic zones (salt, gas chimneys), too
    #[arg(long, help_heading = FEATURES)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub keep_chaos: bool,
    /// Weights F,H of faults and horizons, each in (0, 1], if both are followed
    #[arg(
            long,
            value_name = "F,H",
            default_value_t = defaults().feature_weights,
            help_heading = FEATURES
        )]
    pub feature_weights: FeatureWeights,
    /// Options of one label: VALUE:distance=D,name=NAME (distance between atoms in it, as for --distance),
    /// or VALUE:into=VALUE, which merges it into another label; may be repeated
    #[arg(long, value_name = "VALUE:OPTIONS", allow_hyphen_values = true, help_heading = FEATURES)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub label: Vec<LabelOptions>,
    /// Labels, by value or name, whose cells the mesh leaves out, such as 0 for the background. Their boundaries
    /// keep their names, such as interface_0_3
    #[arg(
        long,
        value_name = "LABEL,...",
        allow_hyphen_values = true,
        conflicts_with = "keep"
    )]
    pub drop: Option<RegionNames>,
    /// Labels, by value or name, whose cells alone the mesh has
    #[arg(long, value_name = "LABEL,...", allow_hyphen_values = true)]
    pub keep: Option<RegionNames>,
    /// Of each label that stays, keep only the largest connected part
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub keep_largest: bool,
    /// Number of samples below which a connected part of a label, or of a region of --feature isosurface,
    /// joins the labels around it before the image is meshed
    #[arg(long, value_name = "N", help_heading = FEATURES)]
    pub min_part: Option<NonZeroUsize>,
    /// A point of the object, in physical coordinates, for --feature paths; may be repeated
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, help_heading = FEATURES)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub object: Vec<PointValue>,
    /// A point of the background, for --feature paths; may be repeated [default: the image's
    /// outermost samples]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, help_heading = FEATURES)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub background: Vec<PointValue>,
    /// Also write the potential b(x)
    #[arg(long, value_name = "FILE.vti", help_heading = FILES)]
    pub potential_out: Option<PathBuf>,
    /// Also write the lines where features, or a feature and a side of the box, meet at less than 30
    /// degrees, with their angles
    #[arg(long, value_name = "LINES.vtp", help_heading = FILES)]
    pub lines: Option<PathBuf>,
    /// Also write a page with mesh, image and figures: one HTML file for any browser
    #[arg(long, value_name = "PAGE.html")]
    pub page: Option<PathBuf>,
    /// A folder in which the result of each stage is stored. The same command, started again after
    /// it was stopped, continues from there and makes the same mesh
    #[arg(long, value_name = "FOLDER", help_heading = FILES)]
    pub checkpoint: Option<PathBuf>,
    /// Also write the faces on features with the number of their surface, as `atomesh surface` does
    #[arg(long, value_name = "SURFACES.vtp", help_heading = FILES)]
    pub surfaces: Option<PathBuf>,
    /// Position of atoms: on features, or alongside them [default: on; alongside with --cells
    /// voronoi]
    #[arg(long, value_name = "WHERE", help_heading = ATOMS)]
    pub align: Option<AtomAlignment>,
    /// Kind of cells [default: tets; voronoi with --align alongside]
    #[arg(long, value_name = "KIND")]
    pub cells: Option<CellKind>,
    /// Weight of the image against the lattice, in [0, 1): a number, or an image of weights
    #[arg(long, value_name = "B", default_value_t = defaults().beta, help_heading = ATOMS)]
    pub beta: NumberOrFile,
    /// Initial positions of atoms
    #[arg(
            long,
            value_name = "HOW",
            default_value_t = defaults().seeding,
            value_enum,
            help_heading = ATOMS
        )]
    pub seeding: SeedingKind,
    /// Largest number of atoms that --seeding guide places [default: as many as fit]
    #[arg(long, value_name = "N", help_heading = ATOMS)]
    pub max_atoms: Option<usize>,
    /// A table of fixed atoms (wells, sources) with the columns x, y and z (x and y in 2-D), which are
    /// brought to the image's coordinates; what it does not say follows it, as for --surface
    #[arg(long, value_name = "FILE.csv", help_heading = ATOMS)]
    pub atoms_from: Option<FileOption>,
    /// A table of well trajectories, along which atoms are fixed: columns x, y, z and radius (x, y and
    /// radius in 2-D), or a deviation survey; they are brought to the image's coordinates. FILE:NAME
    /// takes one well. What the file does not say follows it, as for --surface, and ,head=x,y,z is the
    /// wellhead; may be repeated
    #[arg(long, value_name = "FILE.csv", help_heading = ATOMS)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub well: Vec<FileOption>,
    /// Distance between atoms at wells, in samples or in a unit of length; it increases to --distance away from them
    #[arg(long, value_name = "D", help_heading = ATOMS)]
    pub well_distance: Option<Length>,
    /// Evaluator of the lattice energy
    #[arg(
            long,
            value_name = "HOW",
            default_value_t = defaults().evaluator,
            value_enum,
            alias = "potential",
            help_heading = ATOMS
        )]
    #[serde(alias = "potential")]
    pub evaluator: Evaluator,
    /// Weight, in [0, 1], of the energy between atoms against their Laplacian coordinates, which
    /// make the lattice more regular. 1 omits them, 0.7 is typical with them
    #[arg(long, value_name = "K", default_value_t = defaults().kappa, help_heading = ATOMS)]
    pub kappa: f64,
    /// Method that moves atoms
    #[arg(
            long,
            value_name = "HOW",
            default_value_t = defaults().optimizer,
            value_enum,
            help_heading = ATOMS
        )]
    pub optimizer: Optimizer,
    /// Largest number of rounds, each of which perturbs atoms at random and minimises the energy;
    /// they end when a round gains nothing [default: 1; 3 with --kappa]
    #[arg(long, value_name = "N", help_heading = ATOMS)]
    pub rounds: Option<usize>,
    /// Largest number of evaluations of the energy in all rounds together [default: 12 to 40 a
    /// round, more with --kappa and for slower optimisers]
    #[arg(long, value_name = "N", help_heading = ATOMS)]
    pub max_evaluations: Option<NonZeroUsize>,
    /// Number of initial passes on a smoother potential
    #[arg(
            long,
            value_name = "N",
            default_value_t = defaults().coarse_to_fine,
            help_heading = ATOMS
        )]
    pub coarse_to_fine: usize,
    /// Target for the smallest dihedral angle, in degrees (in 2-D the smallest angle); the target
    /// for the largest is 180 minus it [default: 30; 15 with --effort draft]
    #[arg(long, value_name = "DEGREES", help_heading = SHAPES)]
    pub min_dihedral: Option<f64>,
    /// Method that removes slivers
    #[arg(
            long,
            value_name = "HOW",
            default_value_t = defaults().slivers,
            value_enum,
            help_heading = SHAPES
        )]
    pub slivers: Slivers,
    /// Program that joins atoms to tetrahedra. The result does not depend on it
    #[arg(
            long,
            value_name = "KERNEL",
            default_value_t = defaults().delaunay,
            value_enum,
            help_heading = SHAPES
        )]
    pub delaunay: DelaunayKernel,
    /// Distance within which nodes of Voronoi cells are merged, as a fraction of the cells' radius,
    /// which removes the smallest faces
    #[arg(long, value_name = "SHARE", default_value_t = defaults().weld, help_heading = SHAPES)]
    pub weld: f64,
    /// Smooth the triangles of a 2-D image where it is flat; nodes on features do not move
    #[arg(long, value_name = "HOW", help_heading = SHAPES)]
    pub smooth: Option<Scheme>,
    /// Metric of lattice space: auto (shape for scans, for labels outside surveys, and for distances in a
    /// unit of length, else samples), samples, physical (--distance is then in physical units, not in
    /// samples), shape (physical proportions, with as many samples per cell as samples), k:KX,KY,KZ (cells
    /// for two-point fluxes in rock with these permeabilities along x, y and z; only their ratios count),
    /// or a scale per axis SX,SY,SZ (SX,SY in 2-D)
    #[arg(long, value_name = "SPACE", default_value_t = defaults().metric, help_heading = ATOMS)]
    pub metric: Metric,
    /// The part of the image that the mesh covers: samples (the box through the outermost samples, N - 1
    /// steps along an axis of N samples), or voxels (N steps; the outermost samples continue to the edges
    /// of their voxels)
    #[arg(long, value_name = "WHAT", default_value_t = defaults().cover, value_enum)]
    pub cover: Cover,
    /// Continue the mesh beyond the image, with cells that coarsen away from it:
    /// above=DIST,below=DIST,sides=DIST in the image's physical units, of which any may be left out. The
    /// cells belong to the regions overburden, underburden and sideburden
    #[arg(long, value_name = "SIDE=DIST,...")]
    pub pad: Option<Padding>,
    /// End the cells above the image at this surface, such as the ground or the seafloor: FILE or
    /// FILE:NAME, a grid of heights (IRAP, ZMAP+, CPS-3, Surfer, ESRI ASCII), GOCAD .ts, .vtp, .obj or
    /// points x,y,z, which are brought to the image's coordinates; what it does not say follows it, as for
    /// --surface. It must cover the image and the sides of --pad, and replaces above=DIST of --pad
    #[arg(long, value_name = "FILE[:NAME][,...]")]
    pub topography: Option<FileOption>,
    /// Make opposite sides match node by node along these axes, so that copies of the mesh fill space:
    /// x, y and z (x and y in 2-D). The last layer of the image along them must repeat the first
    #[arg(long, value_name = "AXES")]
    pub periodic: Option<PeriodicAxes>,
    /// Convert two-way time to depth (in the unit of x and y, m or ft), with one velocity in m/s for the
    /// whole image, or a file of interval velocities in m/s on a grid in two-way time. With a file, the
    /// image is resampled
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub velocity: Option<NumberOrFile>,
    /// Seed of all random numbers
    #[arg(long, value_name = "N", default_value_t = defaults().rng_seed, help_heading = ATOMS)]
    pub rng_seed: u64,
    /// Also write the report as JSON
    #[arg(long, value_name = "FILE.json", help_heading = FILES)]
    pub report: Option<PathBuf>,
    /// Also write the lattice before atoms move and after each round or generation, for ParaView.
    /// The report then has the energy and the quality of each
    #[arg(long, value_name = "FILE.pvd", help_heading = FILES)]
    pub trace: Option<PathBuf>,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// Options of the lattice whose energy is minimised; atoms that do not move have none of them.
const LATTICE_OPTIONS: &[&str] = &[
    "beta",
    "kappa",
    "optimizer",
    "evaluator",
    "rounds",
    "max-evaluations",
    "coarse-to-fine",
    "trace",
];

/// Default options, which the command line shows.
fn defaults() -> MeshSpec {
    MeshSpec::default()
}

impl Default for MeshSpec {
    fn default() -> Self {
        Self {
            output: None,
            distance: NominalDistance::default(),
            distance_from: DistanceSource::default(),
            effort: None,
            feature: FeatureKind::Auto,
            surface: Vec::new(),
            extend_faults: None,
            sigma: None,
            label_smoothing: None,
            threshold: None,
            fault_evidence: FaultEvidence::default(),
            min_dip: MIN_FAULT_DIP,
            min_fault_size: None,
            min_confidence: None,
            keep_chaos: false,
            feature_weights: FeatureWeights::default(),
            label: Vec::new(),
            drop: None,
            keep: None,
            keep_largest: false,
            min_part: None,
            object: Vec::new(),
            background: Vec::new(),
            potential_out: None,
            lines: None,
            page: None,
            checkpoint: None,
            surfaces: None,
            align: None,
            cells: None,
            beta: NumberOrFile::Constant(0.5),
            seeding: SeedingKind::Fcc,
            max_atoms: None,
            atoms_from: None,
            well: Vec::new(),
            well_distance: None,
            evaluator: Evaluator::Pairwise,
            kappa: 1.0,
            optimizer: Optimizer::Lbfgs,
            rounds: None,
            max_evaluations: None,
            coarse_to_fine: 0,
            min_dihedral: None,
            slivers: Slivers::Joe,
            delaunay: DelaunayKernel::Auto,
            weld: 0.0,
            smooth: None,
            metric: Metric::Auto,
            cover: Cover::Samples,
            pad: None,
            topography: None,
            periodic: None,
            velocity: None,
            rng_seed: 1,
            report: None,
            trace: None,
            input: InputOptions::default(),
        }
    }
}

/// Methods that place atoms.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum SeedingKind {
    /// A regular lattice fitted to the box: face-centred cubic, or triangular in 2-D; grown where
    /// the distance varies
    #[default]
    Fcc,
    /// A regular lattice grown from fixed atoms (wells), or from the middle of the box
    Grown,
    /// Delaunay refinement, which is isotropic
    Refine,
    /// On features, dense where they bend, and few elsewhere; image and features determine the
    /// distance
    Canny,
    /// At random, first where features are strong (guide tables)
    Guide,
    /// Sites of a fine lattice projected onto features
    Projection,
}

/// Methods that remove slivers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Slivers {
    /// Flips and smoothing that keep faces on features
    #[default]
    Joe,
    /// Vertex weights (sliver exudation); the report compares both methods; 3-D only
    Exude,
    /// Vertex weights by CGAL, if it is built in (slow)
    ExudeCgal,
    /// The Delaunay triangulation without improvement
    None,
}

impl Slivers {
    /// Returns `true` for the methods that give weights to vertices.
    pub fn is_exudation(self) -> bool {
        matches!(self, Self::Exude | Self::ExudeCgal)
    }

    /// Returns the method that removes slivers; `None` if they are left.
    pub fn method(self) -> Option<SliverMethod> {
        match self {
            Self::Joe => Some(SliverMethod::Joe),
            Self::Exude => Some(SliverMethod::Exude),
            Self::ExudeCgal => Some(SliverMethod::ExudeCgal),
            Self::None => None,
        }
    }
}

/// Position of atoms relative to features, which depends on the kind of cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum AtomAlignment {
    /// On features, which the faces of tetrahedra then follow
    On,
    /// Alongside features, which the faces of Voronoi cells then follow
    Alongside,
}

/// Kinds of cells.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum CellKind {
    /// Tetrahedra; triangles in 2-D
    #[default]
    #[value(name = "tets", alias = "triangles")]
    #[serde(rename = "tets", alias = "triangles")]
    Simplices,
    /// Voronoi cells (PEBI): polyhedra; polygons in 2-D
    #[value(alias = "pebi")]
    #[serde(alias = "pebi")]
    Voronoi,
}

impl MeshSpec {
    /// Returns notes on labels for which these options give another name than the image does.
    pub(crate) fn notes_on_names(&self, names: &[(LabelValue, String)]) -> Vec<String> {
        let note = |(label, other): &(LabelValue, String)| {
            let options = self.label.iter().find(|options| options.label == *label)?;
            let name = options.name.as_ref().filter(|name| *name != other)?;
            Some(format!(
                "label {label} is named {name}, as --label says, not {other}, as the table or file of labels does"
            ))
        };
        names.iter().filter_map(note).collect()
    }

    /// Returns the kind of cells, which `cells` or `align` names.
    pub fn cell_kind(&self) -> CellKind {
        self.cells.unwrap_or(match self.align {
            Some(AtomAlignment::Alongside) => CellKind::Voronoi,
            Some(AtomAlignment::On) | None => CellKind::Simplices,
        })
    }

    /// Returns the angles that improvement aims at; `None` if the Delaunay triangulation is left as it is.
    pub fn target(&self) -> Option<Target> {
        self.slivers.method().map(|method| Target {
            min_dihedral: self.min_angle(),
            method,
            effort: self.effort(),
        })
    }

    /// Returns which cells of the mesh are kept.
    pub fn cell_choice(&self) -> CellChoice<'_> {
        CellChoice {
            drop: self.drop.as_ref(),
            keep: self.keep.as_ref(),
            keep_largest: self.keep_largest,
        }
    }

    /// Returns how much work goes into the mesh.
    pub fn effort(&self) -> Effort {
        self.effort.unwrap_or_default()
    }

    /// Returns the target for the smallest angle, in degrees.
    pub fn min_angle(&self) -> f64 {
        self.min_dihedral
            .unwrap_or_else(|| self.effort().min_angle())
    }

    /// Returns the options with values filled in that follow from others: the kind of cells, the
    /// alignment of atoms, the target angle, and labels as features if labels have options.
    pub fn resolved(mut self) -> Self {
        self.min_dihedral = Some(self.min_angle());
        self.cells = Some(self.cell_kind());
        self.align = Some(match self.cell_kind() {
            CellKind::Simplices => AtomAlignment::On,
            CellKind::Voronoi => AtomAlignment::Alongside,
        });
        let is_about_labels = !self.label.is_empty()
            || self.label_smoothing.is_some()
            || !self.cell_choice().keeps_all();
        if self.feature == FeatureKind::Auto && is_about_labels {
            self.feature = FeatureKind::Labels;
        }
        self
    }

    /// Returns all options that determine the result, without the paths of output files.
    pub fn reproducible(mut self) -> Self {
        for path in [
            &mut self.output,
            &mut self.report,
            &mut self.potential_out,
            &mut self.lines,
            &mut self.page,
            &mut self.surfaces,
            &mut self.checkpoint,
            &mut self.trace,
        ] {
            *path = None;
        }
        self.effort = self.effort.filter(|&effort| effort != Effort::Normal);
        self.resolved()
    }

    /// Returns the options as TOML, as a configuration file or the record in a mesh holds them.
    ///
    /// # Errors
    /// [`Error::Job`] if the name of a file is not valid UTF-8.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|error| not_utf8(&error))
    }

    /// Returns the options as a table of TOML, without absent options.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if the name of a file is not valid UTF-8.
    pub fn to_table(&self) -> Result<toml::Table> {
        toml::Table::try_from(self).map_err(|error| not_utf8(&error))
    }

    /// Returns the options of feature detection in an image of `D` axes, for a lattice space in
    /// which samples are `step` apart. Distances are those of the options.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a point that does not have `D` coordinates.
    pub fn detection_options<const D: usize>(&self, step: [f64; D]) -> Result<DetectionOptions<D>> {
        let (threshold, further_levels) = self.threshold_levels();
        Ok(DetectionOptions {
            kind: self.feature,
            scale: self.sigma,
            label_smoothing: self.label_smoothing,
            threshold,
            further_levels,
            min_part: self.min_part_samples(),
            fault_evidence: self.fault_evidence,
            min_dip: self.min_dip,
            min_fault_size: self.min_fault_size,
            min_confidence: self.min_confidence,
            keep_chaos: self.keep_chaos,
            seeks_crossings: self.effort() != Effort::Draft,
            weights: self.feature_weights.0,
            seeds: self.path_seeds()?,
            labels: self.label.clone(),
            d_min: self.distance.limits()[0],
            step,
            keep_nulls: self.input.keeps_nulls(),
            ..DetectionOptions::default()
        })
    }

    /// Returns the threshold, and further values of isosurfaces.
    pub(crate) fn threshold_levels(&self) -> (Option<f32>, Vec<f32>) {
        (self.threshold.as_ref()).map_or_else(Default::default, ThresholdValues::first_and_further)
    }

    /// Returns the number of samples below which a connected part of a label joins the labels around it.
    pub(crate) fn min_part_samples(&self) -> usize {
        self.min_part.map_or(0, NonZeroUsize::get)
    }

    /// Returns the points near which random shortest paths begin and end.
    ///
    /// # Errors
    /// [`Error::Job`] for a point that has not `D` coordinates.
    pub fn path_seeds<const D: usize>(&self) -> Result<PathSeeds<D>> {
        let points = |name: &str, points: &[PointValue]| {
            let remedy = if D == 2 {
                "give a point X,Y"
            } else {
                "give a point X,Y,Z"
            };
            let coordinates = points.iter().map(|point| point.coordinates(name, remedy));
            coordinates.collect::<Result<Vec<_>>>()
        };
        Ok(PathSeeds {
            object: points("object", &self.object)?,
            background: points("background", &self.background)?,
            seed: self.rng_seed,
            ..PathSeeds::default()
        })
    }
}

/// Returns the error about a path that TOML and JSON cannot hold.
fn not_utf8(error: &toml::ser::Error) -> Error {
    Error::Job(
        cause("options", error, "use file names that are valid UTF-8").with_source(error.clone()),
    )
}
