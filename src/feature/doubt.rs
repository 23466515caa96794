//! Decisions that the values of an image leave open.

use super::FeatureKind;
use serde::Serialize;

/// A choice between two kinds of features that an image does not decide.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Doubt {
    /// The question, and what was assumed.
    pub question: String,
    /// The kind that was assumed.
    pub assumed: FeatureKind,
    /// The kind that it may be instead.
    pub other: FeatureKind,
}
