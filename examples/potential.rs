//! Draws the total potential field p(x) of an initial and an optimised lattice, as in figures 6 and
//! 7 of Hale (2001).
//!
//! ```text
//! cargo run --release --example potential -- slice.png 8 before.png after.png
//! ```

use std::path::Path;

use atomesh::feature;
use atomesh::image::formats::{self, AnyImage, ReadOptions};
use atomesh::image::{Geometry, Image};
use atomesh::lattice::distance::Distance;
use atomesh::lattice::energy::{Beta, Energy};
use atomesh::lattice::optimise::{self, NoProgress};
use atomesh::lattice::seeding::{self, Alignment, Atoms};
use atomesh::model::slice::{self, Caption, Overlay};
use atomesh::published::SampledEnergy;

/// Weight of the image, as in the paper.
const BETA: f64 = 0.3;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [image, d, before, after] = arguments.as_slice() else {
        anyhow::bail!("give IMAGE, the distance between atoms, and two pictures to write");
    };
    let AnyImage::Plane(loaded) = formats::read_any(Path::new(image), &ReadOptions::default())?
    else {
        anyhow::bail!("{image} is not a 2-D image");
    };
    let d: f64 = d.parse()?;
    let options = feature::DetectionOptions {
        d_min: d,
        ..feature::DetectionOptions::default()
    };
    let potential = feature::detect(&loaded.image, &options)?
        .potential
        .to_dense();
    let distance = Distance::Constant(d);
    let extent = potential.extent();
    let mut atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures)?;

    let mut energy = SampledEnergy::new(&distance, potential, Beta::Constant(BETA));
    draw(&mut energy, &atoms, before)?;
    let options = optimise::OptimiseOptions::default();
    optimise::optimise(
        &mut atoms,
        &mut energy,
        &distance,
        extent,
        &options,
        &mut NoProgress,
    )?;
    draw(&mut energy, &atoms, after)
}

/// Draws p(x), which is dark where the potential is low.
fn draw(energy: &mut SampledEnergy<2>, atoms: &Atoms<2>, output: &str) -> anyhow::Result<()> {
    energy.evaluate(&atoms.positions, &mut vec![[0.0; 2]; atoms.len()])?;
    let total = energy.total_potential();
    let image = Image::new(total.dims, total.samples, Geometry::default());
    let picture = slice::draw_plane(&image, &Overlay::default(), &Caption::default())?;
    Ok(picture.write(Path::new(output))?)
}
