//! Watching, and stopping, long work.

use crate::lattice::energy::Parts;

/// Where an optimisation stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Rounds of perturbation begun, from 1.
    pub round: usize,
    /// Steps accepted, over all rounds.
    pub iterations: usize,
    /// Evaluations of the energy, over all rounds.
    pub evaluations: usize,
    /// P now.
    pub energy: f64,
    /// A and B now.
    pub parts: Parts,
}

/// Sees what goes on inside the library, which itself never prints, and may ask it to stop. All
/// methods have a default that does nothing.
pub trait Observer {
    /// A stage of the pipeline begins.
    fn stage(&mut self, _name: &str) {}

    /// A step of the optimiser has been accepted.
    fn progress(&mut self, _progress: &Progress) {}

    /// A round of the optimiser has ended with these positions (lattice space).
    fn round(&mut self, _round: usize, _positions: &[[f64; 3]]) {}

    /// Whether to go on; `false` ends the work soon, with the best result so far.
    fn keep_going(&mut self) -> bool {
        true
    }
}

/// An observer that does not look.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {}
