//! Checks any bytes as a mesh.
#![no_main]

use atomesh_fuzz::{folder, meshes};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| meshes::check_mesh(&folder(), bytes));
