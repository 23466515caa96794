//! Options of a job from a configuration file.

use std::collections::BTreeSet;
use std::path::Path;

use super::MeshSpec;
use crate::error::{cause, io_error};
use crate::{Error, Result};

impl MeshSpec {
    /// Returns the options that `names` lists, and those of a configuration file (TOML) for all
    /// others, checked and [resolved](Self::resolved).
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be read, and [`Error::Job`] if it holds anything but
    /// options, or for an option that is impossible.
    pub fn with_config(self, names: &BTreeSet<String>, config: Option<&Path>) -> Result<Self> {
        let Some(path) = config else {
            self.validate()?;
            return Ok(self.resolved());
        };
        let text = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
        let from_file: Self = toml::from_str(&text).map_err(|e| {
            let line = e
                .span()
                .map_or(1, |span| 1 + text[..span.start].matches('\n').count());
            Error::Job(cause(
                format!("{}:{line}", path.display()),
                e.message().replace('\n', ", "),
                "atomesh mesh --print-config shows how it is written",
            ))
            .with_source(e)
        })?;
        let spec = self.with_fallback(names, &from_file)?;
        spec.validate().map_err(|error| {
            // The place begins with the name of an option, which may be that of the file.
            let place = &error.cause().place;
            let option = place.split(' ').next().unwrap_or_default();
            if names.contains(option) {
                return error;
            }
            let place = format!("{}: {place}", path.display());
            error.with_place(place)
        })?;
        Ok(spec.resolved())
    }

    /// Returns the options that `names` lists, and those of `fallback` for all others.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if the name of a file is not valid UTF-8.
    fn with_fallback(self, names: &BTreeSet<String>, fallback: &Self) -> Result<Self> {
        let mut merged = fallback.to_table()?;
        for (name, value) in self.to_table()? {
            match (merged.get_mut(&name), value) {
                (Some(toml::Value::Table(lower)), toml::Value::Table(upper)) => {
                    lower.extend(upper.into_iter().filter(|(name, _)| names.contains(name)));
                }
                (_, value) if names.contains(&name) => {
                    merged.insert(name, value);
                }
                _ => {}
            }
        }
        // Both tables were written by the type that reads them.
        Ok(merged.try_into().unwrap_or(self))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::spec::NominalDistance;

    #[test]
    fn named_options_win_over_those_of_a_file() {
        let file =
            "distance = 5\nsigma = 1.0\nbeta = 0.25\nkappa = 0.7\n[input]\nraw = \"2x3x4:u8\"";
        let file: MeshSpec = toml::from_str(file).unwrap();
        let mut spec = MeshSpec {
            sigma: Some(2.0),
            kappa: 1.0,
            ..MeshSpec::default()
        };
        spec.input.spacing = Some("3".into());
        let names = ["sigma", "kappa", "spacing"].map(String::from).into();
        let merged = spec.with_fallback(&names, &file).unwrap();
        assert_eq!(merged.sigma, Some(2.0));
        assert_eq!(merged.distance, NominalDistance::Constant(5.0));
        assert_eq!(merged.beta.to_string(), "0.25");
        assert_eq!(merged.kappa, 1.0, "named, though it is the default");
        assert_eq!(merged.input.raw.as_deref(), Some("2x3x4:u8"));
        assert_eq!(merged.input.spacing.as_deref(), Some("3"));
    }
}
