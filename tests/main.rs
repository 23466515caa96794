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

mod anisotropy;
mod brought;
mod checkpoint;
mod columns;
mod compartments;
mod conforming;
mod corner_point_grids;
mod corner_points;
mod dicom;
mod directions;
mod dropped_labels;
mod edit;
mod effort;
mod export;
mod export_options;
mod fault_exports;
mod flow;
mod foreign;
mod foreign_groups;
mod gaps;
mod geological_grids;
mod given_surfaces;
mod given_zones;
mod hdf5;
mod history_matching;
mod images_formats;
mod inactive;
mod interrupt;
mod label_faults;
mod labels;
mod layers;
mod live;
mod mesh;
mod meshers;
mod missing_traces;
mod modflow;
mod names;
mod options;
mod page;
mod plane;
mod readme;
mod refusals;
mod reservoir;
mod round_trips;
mod scans;
mod scans_files;
mod scans_labels;
mod script;
mod seals;
mod seeding;
mod segment;
mod simulators;
mod slice;
mod surface_files;
mod surfaces;
mod surfaces_in_surveys;
mod survey_headers;
mod tables;
mod topography;
mod velocity;
mod verdict;
mod voronoi;
mod vtk;
mod wells;
mod workbench;
mod xu;
mod zarr;
