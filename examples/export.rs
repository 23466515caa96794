//! A reservoir model: Voronoi cells of a faulted block, with rock and two wells, as a deck for OPM
//! Flow.
//!
//! ```text
//! cargo run --release --example export
//! ```

use atomesh::export::ExportFormat;
use atomesh::image::synth::{self, SyntheticKind};
use atomesh::job::CellKind;
use atomesh::model::reservoir::{CaseOptions, RockOptions, SpaceOptions};
use atomesh::progress::NoProgress;
use atomesh::{ExportSpec, MeshSpec};

fn main() -> anyhow::Result<()> {
    let options = synth::Options {
        dims: [48, 44, 40],
        ..Default::default()
    };
    let image = synth::make(SyntheticKind::Faults, &options)?.image;
    let spec = MeshSpec {
        distance: "6".parse()?,
        cells: Some(CellKind::Voronoi),
        ..MeshSpec::default()
    };
    let cells = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
    let spec = ExportSpec {
        rock: RockOptions {
            porosity: Some("0.2".parse()?),
            permeability: Some("100,100,10".parse()?),
            permeability_unit: Some("mD".parse()?),
            ..RockOptions::default()
        },
        space: SpaceOptions {
            depth_at_top: Some(2000.0),
            ..SpaceOptions::default()
        },
        case: CaseOptions {
            injector: vec!["5,5,20:50".parse()?],
            producer: vec!["42,38,20:150".parse()?],
            ..CaseOptions::default()
        },
        ..ExportSpec::default()
    };
    let opm = ExportFormat::from_name("opm")?;
    let model = atomesh::export(cells, opm, "CASE.DATA".as_ref(), &spec, &mut NoProgress)?;
    println!("{}", model.table());
    Ok(())
}
