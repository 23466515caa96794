//! The surfaces of a faulted block: the faces on each fault, with dip, strike and area.
//!
//! ```text
//! cargo run --release --example surface
//! ```

use atomesh::image::synth::{self, SyntheticKind};
use atomesh::progress::NoProgress;
use atomesh::{MeshSpec, SurfaceSpec};

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
    let spec = SurfaceSpec::default();
    let surfaces = atomesh::surfaces(mesh, &spec, &mut NoProgress)?;
    println!("{}", surfaces.table(true));
    surfaces.write("faults.ts".as_ref(), &spec)?;
    Ok(())
}
