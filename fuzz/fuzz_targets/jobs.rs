//! Checks any small job.
#![no_main]

use atomesh_fuzz::{folder, jobs};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| jobs::check_job(&folder(), bytes));
