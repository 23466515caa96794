//! Raw bindings to Debian's libtet 1.5 (TetGen, AGPL-3.0) through the plain-C shim
//! `cpp/tetgen_shim.h`: a point array and TetGen's switches go in, owned arrays and a status come out.
//!
//! TetGen itself is neither re-entrant nor safe on degenerate input; the shim's header lists what a
//! caller must guarantee. Safe code uses `atomesh::mesh::delaunay`.
//!
//! The crate is built and tested with `libtet1.5` and `libtet1.5-dev` 1.5.0-5 of Debian 12 (bookworm)
//! on amd64. No other version of Debian or Ubuntu has been tried. The shim depends on one property of
//! the library that another build may lack: `terminatetetgen` is a weak symbol that the library calls
//! through the PLT, so that `terminate` can replace it (see `cpp/tetgen_shim.cpp`). The test
//! `exceptions_come_back_as_statuses_and_leave_tetgen_usable` shows whether a library has it:
//! `cargo test -p tetgen-sys`.

#![allow(non_camel_case_types)]

include!(concat!(env!("OUT_DIR"), "/bindings.rs"));

unsafe extern "C-unwind" {
    /// Throws an `int`. It is in `cpp/tetgen_shim.cpp`.
    fn tetgen_shim_throw(status: i32) -> !;
}

/// Replaces TetGen's `terminatetetgen(tetgenmesh *, int)`, which TetGen calls on errors. TetGen's own
/// would free the mesh before it throws, and the mesh's destructor would free it again.
#[unsafe(export_name = "_Z15terminatetetgenP10tetgenmeshi")]
extern "C-unwind" fn terminate(_mesh: *mut std::ffi::c_void, status: i32) {
    // SAFETY: the exception passes through this frame, which has nothing to drop, to TetGen.
    unsafe { tetgen_shim_throw(status) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(points: &[[f64; 3]], switches: &std::ffi::CStr) -> (i32, tetgen_shim_mesh) {
        let null = std::ptr::null_mut();
        let mut mesh = tetgen_shim_mesh {
            tetrahedra: null,
            neighbours: null,
            count: 0,
        };
        // SAFETY: the test fulfils the requirements of the header, and runs in one thread.
        let status = unsafe {
            tetgen_shim_run(
                points.as_ptr().cast(),
                points.len() as i32,
                switches.as_ptr(),
                &mut mesh,
            )
        };
        (status, mesh)
    }

    /// TetGen throws on flat points. If it did not call our terminatetetgen, it would free its pools
    /// twice and crash. Therefore the test repeats this many times, and ends with a valid run.
    #[test]
    fn exceptions_come_back_as_statuses_and_leave_tetgen_usable() {
        let plane: Vec<[f64; 3]> = (0..400)
            .map(|i| (f64::from(i % 20), f64::from(i / 20)))
            .map(|(x, y)| [x, y, x + 2.0 * y])
            .collect();
        let line: Vec<[f64; 3]> = (0..50).map(|i| [f64::from(i); 3]).collect();
        for _ in 0..50 {
            for points in [&plane, &line] {
                let (status, mesh) = run(points, c"zQNFJ");
                assert_eq!(status, TETGEN_SHIM_BAD_INPUT as i32);
                assert!(mesh.tetrahedra.is_null() && mesh.neighbours.is_null() && mesh.count == 0);
            }
        }
        let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (status, mut mesh) = run(&corners, c"zQNFJn");
        assert_eq!((status, mesh.count), (TETGEN_SHIM_OK as i32, 1));
        assert!(!mesh.tetrahedra.is_null() && !mesh.neighbours.is_null());
        // SAFETY: tetgen_shim_run filled the mesh; a second call on the emptied mesh does nothing.
        unsafe {
            tetgen_shim_free(&mut mesh);
            tetgen_shim_free(&mut mesh);
        }
        assert!(mesh.tetrahedra.is_null() && mesh.count == 0);
    }
}
