//! Any small job.
#![no_main]

use atomesh_fuzz::{folder, jobs};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| jobs::any_job(&folder(), bytes));
