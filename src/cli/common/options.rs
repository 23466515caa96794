//! Options of the command line, and errors of the library about them.

use std::collections::BTreeSet;

use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches};

use crate::Error;

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
        // Structs of options are groups, which have the names of their types.
        let is_group = |id: &str| id.starts_with(char::is_uppercase);
        let is_typed =
            |id: &&str| !is_group(id) && matches.value_source(id) == Some(ValueSource::CommandLine);
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
fn option_name<T: Args>(place: &str) -> Option<&str> {
    let name = place.split(' ').next()?;
    let options = T::augment_args(Command::new("options"));
    let is_known = options
        .get_arguments()
        .any(|option| option.get_long() == Some(name));
    is_known.then_some(name)
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
    use crate::job::{FeatureSpec, MeshSpec};
    use crate::model::columns::ColumnsSpec;
    use crate::model::flow::FlowSpec;
    use crate::model::slice::SliceSpec;
    use crate::surfaces::SurfaceSpec;

    #[test]
    fn typed_options_are_listed() {
        let command = Typed::<MeshSpec>::augment_args(Command::new("mesh"));
        let words = ["mesh", "--sigma", "2", "--kappa", "1", "--spacing", "3"];
        let typed = Typed::<MeshSpec>::from_arg_matches(&command.get_matches_from(words)).unwrap();
        assert_eq!(typed.options.sigma, Some(2.0));
        let names: Vec<&str> = typed.names.iter().map(String::as_str).collect();
        assert_eq!(
            names,
            ["kappa", "sigma", "spacing"],
            "also if it is the default"
        );
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
