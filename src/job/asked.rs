//! Everything that can be asked for from a job, as one value.
//!
//! A [`Job`] is what a user says, before any file that it names is read and before the image tells how
//! many axes there are. What makes no sense cannot be said: a job has cells of one kind, with the
//! options of that kind. It is read and written as flat [`Settings`], by serde as on a command line.

use std::fmt::{self, Display};
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::Evaluator;
use super::params::DEFAULT_DISTANCES;
use super::settings::Settings;
use crate::feature::{FeatureKind, LabelOptions};
use crate::image::formats::InputOptions;
use crate::improve;
use crate::improve::triangles::relax::Scheme;
use crate::lattice::optimize;

/// What shall be done with an image to make a mesh of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Settings", into = "Settings")]
pub struct Job {
    /// How the image is read.
    pub input: InputOptions,
    /// What the mesh follows.
    pub features: Followed,
    /// How atoms come to stand where they do.
    pub placement: PlacementJob,
    /// A file of fixed atoms (wells, sources), in the image's physical coordinates; none by default.
    pub atoms_from: Option<PathBuf>,
    /// What the mesh is made of.
    pub cells: Cells,
    /// The length of a sample along each axis of lattice space; [`LatticeSpace::Samples`] by default.
    pub metric: LatticeSpace,
    /// What makes depth of two-way time; time stays time if `None`.
    pub velocity: Option<VelocityFrom>,
    /// Seed of all random numbers; 1 by default.
    pub seed: RngSeed,
    /// What is written, and where.
    pub outputs: Outputs,
}

/// Seed of all random numbers; 1 by default.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RngSeed(pub u64);

impl Default for RngSeed {
    fn default() -> Self {
        Self(1)
    }
}

/// The features that a mesh follows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Followed {
    /// Width in samples of the Gaussian under which they are sought; by kind if `None`.
    pub sigma: Option<f64>,
    /// What they are.
    pub what: What,
}

/// Kinds of features, with what can be said of each. A `threshold` is the least strength of a feature,
/// in units of the feature image; from the image itself if `None`.
#[derive(Debug, Clone, PartialEq)]
pub enum What {
    /// Told apart by their strength: every kind that is not named below.
    Strong {
        /// Which.
        kind: StrongKind,
        /// Least strength.
        threshold: Option<f32>,
    },
    /// Both, each with its weight.
    FaultsAndHorizons {
        /// Least strength of horizons.
        threshold: Option<f32>,
        /// Depths, in (0, 1], of the valleys of faults and of horizons; 1 each by default.
        weights: [f64; 2],
    },
    /// Interfaces between labels, or the middle of a mask.
    Labels {
        /// What is wanted of labels; distances in samples.
        wishes: Vec<LabelOptions>,
    },
    /// The boundary of an object, by random shortest paths (2-D).
    Paths {
        /// Points of the object, in the image's physical coordinates.
        object: Vec<Vec<f64>>,
        /// Points of the background; the image's outermost samples if there are none.
        background: Vec<Vec<f64>>,
    },
}

impl Default for What {
    fn default() -> Self {
        Self::Strong {
            kind: StrongKind::Auto,
            threshold: None,
        }
    }
}

/// Kinds of features that are told apart by their strength alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StrongKind {
    /// Picked by what the image looks like.
    Auto,
    /// Bright sheets.
    Ridges,
    /// Dark sheets.
    Valleys,
    /// Steps of brightness.
    Edges,
    /// Steps of brightness, by non-maximum suppression and hysteresis.
    Canny,
    /// Peaks and troughs of seismic amplitude.
    Horizons,
    /// Where layers of seismic amplitude are broken.
    Faults,
    /// The middle of a mask of thin sheets.
    Mask,
    /// The image is b(x) already.
    Potential,
}

impl Followed {
    /// The kind of feature.
    pub fn kind(&self) -> FeatureKind {
        match &self.what {
            What::Strong { kind, .. } => match kind {
                StrongKind::Auto => FeatureKind::Auto,
                StrongKind::Ridges => FeatureKind::Ridges,
                StrongKind::Valleys => FeatureKind::Valleys,
                StrongKind::Edges => FeatureKind::Edges,
                StrongKind::Canny => FeatureKind::Canny,
                StrongKind::Horizons => FeatureKind::Horizons,
                StrongKind::Faults => FeatureKind::Faults,
                StrongKind::Mask => FeatureKind::Mask,
                StrongKind::Potential => FeatureKind::Potential,
            },
            What::FaultsAndHorizons { .. } => FeatureKind::FaultsAndHorizons,
            What::Labels { .. } => FeatureKind::Labels,
            What::Paths { .. } => FeatureKind::Paths,
        }
    }

