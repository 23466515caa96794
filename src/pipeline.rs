//! The whole job: image in, mesh out. The command line and any other front end call this.
//!
//! [`mesh_image`] works in *lattice space* (sample index times a step per axis); [`to_file`] puts
//! the outcome where the image lies in the world.

pub mod cost;

use crate::image::{Geometry, Image};

/// How far atoms shall be apart, in lattice units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spacing {
    /// The same everywhere.
    Constant(f64),
    /// `min` on features, growing to `max` away from them.
    FromFeatures {
        /// Distance on features.
        min: f64,
        /// Distance far from them.
        max: f64,
    },
}

impl Spacing {
    /// The smallest distance asked for.
    pub fn min(self) -> f64 {
        match self {
            Self::Constant(d) => d,
            Self::FromFeatures { min, .. } => min,
        }
    }

    /// The largest distance asked for.
    pub fn max(self) -> f64 {
        match self {
            Self::Constant(d) => d,
            Self::FromFeatures { max, .. } => max,
        }
    }
}

/// The length of one sample along each axis of lattice space, which says in which space cells
/// shall be well shaped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Metric {
    /// 1: cells are as flat as the image's own samples.
    Samples,
    /// The image's physical spacing.
    Physical,
    /// As given.
    Scales([f64; 3]),
}

impl Metric {
    /// The step of lattice space along each axis.
    pub fn step(self, geometry: &Geometry<3>) -> [f64; 3] {
        match self {
            Self::Samples => [1.0; 3],
            Self::Physical => geometry.spacing(),
            Self::Scales(step) => step,
        }
    }
}

/// The weight of the image against the lattice: 0 is lattice only, 1 image only.
#[derive(Debug, Clone, PartialEq)]
pub enum Weight {
    /// The same everywhere.
    Constant(f64),
    /// An image of weights, of the same dims as the image to mesh.
    Image(Image<3>),
}

/// Which evaluator of the lattice energy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evaluator {
    /// Neighbour lists and exact gradients.
    Pairwise,
    /// Accumulated on the image's grid (Hale 2001, Algorithm 1).
    Sampled,
}

/// The stages of the job, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Image to potential.
    Features,
    /// Nominal distance and first atoms.
    Seeding,
    /// Atoms move onto the features.
    Optimise,
    /// Atoms are joined.
    Delaunay,
    /// Slivers go.
    Improve,
    /// Figures of the result.
    Measure,
}

impl Stage {
    /// What the stage does, for a progress line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Features => "finding features",
            Self::Seeding => "placing atoms",
            Self::Optimise => "moving atoms onto features",
            Self::Delaunay => "joining atoms",
            Self::Improve => "removing slivers",
            Self::Measure => "measuring the mesh",
        }
    }
}

/// Watches a job and may ask it to stop.
pub trait Observer {
    /// A stage begins; the one before it is over.
    fn begin(&mut self, _stage: Stage) {}

    /// A share in [0, 1] of the stage is done.
    fn progress(&mut self, _share: f64) {}

    /// Something that whoever started the job should know.
    fn note(&mut self, _line: &str) {}

    /// The lattice after a round of optimisation (round 0: before the first), in lattice space.
    fn lattice(&mut self, _round: usize, _atoms: &[[f64; 3]]) {}

    /// Whether to stop: optimisation then ends with the best lattice so far, which is still meshed.
    fn stop(&mut self) -> bool {
        false
    }
}

/// An observer that looks away.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {}
