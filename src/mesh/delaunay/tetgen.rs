//! TetGen as a kernel (Si 2015, "TetGen, a Delaunay-based quality tetrahedral mesh generator"),
//! feature `tetgen`. It inserts points incrementally, in a biased random and then Hilbert order;
//! its predicates are exact, and ties of cospherical points are broken by symbolic perturbation.
//!
//! Input that TetGen cannot handle is rejected before the call: all conditions that would end in an
//! assertion are checked first. TetGen's own errors are returned as
//! [`Error::Delaunay`](crate::Error::Delaunay).

use std::sync::{Mutex, PoisonError};

use tetgen_sys as sys;

use super::{DelaunayTets, Kernel, PLACE, delaunay_error, out_of_memory};
use crate::error::Result;
use crate::parallel::prelude::*;

/// TetGen.
pub struct Tetgen;

impl Kernel for Tetgen {
    fn triangulate(&self, points: &[[f64; 3]], with_neighbours: bool) -> Result<DelaunayTets> {
        let (status, output) = run(points, with_neighbours);
        match status as sys::tetgen_shim_status {
            sys::TETGEN_SHIM_OK => {}
            sys::TETGEN_SHIM_BAD_INPUT => {
                return Err(delaunay_error(
                    "TetGen finds all points in one plane or on one line, or nearly so",
                    "give points that span a volume",
                ));
            }
            sys::TETGEN_SHIM_OUT_OF_MEMORY => return Err(out_of_memory(PLACE, points.len())),
            status => {
                return Err(delaunay_error(
                    format!("TetGen stopped with its error {status}"),
                    "please report it with the image and the options",
                ));
            }
        }
        // An out-of-range index would make later code panic.
        let is_out_of_range =
            |tet: &[u32; 4]| tet.iter().any(|&node| node as usize >= points.len());
        if output.tets.par_iter().any(is_out_of_range) {
            return Err(delaunay_error(
                "TetGen returned a node that was not given",
                "please report it",
            ));
        }
        Ok(output)
    }
}

/// TetGen is not re-entrant: `exactinit` writes the error bounds of its predicates, which
/// depend on the extent of the points, into global variables. A second run at the same time
/// would use wrong bounds and could give wrong results without notice. Therefore only one run
/// at a time is allowed in a process.
static TETGEN_LOCK: Mutex<()> = Mutex::new(());

/// Owns the memory that the C++ side allocated, and frees it when dropped.
struct OwnedMesh(sys::tetgen_shim_mesh);

#[allow(unsafe_code)]
impl Drop for OwnedMesh {
    fn drop(&mut self) {
        // SAFETY: the mesh was filled by tetgen_shim_run (or is empty) and is freed only here.
        unsafe { sys::tetgen_shim_free(&raw mut self.0) }
    }
}

#[allow(unsafe_code)]
impl OwnedMesh {
    /// Returns a copy of one of the mesh's arrays, with four numbers for each tetrahedron.
    /// TetGen's orientation and numbering of neighbours equal ours; its -1 becomes `NONE`.
    fn copy_array(&self, array: *const i32) -> Vec<[u32; 4]> {
        if array.is_null() {
            return Vec::new();
        }
        // SAFETY: a non-null array of the mesh has 4 * count ints and lives as long as self.
        let values =
            unsafe { std::slice::from_raw_parts(array.cast::<[i32; 4]>(), self.0.count as usize) };
        values.iter().map(|v| v.map(|i| i as u32)).collect()
    }
}

/// Runs TetGen. Returns its status, and the tetrahedra if that is `TETGEN_SHIM_OK`.
#[allow(unsafe_code)]
fn run(points: &[[f64; 3]], with_neighbours: bool) -> (i32, DelaunayTets) {
    let mut mesh = OwnedMesh(sys::tetgen_shim_mesh {
        tetrahedra: std::ptr::null_mut(),
        neighbours: std::ptr::null_mut(),
        count: 0,
    });
    // TetGen has no state that a panic could leave inconsistent, so a poisoned lock can be
    // used.
    let lock = TETGEN_LOCK.lock().unwrap_or_else(PoisonError::into_inner);
    // SAFETY: `points` is only read and has 3 * len finite doubles of nonzero extent, with len
    // >= 4 and below i32::MAX (`check_points`); the switches are a constant that ends with
    // zero; the lock is held. The shim catches every exception.
    let status = unsafe {
        sys::tetgen_shim_run(
            points.as_ptr().cast(),
            points.len() as i32,
            sys::tetgen_shim_switches(i32::from(with_neighbours)),
            &raw mut mesh.0,
        )
    };
    drop(lock);
    let output = DelaunayTets {
        tets: mesh.copy_array(mesh.0.tetrahedra),
        neighbours: mesh.copy_array(mesh.0.neighbours),
    };
    (status, output)
}
