//! Checks any bytes as an image.
#![no_main]

use atomesh_fuzz::{folder, images};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| images::check_image(&folder(), bytes));
