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

/// Splits a text into two or three values at commas.
fn split_coordinates<'a>(option: &str, text: &'a str, remedy: &str) -> Result<Vec<&'a str>> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    match parts.len() {
        2 | 3 => Ok(parts),
        count => Err(option_error(
            option,
            text,
            &format!("has {count} values, not 2 or 3"),
            remedy,
        )),
    }
}

/// Parses `NX,NY,NZ`, or `NX,NY` for a 2-D image: at least two samples along each axis, and at most
/// 2^32 in all.
pub fn dims(option: &str, text: &str) -> Result<Vec<usize>> {
    let remedy = "give two or three whole numbers such as 256,256 or 96,80,64";
    let mut dims = Vec::new();
    for word in split_coordinates(option, text, remedy)? {
        let dim: usize = word
            .parse()
            .map_err(|_| option_error(option, text, "is not made of whole numbers", remedy))?;
        dims.push(dim);
        if dim < 2 {
            return Err(option_error(
                option,
                text,
                "has an axis of fewer than 2 samples",
                remedy,
            ));
        }
    }
    let samples = dims
        .iter()
        .try_fold(1_usize, |product, &dim| product.checked_mul(dim));
    // 2^32 samples take 16 GiB; an allocation beyond that would fail without a message.
    match samples {
        Some(samples) if samples as u64 <= 1 << 32 => Ok(dims),
        _ => Err(option_error(
            option,
            text,
            "is more than 2^32 samples",
            "give smaller dimensions",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dims_that_overflow_are_refused() {
        assert_eq!(dims("--dims", "3, 4,5").unwrap(), [3, 4, 5]);
        for wrong in [
            "4294967296,4294967296,4294967296",
            "1,5,5",
            "3",
            "3,4,5,6",
            "-3,4,5",
            "a,b,c",
        ] {
            assert!(dims("--dims", wrong).is_err(), "{wrong}");
        }
    }
}
