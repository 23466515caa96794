//! What is said of a flow that was computed.

use std::fmt::Write;

use serde::Serialize;

use super::system::SolveStats;

/// The figures of a flow.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FlowReport {
    /// How pressures were found.
    pub solver: SolveStats,
    /// The lowest and the highest pressure, Pa.
    pub pressure: ValueRange,
    /// All faults together.
    pub faults: FaultStats,
    /// Each fault, by the number that `surface` gives.
    pub by_fault: Vec<FaultReport>,
    /// Where fluid enters or leaves.
    pub exchange: Vec<Exchange>,
}

/// From the least to the largest value.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[allow(missing_docs)]
pub struct ValueRange {
    pub min: f64,
    pub max: f64,
}

impl ValueRange {
    /// Of all values.
    pub fn from_values(values: &[f64]) -> Self {
        let all = values.iter();
        let (min, max) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &v| {
            (low.min(v), high.max(v))
        });
        Self { min, max }
    }
}

/// What faults do to a flow.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct FaultStats {
    /// Number of their faces.
    pub faces: usize,
    /// Nodes that exist once for each side.
    pub doubled_nodes: usize,
    /// Sum of the rates across faces, whatever their direction, m^3/s.
    pub total_rate_across: f64,
    /// The largest jump of pressure across a face, Pa.
    pub max_jump: f64,
}

impl FaultStats {
    /// Counts one face.
    pub fn add(&mut self, rate: f64, jump: f64) {
        self.faces += 1;
        self.total_rate_across += rate.abs();
        self.max_jump = self.max_jump.max(jump.abs());
    }
}

/// What one fault does.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultReport {
    /// Its number, from 1.
    pub surface: u32,
    /// Its name, as exports have it.
    pub name: String,
    /// Its factor of permeability or transmissibility.
    pub multiplier: f64,
    /// What it does.
    #[serde(flatten)]
    pub stats: FaultStats,
}

/// A place where fluid enters or leaves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Exchange {
    /// What it is called.
    pub name: String,
    /// What enters there, m^3/s.
    pub rate: f64,
}

impl FlowReport {
    /// Faults that the table lists.
    const MAX_LISTED_FAULTS: usize = 12;

    /// As lines of text.
    pub fn table(&self) -> String {
        let Self {
            solver: figures,
            faults,
            ..
        } = self;
        let mut text = format!(
            "unknowns      {} ({} nodes doubled on {} faces of faults), {} compartment{}\n",
            figures.unknowns,
            faults.doubled_nodes,
            faults.faces,
            figures.compartments,
            if figures.compartments == 1 { "" } else { "s" },
        );
        // Writing to a string does not fail.
        if figures.undetermined > 0 {
            let _ = writeln!(
                text,
                "pockets       {} unknowns that no pressure or source reaches: nothing flows, pressure 0",
                figures.undetermined
            );
        }
        let _ = write!(
            text,
            "solver        {} iterations, residual {:.1e}\n\
             pressure      {:.6e} to {:.6e} Pa\n\
             faults        {:.6e} m^3/s across, largest jump {:.6e} Pa\n\
             throughput    {:.6e} m^3/s\n\
             imbalance     {:.1e} of the throughput in the worst control volume, {:.1e} in all",
            figures.iterations,
            figures.residual,
            self.pressure.min,
            self.pressure.max,
            faults.total_rate_across,
            faults.max_jump,
            figures.throughput,
            figures.max_imbalance,
            figures.total_imbalance,
        );
        for FaultReport {
            name,
            multiplier,
            stats: faulted,
            ..
        } in self.by_fault.iter().take(Self::MAX_LISTED_FAULTS)
        {
            let _ = write!(
                text,
                "\n{name:<13} {} faces, multiplier {multiplier}: {:.6e} m^3/s across, \
                 largest jump {:.6e} Pa",
                faulted.faces, faulted.total_rate_across, faulted.max_jump
            );
        }
        if self.by_fault.len() > Self::MAX_LISTED_FAULTS {
            let more = self.by_fault.len() - Self::MAX_LISTED_FAULTS;
            let _ = write!(text, "\n... and {more} smaller faults");
        }
        for Exchange { name, rate } in &self.exchange {
            let _ = write!(text, "\n{rate:+13.6e} m^3/s  {name}");
        }
        text
    }
}