    /// The least strength of a feature, if it is given.
    pub fn threshold(&self) -> Option<f32> {
        match self.what {
            What::Strong { threshold, .. } | What::FaultsAndHorizons { threshold, .. } => threshold,
            What::Labels { .. } | What::Paths { .. } => None,
        }
    }

    /// What is wanted of labels.
    pub fn labels(&self) -> &[LabelOptions] {
        match &self.what {
            What::Labels { wishes } => wishes,
            _ => &[],
        }
    }

    /// The weights of faults and of horizons.
    pub fn weights(&self) -> [f64; 2] {
        match self.what {
            What::FaultsAndHorizons { weights, .. } => weights,
            _ => [1.0; 2],
        }
    }
}

/// How atoms come to stand where they do.
#[derive(Debug, Clone, PartialEq)]
pub enum PlacementJob {
    /// On features, dense where they bend; few elsewhere. Image and features determine the
    /// distance, and
    /// nothing moves.
    Canny,
    /// On a lattice, whose energy is then lowered.
    Lattice(LatticeJob),
}

impl Default for PlacementJob {
    fn default() -> Self {
        Self::Lattice(LatticeJob::default())
    }
}

/// A lattice, and how its energy is lowered.
#[derive(Debug, Clone, PartialEq)]
pub struct LatticeJob {
    /// How far atoms shall be apart, in samples; 8, and 2.7 in gaps between features, by default.
    pub apart: Apart,
    /// Initial positions of atoms; a regular lattice by default.
    pub start: Start,
    /// Wells: fixed atoms along their trajectories.
    pub wells: Option<Wells>,
    /// Weight of the image against the lattice, in [0, 1); 0.5 by default.
    pub beta: BetaFrom,
    /// The energy of the lattice.
    pub energy: LatticeEnergy,
    /// How atoms are moved; by L-BFGS by default.
    pub optimizer: optimize::Method,
    /// Most rounds of perturbing and minimising, at least 1; if `None`, one, or three with Laplacian
    /// coordinates.
    pub rounds: Option<usize>,
    /// Number of initial passes on a smoother potential, at most 8; 0 by default.
    pub coarse_passes: usize,
    /// Where the lattice after each round is written, for ParaView.
    pub trace: Option<PathBuf>,
}

impl Default for LatticeJob {
    fn default() -> Self {
        Self {
            apart: Apart::default(),
            start: Start::Fcc,
            wells: None,
            beta: BetaFrom::Constant(0.5),
            energy: LatticeEnergy::Pairwise { kappa: 1.0 },
            optimizer: optimize::Method::Lbfgs,
            rounds: None,
            coarse_passes: 0,
            trace: None,
        }
    }
}

/// How far atoms shall be apart, in samples.
#[derive(Debug, Clone, PartialEq)]
pub enum Apart {
    /// As far everywhere.
    Everywhere(f64),
    /// Nearer in some places than in others.
    Varying {
        /// The least distance.
        min: f64,
        /// The largest distance.
        max: f64,
        /// What it follows.
        by: DistanceFrom,
    },
}

impl Default for Apart {
    fn default() -> Self {
        let [min, max] = DEFAULT_DISTANCES;
        let by = DistanceFrom::Gaps;
        Self::Varying { min, max, by }
    }
}

impl Apart {
    /// The least distance.
    pub fn min(&self) -> f64 {
        match self {
            Self::Everywhere(d) => *d,
            Self::Varying { min, .. } => *min,
        }
    }
}

/// What a distance that varies follows.
#[derive(Debug, Clone, PartialEq)]
pub enum DistanceFrom {
    /// Gaps between features: the least where they run close together or cross at shallow angles.
    Gaps,
    /// The least on features, growing away from them.
    Features,
    /// The least where the image is darkest, or brightest where bright features are followed, the largest
    /// at the other end.
    Image,
    /// The Laplacian of the potential: the least in its valleys.
    Laplacian,
    /// An image with a distance in samples for each sample.
    File(PathBuf),
}

/// How a lattice begins.
#[derive(Debug, Clone, PartialEq)]
pub enum Start {
    /// A regular lattice fitted to the box: face-centred cubic, triangular in 2-D.
    Fcc,
    /// A regular lattice grown from fixed atoms (wells), or from the middle of the box.
    Grown,
    /// Delaunay refinement: isotropic.
    Refine,
    /// Drawn at random, first where features are strong (guide tables).
    Guide {
        /// Most atoms; as many as find room if `None`.
        most: Option<usize>,
    },
    /// Sites of a fine lattice projected onto features.
    Projection,
}

/// Wells along trajectories.
#[derive(Debug, Clone, PartialEq)]
pub struct Wells {
    /// Files of lines x,y,z,radius (x,y,radius in 2-D), in the image's physical coordinates.
    pub files: Vec<PathBuf>,
    /// Distance between atoms at wells, in samples; as elsewhere if `None`.
    pub distance: Option<f64>,
}

