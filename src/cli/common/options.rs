//! Errors of the library, which knows settings, in the words of the command line, which has options.

use clap::{Args, Command};

use crate::job::settings::Settings;
use crate::{Error, Result};

/// An error that begins with the name of a setting begins with the option's.
pub fn with_option_name(error: Error) -> Error {
    match setting_name(&error.cause().place) {
        Some(_) => {
            let place = format!("--{}", error.cause().place);
            error.with_place(place)
        }
        None => error,
    }
}

/// The setting with whose name a place begins.
pub fn setting_name(place: &str) -> Option<&str> {
    let name = place.split(' ').next()?;
    let settings = Settings::augment_args(Command::new("settings"));
    let known = settings
        .get_arguments()
        .any(|option| option.get_long() == Some(name));
    known.then_some(name)
}

/// What a verb makes of an image's options and file.
///
/// # Errors
/// As [`InputOptions::for_file`](crate::image::formats::InputOptions::for_file), in the words of the
/// command line.
pub fn read_options(
    input: &crate::image::formats::InputOptions,
    path: &std::path::Path,
) -> Result<crate::image::formats::ReadOptions> {
    input.read_options_for(path).map_err(with_option_name)
}
