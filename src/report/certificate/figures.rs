//! Compares two certificates of the same image.

use super::{Certificate, PartClass, PartIssueKind};

/// Part of a figure by which it may grow without being worse.
const TOLERANCE: f64 = 0.05;

/// Part of a figure by which it must shrink to be better, unless it is a number of something.
const MIN_GAIN: f64 = 0.1;

/// Largest difference, in samples, of mean distances that count as equal.
const SAME_DISTANCE: f64 = 0.01;

/// A figure of a certificate that is zero for a perfect mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Figure {
    /// Its name, in words.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// The value up to which it is no issue.
    limit: f64,
}

impl Figure {
    /// Returns `true` if the figure is an issue.
    pub(crate) fn is_issue(&self) -> bool {
        self.value > self.limit
    }

    /// Returns `true` if the figure is better than `before`, which was an issue.
    pub(crate) fn is_better_than(&self, before: &Self) -> bool {
        self.value <= (1.0 - MIN_GAIN) * before.value
    }

    fn is_worse_than(&self, before: &Self) -> bool {
        self.value > self.limit.max((1.0 + TOLERANCE) * before.value)
    }
}

impl Certificate {
    /// Returns the figure that a kind of issue is about.
    pub(crate) fn figure(&self, kind: PartIssueKind) -> Figure {
        let figure = |name, value, limit| Figure { name, value, limit };
        let classes = self
            .classes
            .iter()
            .filter(|class| class.class != PartClass::Speck);
        match kind {
            PartIssueKind::Pinch => figure(
                "the number of nodes at which parts touch that are apart",
                self.pinch_count as f64,
                0.0,
            ),
            PartIssueKind::Lost => figure(
                "the number of samples of lost parts",
                self.lost_samples as f64,
                0.0,
            ),
            PartIssueKind::Volume => {
                let errors = classes.filter_map(|class| {
                    let error = class.worst_volume.as_ref()?.volume_error_percent.abs();
                    Some(error / class.class.max_volume_error()?)
                });
                let name = "the largest error of a volume, as a multiple of what is no issue,";
                figure(name, errors.fold(0.0, f64::max), 1.0)
            }
            PartIssueKind::Euler => {
                let count: usize = classes.map(|class| class.wrong_euler).sum();
                figure(
                    "the number of parts with a wrong Euler number",
                    count as f64,
                    0.0,
                )
            }
            PartIssueKind::Boundary => {
                let least = classes.fold(1.0, |least, class| class.min_boundary_share.min(least));
                let name = "the share of a part's boundary that lies more than a sample off";
                figure(name, 1.0 - least, 1.0 - super::MIN_BOUNDARY_SHARE)
            }
        }
    }

    /// Returns the name of the first figure, other than that of `kind`, that is worse than in the
    /// certificate `before`.
    pub(crate) fn worse_figure(&self, before: &Self, kind: PartIssueKind) -> Option<&'static str> {
        let kinds = [
            PartIssueKind::Pinch,
            PartIssueKind::Lost,
            PartIssueKind::Volume,
            PartIssueKind::Euler,
            PartIssueKind::Boundary,
        ];
        let figures = |certificate: &Self| {
            let mut figures = kinds.map(|kind| certificate.figure(kind)).to_vec();
            let mean = |distances: &Option<super::BoundaryDistances>| {
                distances.as_ref().map_or(0.0, |distances| distances.mean)
            };
            let other = |name, value, limit| Figure { name, value, limit };
            let changed = certificate.changed_samples as f64;
            figures.push(other(
                "the number of samples that changed sides",
                changed,
                0.0,
            ));
            let distance = mean(&certificate.boundary).max(mean(&certificate.faces));
            figures.push(other(
                "the mean distance of the boundaries",
                distance,
                SAME_DISTANCE,
            ));
            figures
        };
        let named = self.figure(kind).name;
        let pairs = figures(self).into_iter().zip(figures(before));
        let mut worse =
            pairs.filter(|(after, before)| after.name != named && after.is_worse_than(before));
        worse.next().map(|(after, _)| after.name)
    }
}
