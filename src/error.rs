//! The error type of the crate.
//!
//! An error has a kind, and a [`Cause`] that says where the fault is, what is wrong, what to do
//! about it, and which error led to it. The command line prints it as one line: `place: problem;
//! remedy`.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

/// The cause of an error: the place, the problem and the remedy.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Cause {
    /// The file, parameter or item that is at fault, e.g. `survey.sgy` or `distance`.
    pub place: String,
    /// The problem, with the numbers that show it. The text is complete: it includes the message of
    /// the source error.
    pub problem: String,
    /// The remedy: what the user can do.
    pub remedy: String,
    /// The parameter to change, e.g. `porosity`, if one is wrong or missing. A front end adds its
    /// own name for it, such as `--porosity`.
    pub parameter: Option<&'static str>,
    /// The error that led to this one.
    source: Option<Arc<dyn std::error::Error + Send + Sync>>,
}

impl Cause {
    /// Returns this cause with the error that led to it.
    pub fn with_source(mut self, source: impl std::error::Error + Send + Sync + 'static) -> Self {
        self.source = Some(Arc::new(source));
        self
    }

    /// Returns this cause with the parameter that has to be changed.
    pub fn with_parameter(mut self, parameter: &'static str) -> Self {
        self.parameter = Some(parameter);
        self
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.place, self.problem, self.remedy)
    }
}

/// Declares the kinds of errors in one place, for both [`Error`] and [`ErrorKind`].
macro_rules! kinds {
    ($($(#[$doc:meta])+ $name:ident,)+) => {
        /// Errors that the user's input can cause in any stage of atomesh.
        #[derive(Debug, Clone)]
        #[non_exhaustive]
        pub enum Error {
            $($(#[$doc])+ $name(Cause),)+
        }

        /// Kinds of errors, for programs that distinguish them.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[non_exhaustive]
        pub enum ErrorKind {
            $($(#[$doc])+ $name,)+
        }

        impl Error {
            /// Returns the kind of this error.
            pub fn kind(&self) -> ErrorKind {
                match self {
                    $(Self::$name(_) => ErrorKind::$name,)+
                }
            }

            /// Returns the place, the problem and the remedy.
            pub fn cause(&self) -> &Cause {
                match self {
                    $(Self::$name(cause) => cause,)+
                }
            }

            fn cause_mut(&mut self) -> &mut Cause {
                match self {
                    $(Self::$name(cause) => cause,)+
                }
            }
        }
    };
}

kinds! {
    /// A file cannot be opened, read, understood or written.
    Io,
    /// An image cannot be meshed (it holds NaN, is constant or too small ...).
    Image,
    /// Feature detection received a parameter or an image that it cannot work with.
    Feature,
    /// The nominal distance d(x) is impossible.
    Distance,
    /// Atoms cannot be placed as requested.
    Seeding,
    /// The lattice energy or its minimisation received an impossible parameter.
    Optimise,
    /// The Delaunay triangulation failed or cannot be run.
    Delaunay,
    /// A mesh is invalid, or its file is inconsistent.
    Mesh,
    /// Flow cannot be computed as requested.
    Flow,
    /// A model cannot be exported as requested.
    Export,
    /// A parameter of the whole job is wrong.
    Job,
    /// The caller stopped the job before there was a result.
    Interrupted,
}

impl Error {
    /// Returns the error with another place, for callers that know the user's name for it.
    pub fn with_place(mut self, place: impl fmt::Display) -> Self {
        self.cause_mut().place = place.to_string();
        self
    }

    /// Returns the error with the error that led to it.
    pub fn with_source(mut self, source: impl std::error::Error + Send + Sync + 'static) -> Self {
        self.cause_mut().source = Some(Arc::new(source));
        self
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.cause().fmt(f)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        let source = self.cause().source.as_deref()?;
        Some(source)
    }
}

/// The result type of the crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Builds a [`Cause`], e.g. `Error::Io(cause(path, "is empty", "give a file with data"))`.
pub fn cause(
    place: impl fmt::Display,
    problem: impl fmt::Display,
    remedy: impl fmt::Display,
) -> Cause {
    Cause {
        place: place.to_string(),
        problem: one_line(problem.to_string()),
        remedy: remedy.to_string(),
        parameter: None,
        source: None,
    }
}

/// Largest number of characters of a problem. Text from files may be of any length.
const MAX_PROBLEM_CHARS: usize = 600;

/// Returns the text as one line of at most [`MAX_PROBLEM_CHARS`] characters.
fn one_line(mut text: String) -> String {
    if let Some((end, _)) = text.char_indices().nth(MAX_PROBLEM_CHARS) {
        text.truncate(end);
        text.push_str(" ...");
    }
    if text.contains(['\n', '\r']) {
        let words = text.split(['\n', '\r']).map(str::trim);
        text = words
            .filter(|words| !words.is_empty())
            .collect::<Vec<_>>()
            .join(" ");
    }
    text
}

/// Converts an error of the operating system about a path into [`Error::Io`]. An [`Error`] that was
/// wrapped into the I/O error is returned as it is.
pub fn io_error(path: &Path, doing: &str, source: std::io::Error) -> Error {
    let source = match source.downcast::<Error>() {
        Ok(ours) => return ours,
        Err(source) => source,
    };
    let remedy = match source.kind() {
        std::io::ErrorKind::NotFound => "check the path",
        std::io::ErrorKind::PermissionDenied => "check the permissions",
        _ => "check the disk and the path",
    };
    let problem = format!("cannot {doing}: {source}");
    Error::Io(cause(path.display(), problem, remedy).with_source(source))
}

#[cfg(test)]
mod tests {
    use std::error::Error as _;

    use super::*;

    #[test]
    fn text_from_files_becomes_one_line_of_bounded_length() {
        let error = cause("a", "is odd:\n  one\r\ntwo\n", "b").to_string();
        assert_eq!(error, "a: is odd: one two; b");
        let error = cause("a", "é".repeat(10_000), "b").to_string();
        assert_eq!(
            error.chars().count(),
            "a: ; b".len() + MAX_PROBLEM_CHARS + " ...".len()
        );
    }

    #[test]
    fn an_error_has_a_kind_one_line_and_its_source() {
        let missing = std::io::Error::from(std::io::ErrorKind::NotFound);
        let error = io_error(Path::new("a.npy"), "open", missing);
        assert_eq!(error.kind(), ErrorKind::Io);
        assert_eq!(
            error.to_string(),
            "a.npy: cannot open: entity not found; check the path"
        );
        let source = error.source().unwrap().downcast_ref::<std::io::Error>();
        assert_eq!(source.unwrap().kind(), std::io::ErrorKind::NotFound);
        // Errors must be usable with `anyhow` and across threads.
        fn assert_portable<E: std::error::Error + Send + Sync + Clone + 'static>(_: &E) {}
        assert_portable(&error);
        assert!(
            error
                .with_place("--image")
                .to_string()
                .starts_with("--image: cannot")
        );
        assert!(Error::Job(cause("a", "b", "c")).source().is_none());
    }
}
