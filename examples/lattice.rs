//! Draws what a lattice consists of: the pair force and potential, the potential of one atom, and
//! d(x) with the lattice grown in it, as in figures 3, 4 and 5 of Hale (2001).
//!
//! ```text
//! cargo run --release --example lattice -- slice.png pair.svg atom.png distance.png
//! ```

use std::fmt::Write;
use std::path::Path;

use atomesh::feature;
use atomesh::image::formats::{self, AnyImage, ReadOptions};
use atomesh::image::{Geometry, Image, ScalarField};
use atomesh::lattice::distance::{self, Distance};
use atomesh::lattice::energy::{Beta, Energy, pair};
use atomesh::lattice::seeding::{self, Alignment};
use atomesh::model::slice::{self, Caption, Overlay, Skeleton};
use atomesh::model::surface::SurfaceKind;
use atomesh::progress::CancelToken;
use atomesh::published::SampledEnergy;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [image, pair, atom, lattice] = arguments.as_slice() else {
        anyhow::bail!("give IMAGE, and three pictures to write: .svg, .png, .png");
    };
    let AnyImage::Plane(loaded) = formats::read_any(Path::new(image), &ReadOptions::default())?
    else {
        anyhow::bail!("{image} is not a 2-D image");
    };
    std::fs::write(pair, pair_graph())?;
    draw_one_atom(atom)?;
    draw_grown_lattice(&loaded.image, lattice)
}

/// Returns an SVG graph of the published force and potential of a pair over the distance in units
/// of d.
fn pair_graph() -> String {
    const SIZE: [f32; 2] = [520.0, 240.0];
    let x = |u: f32| 40.0 + 300.0 * u;
    let mut svg = format!(
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {} {}' font-family='sans-serif' \
         font-size='12'>\n<rect width='100%' height='100%' fill='white'/>\n",
        SIZE[0], SIZE[1]
    );
    // The potential is smaller than the force, so each curve has a scale of its own.
    type Curve = (&'static str, &'static str, f32, fn(f32, f32) -> f32);
    let curves: [Curve; 2] = [
        ("force f(u)", "#c04000", 130.0, pair::force),
        ("potential phi(u)", "#1050a0", 600.0, pair::potential),
    ];
    for (line, (name, color, scale, curve)) in curves.into_iter().enumerate() {
        let points = (0..=150).map(|i| i as f32 / 100.0);
        let points = points.map(|u| [x(u), 160.0 - scale * curve(u, 0.0)]);
        // Points above the graph are omitted.
        let points = points.filter(|[_, y]| *y > 0.0);
        let points = points.map(|[x, y]| format!("{x:.1},{y:.1}"));
        let points: Vec<String> = points.collect();
        let y = 30 + 18 * line;
        let _ = writeln!(
            svg,
            "<polyline fill='none' stroke='{color}' stroke-width='2' points='{}'/>\n\
             <text x='360' y='{y}' fill='{color}'>{name} x {scale}</text>",
            points.join(" ")
        );
    }
    for (u, label) in [(0.0, "0"), (0.5, "d/2"), (1.0, "d"), (1.5, "3d/2")] {
        let _ = writeln!(
            svg,
            "<path stroke='#888' d='M{0} 157v6'/><text x='{0}' y='230' text-anchor='middle'>\
             {label}</text>",
            x(u)
        );
    }
    let _ = writeln!(svg, "<path stroke='#888' d='M40 160H490'/>\n</svg>");
    svg
}

/// Draws the sampled potential of one atom for d = 4 and for d = 8, side by side.
fn draw_one_atom(output: &str) -> anyhow::Result<()> {
    const SIDE: usize = 33;
    let flat = ScalarField {
        dims: [SIDE; 2],
        step: [1.0; 2],
        samples: vec![0.0; SIDE * SIDE],
    };
    let mut rows = vec![Vec::new(); SIDE];
    for d in [4.0, 8.0] {
        let distance = Distance::Constant(d);
        let mut energy = SampledEnergy::new(&distance, flat.clone(), Beta::Constant(0.0));
        energy.evaluate(&[[16.0, 16.0]], &mut [[0.0; 2]])?;
        let total = energy.total_potential();
        for (row, samples) in rows.iter_mut().zip(total.samples.chunks(SIDE)) {
            row.extend_from_slice(samples);
        }
    }
    let image = Image::new([2 * SIDE, SIDE], rows.concat(), Geometry::default());
    Ok(
        slice::draw_plane(&image, &Overlay::default(), &Caption::default())?
            .write(Path::new(output))?,
    )
}

/// Draws d(x) of the image's features, dark where it is small, and the atoms of the lattice grown
/// in it.
fn draw_grown_lattice(image: &Image<2>, output: &str) -> anyhow::Result<()> {
    let limits = distance::DistanceLimits {
        min: 6.0,
        max: 18.0,
        growth: 0.1,
    };
    let options = feature::DetectionOptions {
        d_min: limits.min,
        ..feature::DetectionOptions::default()
    };
    let features = feature::detect(image, &options)?;
    let distance = distance::from_features(&features, limits, &CancelToken::never())?;
    let extent = features.potential.extent();
    let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures)?;
    let [nx, ny] = image.dims();
    let samples = (0..nx * ny)
        .map(|i| distance.value_at([(i % nx) as f64, (i / nx) as f64]) as f32)
        .collect();
    // Draw a cross for each atom.
    let mut crosses = Skeleton::default();
    for &[x, y] in &atoms.positions {
        for [u, v] in [[1.0, 0.0], [0.0, 1.0]] {
            let first = crosses.nodes.len() as u32;
            crosses.nodes.extend([[x - u, y - v], [x + u, y + v]]);
            crosses.faces.push([first, first + 1]);
            crosses.kinds.push(Some(SurfaceKind::Fault));
        }
    }
    let image = Image::new(image.dims(), samples, Geometry::default());
    let crosses = Overlay {
        mesh: crosses,
        ..Overlay::default()
    };
    Ok(slice::draw_plane(&image, &crosses, &Caption::default())?.write(Path::new(output))?)
}
