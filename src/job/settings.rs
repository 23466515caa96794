//! A [`Job`](super::Job) in flat words: what a command line, a TOML file and a mesh's own record hold.
//!
//! Each setting is a name and a value, and may be absent: then it is what the job's defaults say.
//! [`Settings::over`] lays one set over another.

use std::path::PathBuf;

use serde::{Deserialize, Deserializer, Serialize};

use super::Evaluator;
use crate::error::cause;
use crate::feature::FeatureKind;
use crate::image::formats::InputOptions;
use crate::improve::triangles::relax::Scheme;
use crate::lattice::optimize::Method;
use crate::{Error, Result};

/// Headings of the command line's help; what has none comes first.
#[cfg(feature = "cli")]
const FEATURES: &str = "Features";
#[cfg(feature = "cli")]
const ATOMS: &str = "Atoms";
#[cfg(feature = "cli")]
const SHAPES: &str = "Shapes of cells";
#[cfg(feature = "cli")]
const FILES: &str = "More files to write";

/// What was said of a job. Lengths are in samples, weights without unit.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::Args))]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Settings {
    /// The mesh to write [default: the image's name with .vtu, in this folder]
    #[cfg_attr(feature = "cli", arg(short, long, value_name = "MESH.vtu"))]
    pub output: Option<PathBuf>,
    /// Nominal distance between atoms, in samples, or MIN:MAX [default: 2.7:8]
    #[cfg_attr(feature = "cli", arg(long, value_name = "D"))]
    #[serde(deserialize_with = "text_or_number")]
    pub distance: Option<String>,
    /// What a distance MIN:MAX follows: gaps (MAX, but down to MIN where features run close together or
    /// cross at shallow angles; the default), features (MIN on them, increasing away from them), image (MIN
    /// where it is darkest, MAX where it is brightest; the other way round where bright features are
    /// followed), laplacian (of the potential), or a file with a distance per sample
    #[cfg_attr(feature = "cli", arg(long, value_name = "WHAT"))]
    pub distance_from: Option<String>,
    /// The features to follow [default: auto]
    #[cfg_attr(feature = "cli", arg(long, value_name = "KIND"))]
    pub feature: Option<FeatureKind>,
    /// Scale of the features in samples [default: by the kind of feature]
    #[cfg_attr(feature = "cli", arg(long, value_name = "S", help_heading = FEATURES))]
    pub sigma: Option<f64>,
    /// Smallest strength of a feature, in units of the feature image [default: automatic, printed]
    #[cfg_attr(
        feature = "cli",
        arg(long, value_name = "T", allow_negative_numbers = true, help_heading = FEATURES)
    )]
    pub threshold: Option<f32>,
    /// Weights F,H in (0, 1] of faults and horizons where both are followed [default: 1,1]
    #[cfg_attr(feature = "cli", arg(long, value_name = "F,H", help_heading = FEATURES))]
    pub feature_weights: Option<String>,
    /// What is wanted of a label: VALUE:distance=D,name=NAME (distance between atoms in it, in samples), or
    /// VALUE:into=VALUE (it becomes part of another label); may be repeated
    #[cfg_attr(feature = "cli", arg(long, value_name = "VALUE:WISHES", allow_hyphen_values = true, help_heading = FEATURES))]
    pub label: Option<Vec<String>>,
    /// Paths: a point of the object, in physical coordinates; may be repeated
    #[cfg_attr(
        feature = "cli",
        arg(long, value_name = "X,Y", allow_hyphen_values = true, help_heading = FEATURES)
    )]
    pub object: Option<Vec<String>>,
    /// Paths: a point of the background; may be repeated [default: the image's outermost samples]
    #[cfg_attr(
        feature = "cli",
        arg(long, value_name = "X,Y", allow_hyphen_values = true, help_heading = FEATURES)
    )]
    pub background: Option<Vec<String>>,
    /// Also write the potential b(x)
    #[cfg_attr(feature = "cli", arg(long, value_name = "FILE.vti", help_heading = FILES))]
    pub potential_out: Option<PathBuf>,
    /// Also write the lines where features, or a feature and a side of the box, meet at less than 30
    /// degrees, with their angles
    #[cfg_attr(feature = "cli", arg(long, value_name = "LINES.vtp", help_heading = FILES))]
    pub lines: Option<PathBuf>,
    /// Also write a page to look at: mesh, image and figures in one HTML file for any browser
    #[cfg_attr(feature = "cli", arg(long, value_name = "PAGE.html"))]
    pub page: Option<PathBuf>,
    /// Keep what each stage gives in a folder: the same command, started again after it was ended, goes on
    /// from there and makes the same mesh
    #[cfg_attr(feature = "cli", arg(long, value_name = "FOLDER", help_heading = FILES))]
    pub checkpoint: Option<PathBuf>,
    /// Also write the faces on features with the number of the surface of each, as `atomesh surface` does
    #[cfg_attr(feature = "cli", arg(long, value_name = "SURFACES.vtp", help_heading = FILES))]
    pub surfaces: Option<PathBuf>,
    /// Atoms on features, or alongside [default: on; alongside with --cells voronoi]
    #[cfg_attr(feature = "cli", arg(long, value_name = "WHERE", help_heading = ATOMS))]
    pub align: Option<AlignName>,
    /// Cells of the mesh [default: tets; voronoi with --align alongside]
    #[cfg_attr(feature = "cli", arg(long, value_name = "KIND"))]
    pub cells: Option<CellsName>,
    /// Weight of the image against the lattice in [0, 1): a number, or an image file [default: 0.5]
    #[cfg_attr(feature = "cli", arg(long, value_name = "B", help_heading = ATOMS))]
    #[serde(deserialize_with = "text_or_number")]
    pub beta: Option<String>,
    /// Initial positions of atoms [default: fcc]
    #[cfg_attr(feature = "cli", arg(long, value_name = "HOW", help_heading = ATOMS))]
    pub seeding: Option<SeedingName>,
    /// Largest number of atoms that --seeding guide places [default: as many as find room]
    #[cfg_attr(feature = "cli", arg(long, value_name = "N", help_heading = ATOMS))]
    pub max_atoms: Option<usize>,
    /// Fixed atoms (wells, sources): a CSV file of x,y,z (x,y in 2-D) in the image's physical
    /// coordinates
    #[cfg_attr(feature = "cli", arg(long, value_name = "FILE.csv", help_heading = ATOMS))]
    pub atoms_from: Option<PathBuf>,
    /// A well: fixed atoms along the trajectory in a CSV file of lines x,y,z,radius (x,y,radius in
    /// 2-D),
    /// in the image's physical coordinates; may be repeated
    #[cfg_attr(feature = "cli", arg(long, value_name = "FILE.csv", help_heading = ATOMS))]
    pub well: Option<Vec<PathBuf>>,
    /// Distance between atoms at wells, in samples; it increases to --distance away from them
    #[cfg_attr(feature = "cli", arg(long, value_name = "D", help_heading = ATOMS))]
    pub well_distance: Option<f64>,
    /// Evaluator of the lattice energy [default: pairwise]
    #[cfg_attr(feature = "cli", arg(long, value_name = "HOW", alias = "potential", help_heading = ATOMS))]
    #[serde(alias = "potential")]
    pub evaluator: Option<Evaluator>,
    /// Weight in [0, 1] of the energy between atoms against their Laplacian coordinates, which make the
    /// lattice more regular; 0.7 is typical with them [default: 1, without]
    #[cfg_attr(feature = "cli", arg(long, value_name = "K", help_heading = ATOMS))]
    pub kappa: Option<f64>,
    /// How atoms are moved [default: lbfgs]
    #[cfg_attr(feature = "cli", arg(long, value_name = "HOW", help_heading = ATOMS))]
    pub optimizer: Option<Method>,
    /// Most rounds of moving atoms a little by chance and minimising; they end when one gains nothing
    /// [default: 1; 3 with --kappa]
    #[cfg_attr(feature = "cli", arg(long, value_name = "N", help_heading = ATOMS))]
    pub rounds: Option<usize>,
    /// Number of initial passes on a smoother potential [default: 0]
    #[cfg_attr(feature = "cli", arg(long, value_name = "N", help_heading = ATOMS))]
    pub coarse_to_fine: Option<usize>,
    /// Smallest dihedral angle aimed at, in degrees, the largest being 180 minus it; in 2-D the
    /// smallest angle [default: 30]
    #[cfg_attr(feature = "cli", arg(long, value_name = "DEGREES", help_heading = SHAPES))]
    pub min_dihedral: Option<f64>,
    /// How slivers are removed [default: joe]
    #[cfg_attr(feature = "cli", arg(long, value_name = "HOW", help_heading = SHAPES))]
    pub slivers: Option<SliversName>,
    /// Voronoi cells without their smallest faces: nodes closer together than this fraction of the
    /// cells' radius are merged [default: 0]
    #[cfg_attr(feature = "cli", arg(long, value_name = "SHARE", help_heading = SHAPES))]
    pub weld: Option<f64>,
    /// Smooth the triangles of a 2-D image where it is flat; nodes on features stay
    #[cfg_attr(feature = "cli", arg(long, value_name = "HOW", help_heading = SHAPES))]
    pub smooth: Option<Scheme>,
    /// Lattice space: samples, physical, shape (physical, but as many samples to a cell as with samples),
    /// or a scale per axis SX,SY,SZ (SX,SY in 2-D) [default: samples]
    #[cfg_attr(feature = "cli", arg(long, value_name = "SPACE", help_heading = ATOMS))]
    pub metric: Option<String>,
    /// Makes depth in metres of two-way time: one velocity in m/s for the whole image, or a file of interval
    /// velocities in m/s on a grid of its own in two-way time, by which the image is stretched
    #[cfg_attr(
        feature = "cli",
        arg(long, value_name = "V", allow_negative_numbers = true)
    )]
    #[serde(deserialize_with = "text_or_number")]
    pub velocity: Option<String>,
    /// Seed of the random perturbations [default: 1]
    #[cfg_attr(feature = "cli", arg(long, value_name = "N", help_heading = ATOMS))]
    pub rng_seed: Option<u64>,
    /// Write the report as JSON
    #[cfg_attr(feature = "cli", arg(long, value_name = "FILE.json", help_heading = FILES))]
    pub report: Option<PathBuf>,
    /// Write the lattice before atoms move and after each round or generation, for ParaView; the report
    /// then has the energy and the quality of each
    #[cfg_attr(feature = "cli", arg(long, value_name = "FILE.pvd", help_heading = FILES))]
    pub trace: Option<PathBuf>,
    /// How to read the image.
    #[cfg_attr(
        feature = "cli",
        command(flatten, next_help_heading = "Reading the image")
    )]
    pub input: InputOptions,
}

