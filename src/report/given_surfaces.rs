//! How well the mesh follows the surfaces that the user gave, and which found surfaces have no face.

use serde::Serialize;

use super::issues::{Issue, MIN_FEATURE_SHARE};
use super::table::group_digits;
use super::verdict::percent;
use super::{Report, SurfaceCoverage};
use crate::feature::SurfaceName;

/// Maximum fraction of a given surface that may lie outside the image. More is an issue.
const MAX_OUTSIDE_SHARE: f64 = 0.5;

/// Maximum covered fraction of a surface that counts as a surface without faces: other surfaces cross
/// it.
const MAX_STRAY_SHARE: f64 = 0.1;

/// A surface that the user gave, and how much of it the mesh follows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GivenSurfaceReport {
    /// Name of the surface.
    pub name: String,
    /// Fraction of its area that lies outside the image.
    pub outside: f64,
    /// Fraction of its part in the image that lies within one sample of a face on a feature; `None`
    /// if it was not measured.
    pub coverage: Option<f64>,
}

impl Report {
    /// Adds the surfaces that the user gave. `outside` has the name of each and the fraction of its
    /// area outside the image, and `names` the numbers of surfaces.
    pub(crate) fn add_given_surfaces(
        &mut self,
        outside: Vec<(String, f64)>,
        names: &[SurfaceName],
    ) {
        let coverage = |name: &str| {
            let number = names.iter().find(|other| other.name == name)?.number;
            let surfaces = &self.fidelity.as_ref()?.surfaces;
            let surface = surfaces.iter().find(|s| s.surface == number);
            surface.map(SurfaceCoverage::share)
        };
        let report = |(name, outside): (String, f64)| GivenSurfaceReport {
            coverage: coverage(&name),
            name,
            outside,
        };
        self.given_surfaces = outside.into_iter().map(report).collect();
    }

    /// Returns the given surface of which the smallest fraction has faces, and this fraction.
    pub(super) fn least_covered_surface(&self) -> Option<(&GivenSurfaceReport, f64)> {
        let surfaces = self.given_surfaces.iter();
        let measured = surfaces.filter_map(|surface| Some((surface, surface.coverage?)));
        measured.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Returns the issue of a given surface that the mesh does not follow, or that lies mostly
    /// outside the image.
    pub(super) fn given_surface_issue(&self) -> Option<Issue> {
        let farthest = (self.given_surfaces.iter()).max_by(|a, b| a.outside.total_cmp(&b.outside));
        if let Some(surface) = farthest.filter(|surface| surface.outside > MAX_OUTSIDE_SHARE) {
            return Some(Issue {
                message: format!(
                    "{} % of the surface {} lie outside the image",
                    percent(surface.outside),
                    surface.name
                ),
                option: None,
                suggestion: "check its coordinates, units and sign of z against those of the image",
            });
        }
        let (surface, coverage) = self.least_covered_surface()?;
        (coverage < MIN_FEATURE_SHARE).then(|| {
            self.issue_for_finer_distance(
                format!(
                    "only {} % of the surface {} have faces",
                    percent(coverage),
                    surface.name
                ),
                "closer atoms cover more of it, with more cells",
            )
        })
    }

    /// Returns the issue of found surfaces that have no face at all. Parts of labels have their own
    /// issue.
    pub(super) fn faceless_surface_issue(&self) -> Option<Issue> {
        if self.regions.is_some() {
            return None;
        }
        let surfaces = &self.fidelity.as_ref()?.surfaces;
        let faceless = || surfaces.iter().filter(|s| s.share() < MAX_STRAY_SHARE);
        let largest = faceless().map(|s| s.points).max()?;
        let count = faceless().count();
        Some(self.issue_for_finer_distance(
            format!(
                "{} of {} found surfaces {} no face, the largest of {} samples",
                group_digits(count),
                group_digits(surfaces.len()),
                if count == 1 { "has" } else { "have" },
                group_digits(largest)
            ),
            "closer atoms follow smaller surfaces, with more cells",
        ))
    }
}
