//! Options of the command line, and errors of the library about them.

use std::collections::BTreeSet;
use std::path::Path;

use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches};

use crate::image::formats::{InputOptions, ReadOptions};
use crate::job::MeshSpec;
use crate::{Error, Result};

/// Options, with the names of those that were typed.
#[derive(Debug, Clone)]
pub struct Typed<T> {
    /// All options; those that were not typed have their defaults.
    pub options: T,
    /// Names of the options that were typed, without the hyphens before them.
    pub names: BTreeSet<String>,
}

impl<T: Args> Args for Typed<T> {
    fn augment_args(command: Command) -> Command {
        T::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        T::augment_args_for_update(command)
    }
}

impl<T: FromArgMatches> FromArgMatches for Typed<T> {
    fn from_arg_matches(matches: &ArgMatches) -> std::result::Result<Self, clap::Error> {
        Self::from_arg_matches_mut(&mut matches.clone())
    }

    fn from_arg_matches_mut(matches: &mut ArgMatches) -> std::result::Result<Self, clap::Error> {
        let ids = matches.ids().map(clap::Id::as_str);
        let is_typed = |id: &&str| matches.value_source(id) == Some(ValueSource::CommandLine);
        let names = ids
            .filter(is_typed)
            .map(|id| id.replace('_', "-"))
            .collect();
        Ok(Self {
            options: T::from_arg_matches_mut(matches)?,
            names,
        })
    }

    fn update_from_arg_matches(
        &mut self,
        matches: &ArgMatches,
    ) -> std::result::Result<(), clap::Error> {
        self.options.update_from_arg_matches(matches)
    }
}

impl Typed<MeshSpec> {
    /// Returns the options that were typed, and those of `fallback` for all others.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if the name of a file is not valid UTF-8.
    pub fn with_fallback(&self, fallback: &MeshSpec) -> Result<MeshSpec> {
        let mut merged = fallback.to_table()?;
        let is_typed = |name: &str| self.names.contains(name);
        for (name, value) in self.options.to_table()? {
            match (merged.get_mut(&name), value) {
                (Some(toml::Value::Table(lower)), toml::Value::Table(upper)) => {
                    lower.extend(upper.into_iter().filter(|(name, _)| is_typed(name)));
                }
                (_, value) if is_typed(&name) => {
                    merged.insert(name, value);
                }
                _ => {}
            }
        }
        // Both tables were written by the type that reads them.
        Ok(merged.try_into().unwrap_or_else(|_| self.options.clone()))
    }
}

/// Returns an error of the library with option names as on the command line: a place that begins
/// with the name of an option of `T` gets its two hyphens.
pub fn with_option_name<T: Args>(error: Error) -> Error {
    match option_name::<T>(&error.cause().place) {
        Some(_) => {
            let place = format!("--{}", error.cause().place);
            error.with_place(place)
        }
        None => error,
    }
}

/// Returns the name of the option of `T` with which the place of an error begins.
pub fn option_name<T: Args>(place: &str) -> Option<&str> {
    let name = place.split(' ').next()?;
    let options = T::augment_args(Command::new("options"));
    let is_known = options
        .get_arguments()
        .any(|option| option.get_long() == Some(name));
    is_known.then_some(name)
}

/// Returns the options for reading an image, from its file name and the typed options.
///
/// # Errors
/// Returns the errors of [`InputOptions::read_options_for`], with option names as on the command
/// line.
pub fn read_options(input: &InputOptions, path: &Path) -> Result<ReadOptions> {
    input
        .read_options_for(path)
        .map_err(with_option_name::<InputOptions>)
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use serde::Serialize;
    use serde::de::DeserializeOwned;

    use super::*;
    use crate::assess::ReportSpec;
    use crate::assess::quality::QualitySpec;
    use crate::edit::EditSpec;
    use crate::export::ExportSpec;
    use crate::export::convert::ConvertSpec;
    use crate::image::synth::SynthSpec;
    use crate::job::FeatureSpec;
    use crate::job::spec::NominalDistance;
    use crate::model::columns::ColumnsSpec;
    use crate::model::flow::FlowSpec;
    use crate::model::slice::SliceSpec;
    use crate::surfaces::SurfaceSpec;

    fn typed(words: &[&str]) -> Typed<MeshSpec> {
        let command = Typed::<MeshSpec>::augment_args(Command::new("mesh"));
        let matches = command.get_matches_from([&["mesh"], words].concat());
        Typed::from_arg_matches(&matches).unwrap()
    }

    #[test]
    fn typed_options_win_over_those_of_a_file() {
        let file =
            "distance = 5\nsigma = 1.0\nbeta = 0.25\nkappa = 0.7\n[input]\nraw = \"2x3x4:u8\"";
        let file: MeshSpec = toml::from_str(file).unwrap();
        let merged = typed(&["--sigma", "2", "--kappa", "1", "--spacing", "3"])
            .with_fallback(&file)
            .unwrap();
        assert_eq!(merged.sigma, Some(2.0));
        assert_eq!(merged.distance, NominalDistance::Constant(5.0));
        assert_eq!(merged.beta.to_string(), "0.25");
        assert_eq!(merged.kappa, 1.0, "typed, though it is the default");
        assert_eq!(merged.input.raw.as_deref(), Some("2x3x4:u8"));
        assert_eq!(merged.input.spacing.as_deref(), Some("3"));
    }

    /// Checks that options that are not typed have the defaults of the type, also in JSON.
    fn check_defaults<T>()
    where
        T: Args + Default + PartialEq + Debug + Serialize + DeserializeOwned,
    {
        let command = T::augment_args(Command::new("verb"));
        let parsed = T::from_arg_matches(&command.get_matches_from(["verb"])).unwrap();
        assert_eq!(parsed, T::default());
        let json = serde_json::to_value(&parsed).unwrap();
        assert_eq!(serde_json::from_value::<T>(json).unwrap(), parsed);
        assert_eq!(
            serde_json::from_str::<T>("{}").unwrap(),
            parsed,
            "an empty table"
        );
    }

    #[test]
    fn without_options_a_spec_has_its_defaults() {
        check_defaults::<MeshSpec>();
        check_defaults::<FlowSpec>();
        check_defaults::<SurfaceSpec>();
        check_defaults::<ExportSpec>();
        check_defaults::<FeatureSpec>();
        check_defaults::<SliceSpec>();
        check_defaults::<ColumnsSpec>();
        check_defaults::<EditSpec>();
        check_defaults::<ConvertSpec>();
        check_defaults::<QualitySpec>();
        check_defaults::<ReportSpec>();
        check_defaults::<SynthSpec>();
    }
}
