//! One error for the whole crate: its kind, *where* the fault is, *what* is wrong, *what to do* about
//! it, and what caused it. The command line prints it as one line, `place: problem; remedy`.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

/// What went wrong: place, problem, remedy.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Cause {
    /// The file, parameter or item that is at fault, e.g. `survey.sgy` or `distance`.
    pub place: String,
    /// What is wrong with it, with the numbers that show it. Complete: it holds what the source says.
    pub problem: String,
    /// What the user can do.
    pub remedy: String,
    /// The parameter to change, e.g. `porosity`, where one is at fault or missing: a front end adds what
    /// it calls it.
    pub parameter: Option<&'static str>,
    /// The error that led to this one.
    source: Option<Arc<dyn std::error::Error + Send + Sync>>,
}

impl Cause {
    /// The same, with the error that led to it.
    pub fn with_source(mut self, source: impl std::error::Error + Send + Sync + 'static) -> Self {
        self.source = Some(Arc::new(source));
        self
    }

    /// The same, with the parameter that is to be changed.
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

/// Declares the kinds of errors once, for [`Error`] and [`ErrorKind`].
macro_rules! kinds {
    ($($(#[$doc:meta])+ $name:ident,)+) => {
        /// Every way in which a stage of atomesh can fail on what a user gives it.
        #[derive(Debug, Clone)]
        #[non_exhaustive]
        pub enum Error {
            $($(#[$doc])+ $name(Cause),)+
        }

        /// The kinds of errors, for programs that tell them apart.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[non_exhaustive]
        pub enum ErrorKind {
            $($(#[$doc])+ $name,)+
        }

        impl Error {
            /// What kind of error this is.
            pub fn kind(&self) -> ErrorKind {
                match self {
                    $(Self::$name(_) => ErrorKind::$name,)+
                }
            }

            /// Place, problem and remedy.
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
    /// An image holds what no mesh can be made of (NaN, constant, too small ...).
    Image,
    /// Feature detection got a parameter or an image that it cannot work with.
    Feature,
    /// The nominal distance d(x) is impossible.
    Distance,
    /// Atoms cannot be placed as asked.
    Seeding,
    /// The lattice energy or its minimisation got an impossible parameter.
    Optimize,
    /// The Delaunay triangulation failed or cannot be run.
    Delaunay,
    /// A mesh is not what it claims to be.
    Mesh,
    /// Flow cannot be computed as asked.
    Flow,
    /// A model cannot be given to a simulator as asked.
    Export,
    /// A parameter of the whole job is wrong.
    Job,
    /// An observer asked to stop before there was a result.
    Interrupted,
}

impl Error {
    /// The same at another place: who calls may know better what the user calls it.
    pub fn with_place(mut self, place: impl fmt::Display) -> Self {
        self.cause_mut().place = place.to_string();
        self
    }

    /// The same, with the error that led to it.
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

/// The crate's result.
pub type Result<T> = std::result::Result<T, Error>;

/// Builds a [`Cause`]; `Error::Io(cause(path, "is empty", "give a file with data"))`.
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

/// Characters of a problem at most: words from files may be of any length.
const MAX_PROBLEM_CHARS: usize = 600;

/// Text as one line that is not too long.
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

/// An operating-system error about a path, as [`Error::Io`]; an error of ours that came through one of its,
/// as it was.
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
    fn words_of_files_make_one_line_of_bounded_length() {
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
        // As an `anyhow` error or across threads, like any other.
        fn carried<E: std::error::Error + Send + Sync + Clone + 'static>(_: &E) {}
        carried(&error);
        assert!(
            error
                .with_place("--image")
                .to_string()
                .starts_with("--image: cannot")
        );
        assert!(Error::Job(cause("a", "b", "c")).source().is_none());
    }
}
