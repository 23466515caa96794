//! Flow through a faulted block: pressure on two sides, and faults that let little through.
//!
//! ```text
//! cargo run --release --example flow
//! ```

use atomesh::image::synth::{self, SyntheticKind};
use atomesh::model::flow::FaultOptions;
use atomesh::progress::NoProgress;
use atomesh::{FlowSpec, MeshSpec};

fn main() -> anyhow::Result<()> {
    let options = synth::Options {
        dims: [48, 44, 40],
        ..Default::default()
    };
    let image = synth::make(SyntheticKind::Faults, &options)?.image;
    let spec = MeshSpec {
        distance: "6".parse()?,
        ..MeshSpec::default()
    };
    let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
    let spec = FlowSpec {
        pressure: vec!["xmin=2e5".parse()?, "xmax=1e5".parse()?],
        fault_options: FaultOptions {
            faults: Some("0.001".parse()?),
            ..FaultOptions::default()
        },
        lines: Some(100),
        ..FlowSpec::default()
    };
    let flow = atomesh::flow(mesh, &spec, &mut NoProgress)?;
    println!("{}", flow.report.table());
    flow.mesh.write("flow.vtu".as_ref())?;
    if let Some(lines) = flow.streamlines {
        lines.write("streamlines.vtp".as_ref())?;
    }
    Ok(())
}
