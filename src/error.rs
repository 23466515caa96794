//! One error for the whole crate: one variant per stage of the pipeline, each carrying *where* the
//! fault is, *what* is wrong and *what to do* about it. The command line prints it as one line.

use std::fmt;
use std::path::Path;

/// What went wrong: place, problem, remedy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cause {
    /// The file, option or item that is at fault, e.g. `survey.sgy` or `--distance 0`.
    pub place: String,
    /// What is wrong with it, with the numbers that show it.
    pub problem: String,
    /// What the user can do.
    pub remedy: String,
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.place, self.problem, self.remedy)
    }
}

/// Every way in which a stage of atomesh can fail on what a user gives it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// A file cannot be opened, read, understood or written.
    #[error("{0}")]
    Io(Cause),
    /// An image holds what no mesh can be made of (NaN, constant, too small ...).
    #[error("{0}")]
    Image(Cause),
    /// Feature detection got a parameter or an image that it cannot work with.
    #[error("{0}")]
    Feature(Cause),
    /// The nominal distance d(x) is impossible.
    #[error("{0}")]
    Distance(Cause),
    /// Atoms cannot be placed as asked.
    #[error("{0}")]
    Seeding(Cause),
    /// The lattice energy or its minimisation got an impossible parameter.
    #[error("{0}")]
    Optimize(Cause),
    /// The Delaunay triangulation failed or cannot be run.
    #[error("{0}")]
    Delaunay(Cause),
    /// A mesh is not what it claims to be.
    #[error("{0}")]
    Mesh(Cause),
    /// Flow cannot be computed as asked.
    #[error("{0}")]
    Flow(Cause),
    /// A model cannot be given to a simulator as asked.
    #[error("{0}")]
    Export(Cause),
    /// A parameter of the whole job is wrong.
    #[error("{0}")]
    Job(Cause),
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
        problem: problem.to_string(),
        remedy: remedy.to_string(),
    }
}

/// An operating-system error about a path, as [`Error::Io`].
pub fn os(path: &Path, doing: &str, source: std::io::Error) -> Error {
    let remedy = match source.kind() {
        std::io::ErrorKind::NotFound => "check the path",
        std::io::ErrorKind::PermissionDenied => "check the permissions",
        _ => "check the disk and the path",
    };
    Error::Io(cause(
        path.display(),
        format!("cannot {doing}: {source}"),
        remedy,
    ))
}