/// What makes depth of two-way time, which velocities in m/s do.
#[derive(Debug, Clone, PartialEq)]
pub enum VelocityFrom {
    /// The same everywhere.
    Constant(f64),
    /// An image of interval velocities in two-way time, on a grid of its own.
    File(PathBuf),
}

impl From<String> for VelocityFrom {
    /// A number, or else the name of a file.
    fn from(text: String) -> Self {
        match text.trim().parse() {
            Ok(number) => Self::Constant(number),
            Err(_) => Self::File(text.into()),
        }
    }
}

impl Display for VelocityFrom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Constant(number) => write!(f, "{number}"),
            // A name that is no UTF-8 came from no text.
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

/// Weight of the image against the lattice, in [0, 1).
#[derive(Debug, Clone, PartialEq)]
pub enum BetaFrom {
    /// The same everywhere.
    Constant(f64),
    /// An image with a weight for each sample.
    File(PathBuf),
}

/// The energy of a lattice, by its evaluator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LatticeEnergy {
    /// Neighbour lists and exact gradients.
    Pairwise {
        /// Weight in [0, 1] of the energy between atoms against their Laplacian coordinates; 1, without
        /// these, by default.
        kappa: f64,
    },
    /// Accumulated on the image's grid, as published in 2001.
    Sampled,
}

impl LatticeEnergy {
    /// Its evaluator.
    pub fn evaluator(self) -> Evaluator {
        match self {
            Self::Pairwise { .. } => Evaluator::Pairwise,
            Self::Sampled => Evaluator::Sampled,
        }
    }

    /// Weight of the energy between atoms against their Laplacian coordinates.
    pub fn kappa(self) -> f64 {
        match self {
            Self::Pairwise { kappa } => kappa,
            Self::Sampled => 1.0,
        }
    }
}

/// What a mesh is made of.
#[derive(Debug, Clone, PartialEq)]
pub enum Cells {
    /// Tetrahedra, in 2-D triangles, of atoms on features.
    Simplices {
        /// How slivers are removed.
        slivers: Slivers,
        /// How triangles are smoothed where the image is flat (2-D), if they shall be.
        smooth: Option<Scheme>,
    },
    /// Voronoi cells (PEBI): polyhedra, in 2-D polygons, of atoms alongside features.
    Voronoi {
        /// Nodes nearer to one another than this share of the cells' radius, at most 0.2, are welded; 0
        /// by default.
        weld: f64,
    },
}

impl Default for Cells {
    fn default() -> Self {
        Self::Simplices {
            slivers: Slivers::default(),
            smooth: None,
        }
    }
}

/// What becomes of slivers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Slivers {
    /// They are removed.
    Removed {
        /// How.
        method: improve::SliverMethod,
        /// Smallest dihedral angle aimed at, in degrees, the largest being 180 minus it; in 2-D the
        /// smallest angle. 30 by default, at most 60.
        min_dihedral: f64,
    },
    /// The Delaunay triangulation without improvement.
    Left,
}

impl Default for Slivers {
    fn default() -> Self {
        Self::Removed {
            method: improve::SliverMethod::Joe,
            min_dihedral: 30.0,
        }
    }
}

/// The length of a sample along each axis of lattice space, before the number of axes is known.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum LatticeSpace {
    /// 1 each.
    #[default]
    Samples,
    /// The image's spacing.
    Physical,
    /// The same times one factor, such that a cube of lattice space holds as many samples as ever.
    Shape,
    /// As given, x first.
    Scales(Vec<f64>),
}

/// What is written besides, and where.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Outputs {
    /// The mesh; named after the image if `None`.
    pub mesh: Option<PathBuf>,
    /// The report, as JSON.
    pub report: Option<PathBuf>,
    /// The potential b(x).
    pub potential: Option<PathBuf>,
    /// The acute lines of tetrahedra or triangles.
    pub lines: Option<PathBuf>,
    /// The page to look at.
    pub page: Option<PathBuf>,
    /// The faces on features, with the number of the surface of each.
    pub surfaces: Option<PathBuf>,
    /// The folder in which the results of stages are kept.
    pub checkpoint: Option<PathBuf>,
}

impl Job {
    /// The lattice, unless atoms are placed otherwise.
    pub fn lattice(&self) -> Option<&LatticeJob> {
        match &self.placement {
            PlacementJob::Lattice(lattice) => Some(lattice),
            PlacementJob::Canny => None,
        }
    }

    /// All that decides the result, and nothing of where it is written.
    pub fn reproducible(mut self) -> Self {
        self.outputs = Outputs::default();
        if let PlacementJob::Lattice(lattice) = &mut self.placement {
            lattice.trace = None;
        }
        self
    }
}
