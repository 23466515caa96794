//! Bridge to CGAL (feature `cgal`): its functions, the checks of their input, and the errors that
//! their exceptions become. The module `cgal` calls it.

use super::out_of_memory;
use crate::error::{Error, Result, cause};

/// Largest number of points: CGAL numbers them with 32-bit signed integers.
const MAX_POINTS: usize = i32::MAX as usize;

/// Returns the result of a function of [`ffi`] that gets the coordinates of `points`, x, y and z of
/// each.
///
/// # Errors
/// Returns [`Error::Delaunay`] at `place` if a coordinate is not finite, if there are more than
/// [`MAX_POINTS`] points, if the function throws, or without the feature `cgal`.
pub fn call<T, E: std::error::Error + Send + Sync + 'static>(
    place: &str,
    points: &[[f64; 3]],
    function: impl FnOnce(&[f64]) -> std::result::Result<T, E>,
) -> Result<T> {
    let error = |problem: &str, remedy: &str| Error::Delaunay(cause(place, problem, remedy));
    if let Some(i) = points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        let [x, y, z] = points[i];
        let problem = format!("point {i} is at [{x}, {y}, {z}]");
        return Err(error(&problem, "give finite coordinates"));
    }
    if points.len() > MAX_POINTS {
        let problem = format!("{} points are more than CGAL can number", points.len());
        return Err(error(
            &problem,
            "use a larger distance between atoms (--distance)",
        ));
    }
    function(points.as_flattened()).map_err(|exception| {
        // The kinds are listed in `cpp/cgal_bridge.h`.
        let text = exception.to_string();
        let (kind, text) = text.split_once(": ").unwrap_or((&text, ""));
        let report = "please report it with the image or the mesh, and the options";
        let error = match kind {
            "memory" => out_of_memory(place, points.len()),
            "missing" => error(
                "this atomesh was built without CGAL",
                "install libcgal-dev and build with the feature `cgal` (on by default)",
            ),
            "input" => {
                let (problem, remedy) = text.split_once("; ").unwrap_or((text, report));
                error(problem, remedy)
            }
            _ => error(text, report),
        };
        error.with_source(exception)
    })
}

/// Returns values as arrays of `N`.
pub fn to_arrays<T: Copy, const N: usize>(values: Vec<T>) -> Vec<[T; N]> {
    values.as_chunks().0.to_vec()
}

/// The C++ side is `cpp/cgal_bridge.h`. Slices go in, owned vectors come out, and C++ exceptions
/// become errors. cxx checks both sides against each other at compile time.
#[cfg(feature = "cgal")]
#[cxx::bridge(namespace = "atomesh")]
#[allow(unsafe_code)]
pub(super) mod ffi {
    /// See [`CgalReport`](super::super::cgal::CgalReport).
    struct CgalVerdict {
        inverted: u64,
        flat: u64,
        unused_nodes: u64,
        overfull_faces: u64,
        hull_faces: u64,
        valid_topology: bool,
        volume: f64,
        hull_volume: f64,
    }

    // SAFETY: the functions only read their slices. `call` has checked that all coordinates are
    // finite and that the points can be numbered; `validate`, that all node numbers are in range.
    // Faces are only compared.
    unsafe extern "C++" {
        include!("atomesh/cpp/cgal_bridge.h");

        fn cgal_triangulate(points: &[f64]) -> Result<Vec<u32>>;
        fn cgal_validate(points: &[f64], tets: &[u32]) -> Result<CgalVerdict>;
        fn cgal_exude(points: &[f64], faces: &[u32], angle: f64) -> Result<Vec<u32>>;
        /// Only tests call this function.
        #[allow(dead_code)]
        fn cgal_allocate(bytes: usize) -> Result<()>;
    }
}

/// Stands for the functions of CGAL: each returns an error of the kind `missing`.
#[cfg(not(feature = "cgal"))]
pub(super) mod ffi {
    use super::super::cgal::CgalReport;
    use std::io::{Error, Result};

    fn missing<T>() -> Result<T> {
        Err(Error::other("missing"))
    }

    pub fn cgal_triangulate(_: &[f64]) -> Result<Vec<u32>> {
        missing()
    }

    pub fn cgal_validate(_: &[f64], _: &[u32]) -> Result<CgalReport> {
        missing()
    }

    pub fn cgal_exude(_: &[f64], _: &[u32], _: f64) -> Result<Vec<u32>> {
        missing()
    }
}

#[cfg(test)]
#[cfg(feature = "cgal")]
mod tests {
    use super::*;
    use crate::ErrorKind;

    /// `isize::MAX` bytes make `operator new` throw `std::bad_alloc`; more, a vector throw
    /// `std::length_error`.
    #[test]
    fn an_allocation_that_fails_is_lack_of_memory() {
        let points = [[0.0; 3]; 5];
        let allocate = |bytes| call("exudation", &points, |_| ffi::cgal_allocate(bytes));
        for bytes in [isize::MAX as usize, usize::MAX] {
            let error = allocate(bytes).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Delaunay);
            assert_eq!(
                error.to_string(),
                "exudation: 5 points do not fit in memory; use a larger distance between atoms (--distance), or a machine with more memory"
            );
        }
        allocate(1000).unwrap();
    }

    #[test]
    fn exceptions_become_errors_by_their_kind() {
        let error = |text: &'static str| {
            let fail = |_: &[f64]| Err::<(), _>(std::io::Error::other(text));
            call("a", &[], fail).unwrap_err().to_string()
        };
        assert_eq!(error("input: b: c; d"), "a: b: c; d");
        let reported = "please report it with the image or the mesh, and the options";
        assert_eq!(error("internal: b\nc"), format!("a: b c; {reported}"));
        let twice = [[0.0; 3], [1.0, 0.0, 0.0], [0.0; 3]];
        let error = call("cgal", &twice, ffi::cgal_triangulate).unwrap_err();
        assert_eq!(
            error.to_string(),
            "cgal: 1 of 3 points coincide with others; give distinct points"
        );
    }
}