/// How atoms are placed: the names of [`PlacementJob::Canny`](super::asked::PlacementJob) and of each
/// [`Start`](super::asked::Start).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum SeedingName {
    /// A regular lattice fitted to the box: face-centred cubic, triangular in 2-D; grown where the
    /// distance varies
    Fcc,
    /// A regular lattice grown from fixed atoms (wells), or from the middle of the box
    Grown,
    /// Delaunay refinement: isotropic
    Refine,
    /// On features, dense where they bend; few elsewhere. Image and features determine the distance
    Canny,
    /// Drawn at random, first where features are strong (guide tables)
    Guide,
    /// Sites of a fine lattice projected onto features
    Projection,
}

/// What becomes of slivers: the names of [`Slivers`](super::asked::Slivers).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum SliversName {
    /// Feature-keeping flips and smoothing
    Joe,
    /// Weights (CGAL's exudation, slow); the report compares both; 3-D only
    Exude,
    /// The Delaunay triangulation without improvement
    None,
}

/// Where atoms end up, which the kind of cells decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum AlignName {
    /// On features, which tetrahedra's faces then follow
    On,
    /// Beside features, which the faces of Voronoi cells then follow
    Alongside,
}

/// What the mesh is made of: the names of [`Cells`](super::asked::Cells).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum CellsName {
    /// Tetrahedra; triangles in 2-D
    #[cfg_attr(feature = "cli", value(alias = "triangles"))]
    Tets,
    /// Voronoi cells (PEBI): polyhedra; polygons in 2-D
    #[cfg_attr(feature = "cli", value(alias = "pebi"))]
    Voronoi,
}

