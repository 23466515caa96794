//! Watching, and stopping, long work.

use std::fmt;

use serde::{Serialize, Serializer};

/// What is being done: a step of making or editing a mesh, in this order as far as a job takes them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Stage {
    /// Files are read.
    Reading,
    /// Features are sought in the image.
    Features,
    /// Atoms are placed.
    Placing,
    /// Atoms move onto features, or alongside.
    Optimising,
    /// Atoms alongside features become pairs (Voronoi cells).
    Pairing,
    /// Voronoi cells are cut.
    Cutting,
    /// Atoms are joined.
    Joining,
    /// A triangulation of the plane is smoothed under the weight of its image.
    Smoothing,
    /// Slivers are removed by the method that is only compared with.
    Comparing,
    /// Features are recovered and slivers removed.
    Improving,
    /// The mesh is measured.
    Measuring,
    /// Files are written.
    Writing,
    /// Of an edit: features are sought everywhere, as the mesh does not say how they were found.
    FeaturesEverywhere,
    /// Of an edit: what of the mesh it concerns.
    Neighbourhoods,
    /// Of an edit: atoms around the edited ones.
    Neighbours,
    /// Of an edit: these move.
    Moving,
    /// Of an edit: cells are made anew.
    Mending,
    /// Of an edit: the parts become one mesh.
    Assembling,
}

impl Stage {
    /// Whether a job that is stopped in this stage still gives a mesh: there is a lattice.
    pub fn has_lattice(self) -> bool {
        (Self::Optimising..=Self::Writing).contains(&self)
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Reading => "reading",
            Self::Features => "finding features",
            Self::Placing => "placing atoms",
            Self::Optimising => "moving atoms onto features",
            Self::Pairing => "pairing atoms",
            Self::Cutting => "cutting cells",
            Self::Joining => "joining atoms",
            Self::Smoothing => "smoothing",
            Self::Comparing => "removing slivers the other way",
            Self::Improving => "removing slivers",
            Self::Measuring => "measuring the mesh",
            Self::Writing => "writing",
            Self::FeaturesEverywhere => "finding features everywhere",
            Self::Neighbourhoods => "finding neighbourhoods",
            Self::Neighbours => "finding neighbours",
            Self::Moving => "moving atoms",
            Self::Mending => "mending the mesh",
            Self::Assembling => "putting it together",
        })
    }
}

impl Serialize for Stage {
    /// The words of [`fmt::Display`].
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Where an optimisation stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Rounds of perturbation begun, from 1.
    pub round: usize,
    /// Steps accepted, over all rounds.
    pub iterations: usize,
    /// Evaluations of the energy, over all rounds.
    pub evaluations: usize,
    /// P = (1 - beta) A + beta B now.
    pub energy: f64,
    /// A, of the lattice, now.
    pub lattice: f64,
    /// B, of the image, now.
    pub image: f64,
}

/// Sees what goes on inside the library, which itself never prints, and may ask it to stop. All
/// methods have a default that does nothing.
///
/// # Stopping
/// Every long stage asks [`keep_going`](Self::keep_going), most of them many times a second; a single
/// triangulation and a single pass over the image's samples run to their end. What a stop gives:
///
/// | asked for | gives |
/// |---|---|
/// | before atoms move ([`Stage::Reading`] to [`Stage::Placing`]) | [`Error::Interrupted`](crate::Error::Interrupted) |
/// | while they move ([`Stage::Optimising`], [`Stage::Pairing`]) | the best lattice so far, joined and improved |
/// | while the mesh is smoothed or improved | the mesh as far as it has come: valid, with more slivers or edges across features |
/// | while it is measured | the mesh, with fewer figures |
/// | in an edit | [`Error::Interrupted`](crate::Error::Interrupted): the mesh stays as it was |
///
/// A mesh of a job that was stopped says so: its `stop` is
/// [`Stop::Interrupted`](crate::lattice::optimize::Stop::Interrupted). Every stage asks afresh: an
/// observer that goes on saying no from stage to stage leaves out all that can be left out.
pub trait Observer {
    /// A stage begins.
    fn stage(&mut self, _stage: Stage) {}

    /// A step of the optimiser has been accepted.
    fn progress(&mut self, _progress: &Progress) {}

    /// A round of the optimiser has ended with these positions (lattice space).
    fn round(&mut self, _round: usize, _positions: &[[f64; 3]]) {}

    /// Whether to go on; `false` ends the stage soon.
    fn keep_going(&mut self) -> bool {
        true
    }
}

/// An observer that does not look.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {}

/// Asks an observer whether to go on, in loops of many short steps only now and then; once told to
/// stop, it does not ask again.
pub struct Patience<'a> {
    ask: Option<&'a mut dyn FnMut() -> bool>,
    steps: u32,
    over: bool,
}

impl<'a> Patience<'a> {
    /// Without end.
    pub fn endless() -> Self {
        Self {
            ask: None,
            steps: 0,
            over: false,
        }
    }

    /// Until `ask` says no.
    pub fn new(ask: &'a mut dyn FnMut() -> bool) -> Self {
        Self {
            ask: Some(ask),
            ..Self::endless()
        }
    }

    /// Whether to stop here; asks once in 64 steps.
    #[inline]
    pub fn over(&mut self) -> bool {
        self.steps = self.steps.wrapping_add(1);
        if self.steps % 64 == 1
            && !self.over
            && let Some(ask) = &mut self.ask
        {
            self.over = !ask();
        }
        self.over
    }
}
