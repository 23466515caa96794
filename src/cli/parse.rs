//! Parsers of option values.

use crate::error::cause;
use crate::{Error, Result};

/// Returns an [`Error::Job`] about an option.
pub fn option_error(option: &str, value: &str, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(format!("{option} {value}"), problem, remedy))
}

/// Parses a finite number.
pub fn number(option: &str, text: &str, remedy: &str) -> Result<f64> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(option_error(option, text, "is not a finite number", remedy)),
        Err(_) => Err(option_error(option, text, "is not a number", remedy)),
    }
}
