//! A mesh of an array: a bright sphere in a dark box, as tetrahedra whose faces lie on the sphere.
//!
//! ```text
//! cargo run --release --example mesh
//! ```

use atomesh::MeshSpec;
use atomesh::image::{Geometry, Image};
use atomesh::progress::NoProgress;

fn main() -> anyhow::Result<()> {
    let n = 64;
    let offset = |i: usize| i as f32 - 31.5;
    let radius = |i: usize| {
        offset(i % n)
            .hypot(offset(i / n % n))
            .hypot(offset(i / n / n))
    };
    let samples = (0..n * n * n).map(|i| (20.0 - radius(i)).clamp(-1.0, 1.0));
    let image = Image::new([n; 3], samples.collect(), Geometry::default());
    let spec = MeshSpec {
        distance: "6".parse()?,
        ..MeshSpec::default()
    };
    let outcome = atomesh::mesh(&image, &spec, &mut NoProgress)?;
    println!("{}", outcome.report.table());
    outcome.write("sphere.vtu".as_ref())?;
    Ok(())
}
