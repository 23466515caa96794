//! The verbs of the command line: one file per verb, with its arguments.

pub mod columns;
pub mod convert;
pub mod edit;
pub mod export;
pub mod feature;
pub mod flow;
pub mod info;
pub mod mesh;
pub mod paint;
pub mod quality;
pub mod report;
pub mod script;
pub mod segment;
pub mod setup;
pub mod slice;
pub mod surface;
pub mod synth;
pub mod validate;