impl Settings {
    /// As a table of those that are not absent.
    ///
    /// # Errors
    /// [`Error::Job`] if a path is no UTF-8.
    pub fn table(&self) -> Result<toml::Table> {
        toml::Table::try_from(self).map_err(|e| {
            Error::Job(cause("options", &e, "use file names that are valid UTF-8").with_source(e))
        })
    }

    /// These settings, and those of `below` where these are silent.
    ///
    /// # Errors
    /// [`Error::Job`] if one cannot be written as TOML (a path that is no UTF-8).
    pub fn over(&self, below: &Self) -> Result<Self> {
        let mut merged = below.table()?;
        for (key, value) in self.table()? {
            match (merged.get_mut(&key), value) {
                (Some(toml::Value::Table(lower)), toml::Value::Table(upper)) => lower.extend(upper),
                (_, value) => {
                    merged.insert(key, value);
                }
            }
        }
        merged.try_into().map_err(|e: toml::de::Error| {
            Error::Job(cause("options", e.message(), "see the list of options")).with_source(e)
        })
    }
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
    // Absent in JSON, as a report has it, is null.
    Ok(Option::deserialize(deserializer)?.map(|value| match value {
        TextOrNumber::Text(text) => text,
        TextOrNumber::Whole(number) => number.to_string(),
        TextOrNumber::Number(number) => number.to_string(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_upper_wins_over_the_lower() {
        let typed = Settings {
            sigma: Some(2.0),
            ..Settings::default()
        };
        let file: Settings =
            toml::from_str("distance = 5\nsigma = 1.0\nbeta = 0.25\n[input]\nraw = \"2x3x4:u8\"")
                .unwrap();
        let merged = typed.over(&file).unwrap();
        assert_eq!(merged.sigma, Some(2.0));
        assert_eq!(merged.distance.as_deref(), Some("5"));
        assert_eq!(merged.beta.as_deref(), Some("0.25"));
        assert_eq!(merged.input.raw.as_deref(), Some("2x3x4:u8"));
        assert_eq!(merged.slivers, None);
    }

    #[test]
    fn a_misspelt_key_is_refused() {
        assert!(toml::from_str::<Settings>("distanse = 5").is_err());
    }
}
