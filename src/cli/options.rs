//! The options of `mesh` as they are typed, nothing checked yet beyond its shape.
//!
//! They exist three times as the same type, [`MeshOptions`]: the defaults, the configuration file and
//! the command line. [`MeshOptions::over`] lays one over the other.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::{Deserialize, Deserializer, Serialize};

use crate::cli::common::feature::FeatureChoice;
use crate::cli::common::input::InputOptions;
use crate::error::cause;
use crate::improve::triangles::relax::Scheme;
use crate::{Error, Result};

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
        toml::to_string(self).map_err(not_text)
    }

    /// These options, and those of `below` where these are silent.
    ///
    /// # Errors
    /// [`Error::Job`] if an option cannot be written as TOML (a path that is no UTF-8).
    pub fn over(&self, below: &Self) -> Result<Self> {
        let table = |options: &Self| toml::Table::try_from(options).map_err(not_text);
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
            Error::Job(cause("options", e.message(), "see atomesh mesh --help")).because(e)
        })
    }
}

/// Options that do not fit into a TOML file.
fn not_text(error: toml::ser::Error) -> Error {
    let remedy = "use file names that are valid UTF-8";
    Error::Job(cause("options", &error, remedy).because(error))
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
