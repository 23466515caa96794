//! Facts about the job that made a mesh, on which the verdict depends.

use serde_json::Value;

use crate::feature::FeatureKind;

/// Options of a job on which the verdict depends.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct JobFacts<'a> {
    /// Seed of the random numbers.
    pub seed: u64,
    /// Kind of feature that was searched.
    pub feature: Option<FeatureKind>,
    /// Threshold of the features, if one was given.
    pub threshold: Option<f64>,
    /// Target for the smallest angle, if one was given.
    pub min_angle: Option<f64>,
    /// `true` if slivers were not removed.
    pub keeps_slivers: bool,
    /// `true` if atoms are at Canny's points.
    pub has_canny_atoms: bool,
    /// Distance between atoms, or its limits.
    pub distance: &'a str,
}

impl<'a> JobFacts<'a> {
    /// Reads the facts from the parameters in a report; `None` if no job made the mesh.
    pub fn from_parameters(parameters: &'a Value) -> Option<Self> {
        let text = |name: &str| parameters[name].as_str();
        parameters.is_object().then(|| Self {
            seed: parameters["rng-seed"].as_u64().unwrap_or(1),
            feature: text("feature").and_then(|name| name.parse().ok()),
            threshold: text("threshold").and_then(|threshold| threshold.parse().ok()),
            min_angle: parameters["min-dihedral"].as_f64(),
            keeps_slivers: text("slivers") == Some("none"),
            has_canny_atoms: text("seeding") == Some("canny"),
            distance: text("distance").unwrap_or("2.7:8"),
        })
    }
}
