//! The report of a computed flow.

use std::fmt::Write;

use serde::Serialize;

use super::system::SolveStats;

/// Statistics of a computed flow.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FlowReport {
    /// Statistics of the solver.
    pub solver: SolveStats,
    /// Lowest and highest pressure, Pa.
    pub pressure: ValueRange,
    /// All faults together.
    pub faults: FaultStats,
    /// Each fault, with the number that `atomesh surface` gives it.
    pub by_fault: Vec<FaultReport>,
    /// Wells and sides where fluid enters or leaves.
    pub exchange: Vec<Exchange>,
}

/// Smallest and largest value.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[allow(missing_docs)]
pub struct ValueRange {
    pub min: f64,
    pub max: f64,
}

impl ValueRange {
    /// Returns the range of all values.
    pub fn from_values(values: &[f64]) -> Self {
        let all = values.iter();
        let (min, max) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &v| {
            (low.min(v), high.max(v))
        });
        Self { min, max }
    }
}

/// Statistics of the flow across faults.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct FaultStats {
    /// Number of fault faces.
    pub faces: usize,
    /// Number of nodes that were added so that each side of a fault has its own.
    pub doubled_nodes: usize,
    /// Sum of the absolute rates across faces, m^3/s.
    pub total_rate_across: f64,
    /// Largest pressure jump across a face, Pa.
    pub max_jump: f64,
}

impl FaultStats {
    /// Adds one face with its rate and pressure jump.
    pub fn add(&mut self, rate: f64, jump: f64) {
        self.faces += 1;
        self.total_rate_across += rate.abs();
        self.max_jump = self.max_jump.max(jump.abs());
    }
}

/// Statistics of one fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultReport {
    /// The number of the fault's surface, from 1.
    pub surface: u32,
    /// The name of the fault, as in exports.
    pub name: String,
    /// The factor of permeability or transmissibility.
    pub multiplier: f64,
    /// Faces, rates and jumps of the fault.
    #[serde(flatten)]
    pub stats: FaultStats,
}

/// A well or side where fluid enters or leaves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Exchange {
    /// Its name.
    pub name: String,
    /// The rate at which fluid enters there, m^3/s.
    pub rate: f64,
}

impl FlowReport {
    /// Largest number of faults that the table lists.
    const MAX_LISTED_FAULTS: usize = 12;

    /// Returns the report as lines of text.
    pub fn table(&self) -> String {
        let Self { solver, faults, .. } = self;
        let mut text = format!(
            "unknowns      {} ({} nodes doubled on {} faces of faults), {} compartment{}\n",
            solver.unknowns,
            faults.doubled_nodes,
            faults.faces,
            solver.compartments,
            if solver.compartments == 1 { "" } else { "s" },
        );
        // Writing to a string does not fail.
        if solver.undetermined > 0 {
            let _ = writeln!(
                text,
                "pockets       {} unknowns that no pressure or source reaches: nothing flows, pressure 0",
                solver.undetermined
            );
        }
        let _ = write!(
            text,
            "solver        {} iterations, residual {:.1e}\n\
             pressure      {:.6e} to {:.6e} Pa\n\
             faults        {:.6e} m^3/s across, largest jump {:.6e} Pa\n\
             throughput    {:.6e} m^3/s\n\
             imbalance     {:.1e} of the throughput in the worst control volume, {:.1e} in all",
            solver.iterations,
            solver.residual,
            self.pressure.min,
            self.pressure.max,
            faults.total_rate_across,
            faults.max_jump,
            solver.throughput,
            solver.max_imbalance,
            solver.total_imbalance,
        );
        for FaultReport {
            name,
            multiplier,
            stats,
            ..
        } in self.by_fault.iter().take(Self::MAX_LISTED_FAULTS)
        {
            let _ = write!(
                text,
                "\n{name:<13} {} faces, multiplier {multiplier}: {:.6e} m^3/s across, \
                 largest jump {:.6e} Pa",
                stats.faces, stats.total_rate_across, stats.max_jump
            );
        }
        if self.by_fault.len() > Self::MAX_LISTED_FAULTS {
            let remaining = self.by_fault.len() - Self::MAX_LISTED_FAULTS;
            let _ = write!(text, "\n... and {remaining} smaller faults");
        }
        for Exchange { name, rate } in &self.exchange {
            let _ = write!(text, "\n{rate:+13.6e} m^3/s  {name}");
        }
        text
    }
}
