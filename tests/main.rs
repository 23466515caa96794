//! Integration tests, in one program. Most of them run the command-line program on small files that they
//! write.
//!
//! `cargo test --test main columns::` runs the tests of one file.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has failed"
)]

mod common;

/// The program under test.
const PROGRAM: &str = env!("CARGO_BIN_EXE_atomesh");

#[cfg(feature = "tetgen")]
mod anisotropy;
mod checkpoint;
mod columns;
#[cfg(feature = "tetgen")]
mod compartments;
#[cfg(feature = "tetgen")]
mod conforming;
#[cfg(feature = "tetgen")]
mod corner_points;
mod edit;
#[cfg(feature = "tetgen")]
mod export;
#[cfg(feature = "tetgen")]
mod export_options;
#[cfg(feature = "tetgen")]
mod fault_exports;
#[cfg(feature = "tetgen")]
mod flow;
#[cfg(feature = "tetgen")]
mod foreign;
mod gaps;
mod images_formats;
#[cfg(feature = "tetgen")]
mod inactive;
mod interrupt;
#[cfg(feature = "tetgen")]
mod label_faults;
#[cfg(feature = "tetgen")]
mod labels;
#[cfg(feature = "tetgen")]
mod mesh;
#[cfg(feature = "tetgen")]
mod meshers;
mod missing_traces;
mod modflow;
mod options;
#[cfg(feature = "tetgen")]
mod page;
mod plane;
#[cfg(feature = "tetgen")]
mod refusals;
#[cfg(feature = "tetgen")]
mod reservoir;
#[cfg(feature = "tetgen")]
mod scans;
#[cfg(feature = "tetgen")]
mod scans_files;
#[cfg(feature = "tetgen")]
mod scans_labels;
#[cfg(feature = "tetgen")]
mod seeding;
mod segment;
#[cfg(feature = "tetgen")]
mod simulators;
#[cfg(feature = "tetgen")]
mod slice;
#[cfg(feature = "tetgen")]
mod surfaces;
#[cfg(feature = "tetgen")]
mod velocity;
mod voronoi;
mod vtk;
#[cfg(feature = "tetgen")]
mod wells;
mod xu;
mod zarr;
