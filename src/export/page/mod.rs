//! A page to look at: one HTML file with a mesh, its image and its figures, which any browser opens
//! without a network.
//!
//! - `keep`: the faces that the page's cut can show
//! - `pack`: numbers as bytes, and bytes as text
//! - `values`: what the page colours cells by
//! - `picture`: the image as a texture
//! - `page.html`, `style.css` and the scripts: what the browser gets, put together here
//!
//! The browser shows a face when just one of its two cells is shown, so that a cut anywhere is a
//! closed surface of whole cells. The cut of an axis stops at `steps - 1` places at most, and a face
//! whose cells no such place parts is never seen: it is left out. Large meshes get fewer places.

mod culling;
mod pack;
mod texture;
mod values;

use std::io::Write;
use std::path::Path;

use serde::Serialize;
use serde_json::{Value, json};

use crate::error::cause;
use crate::files::atomic_write;
use crate::image::Image;
use crate::model::slice::{BoxFrame, DrawableFaces};
use crate::model::surface::stored_surfaces::surfaces_by_bend;
use crate::store::{Storable, StoredMesh};
use crate::{Error, Result};

use culling::PageMesh;
use pack::{ByteStreams, PackedStreams};

/// What else the page says.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PageInfo {
    /// The page's heading.
    pub title: String,
    /// The run's [`Report`](crate::report::Report).
    pub report: Value,
    /// The parameters of the run, as a configuration file has them; empty if unknown.
    pub parameters: String,
    /// The hash of the image's file, with its kind; empty if unknown.
    pub input_hash: String,
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct PageStats {
    /// Size of the file.
    pub bytes: usize,
    /// Into how many parts the places at which the cut can stop divide each axis.
    pub cut_steps: usize,
    /// Whether the page has fewer places than a browser can show, to be small enough.
    pub is_thinned: bool,
    /// Faces in the page.
    pub faces: usize,
    /// Faces of the mesh.
    pub total_faces: usize,
}

/// The largest page, in bytes.
pub const MAX_PAGE_BYTES: usize = 10_000_000;
/// Into how many parts places of the cut divide an axis: the most, as a byte keeps the part, and fewer
/// down to a cut through the middle.
const CUT_STEPS: [usize; 24] = [
    256, 192, 128, 96, 80, 64, 56, 48, 40, 32, 28, 24, 20, 16, 14, 12, 10, 8, 7, 6, 5, 4, 3, 2,
];

/// Writes a page; the file appears whole or not at all.
///
/// # Errors
/// [`Error::Export`] for a mesh that does not fit into `largest` bytes however few places its cut
/// has; [`Error::Io`] if the file cannot be written.
pub fn write<const D: usize, M: Storable<D>>(
    path: &Path,
    image: Option<&Image<D>>,
    stored: &StoredMesh<D, M>,
    about: &PageInfo,
    largest: usize,
) -> Result<PageStats> {
    let surfaces = stored
        .feature_marks()
        .map(|marks| surfaces_by_bend(stored, &marks));
    let surfaces = surfaces.unwrap_or_default();
    let faces = DrawableFaces::from_mesh(stored, &surfaces.facets)?;
    let arrays = values::scalar_arrays(stored, &faces, image);
    let texture = image.map(texture::from_image);
    let frame = BoxFrame::new(&stored.space, image.map(|image| &image.geometry));
    let kinds: Vec<_> = surfaces.kinds.iter().map(|kind| kind.name()).collect();

    // Bytes of what every page has, and of a face and of a cell: guessed, and corrected by each page made.
    let rest = 120_000.0
        + texture
            .as_ref()
            .map_or(0.0, |t| 1.35 * t.bytes.len() as f64);
    let by_cell = 3.0 + 2.6 * arrays.len() as f64;
    let guess = |steps: usize| {
        let (kept, cells) = culling::count(&faces, steps);
        5.5 * kept as f64 + by_cell * cells as f64
    };
    let mut correction = 1.0;
    // The finest steps that fit are searched: those before `finest` are too fine, those from `coarsest` on
    // no finer than those of the page that is there.
    let (mut finest, mut coarsest) = (0, CUT_STEPS.len());
    let (mut fits, mut too_large) = (None, 0);
    while finest < coarsest {
        let enough = |&at: &usize| rest + correction * guess(CUT_STEPS[at]) <= largest as f64;
        let at = match (finest..coarsest).find(enough) {
            Some(at) => at,
            None if fits.is_some() => break,
            None => coarsest - 1,
        };
        let steps = CUT_STEPS[at];
        let kept = PageMesh::new(&faces, steps);
        let mut streams = ByteStreams::default();
        streams.add_faces(&faces, &kept);
        let arrays: Vec<Value> = (arrays.iter())
            .map(|array| array.add_to_streams(&mut streams, &kept))
            .collect();
        if let Some(texture) = &texture {
            streams.add_image(texture);
        }
        let PackedStreams { base64, layout } = streams.pack();
        let facts = json!({
            "about": about,
            "dimensions": D,
            "cells": M::CELLS_NAME,
            "counts": {
                "nodes": stored.lattice.nodes().len(),
                "cells": stored.lattice.len(),
                "faces": faces.len(),
                "kept": kept.faces.len(),
            },
            "steps": steps,
            "thinned": steps < CUT_STEPS[0],
            "frame": frame,
            "arrays": arrays,
            "surfaces": kinds,
            "large_surfaces": surfaces.kept_count,
            "image": texture.as_ref().map(|texture| &texture.metadata),
            "streams": layout,
        });
        let page = html(&about.title, &facts, &base64);
        correction = 1.01 * (page.len() as f64 - rest).max(0.0) / guess(steps);
        if page.len() > largest {
            finest = at + 1;
            too_large = page.len();
        } else {
            coarsest = at;
            let written = PageStats {
                bytes: page.len(),
                cut_steps: steps,
                is_thinned: steps < CUT_STEPS[0],
                faces: kept.faces.len(),
                total_faces: faces.len(),
            };
            fits = Some((page, written));
        }
    }
    let Some((page, written)) = fits else {
        return Err(Error::Export(cause(
            path.display(),
            format!(
                "would be of {:.1} MB even with no more than the sides, the features and one cut, and \
                 browsers are given {:.1} MB at most",
                too_large as f64 * 1e-6,
                largest as f64 * 1e-6
            ),
            "mesh a part of the image, or with a larger distance",
        )));
    };
    atomic_write(path, |out| out.write_all(page.as_bytes()))?;
    Ok(written)
}

/// The scripts, in the order in which they build on each other.
const SCRIPTS: [&str; 6] = [
    include_str!("unpack.js"),
    include_str!("maths.js"),
    include_str!("scene.js"),
    include_str!("labels.js"),
    include_str!("panel.js"),
    include_str!("view.js"),
];

/// Puts the page together.
fn html(title: &str, facts: &Value, base64: &str) -> String {
    // Nothing in the facts may end the element that holds them.
    let facts = facts.to_string().replace('<', "\\u003c");
    let escaped = title
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;");
    let scripts = SCRIPTS.concat();
    let parts = [
        ("{{title}}", escaped.as_str()),
        ("{{style}}", include_str!("style.css")),
        ("{{facts}}", facts.as_str()),
        ("{{data}}", base64),
        ("{{script}}", scripts.as_str()),
    ];
    let mut page = String::with_capacity(base64.len() + facts.len() + (1 << 17));
    let mut rest = include_str!("page.html");
    while let Some(start) = rest.find("{{") {
        page.push_str(&rest[..start]);
        rest = &rest[start..];
        match parts.iter().find(|(mark, _)| rest.starts_with(mark)) {
            Some((mark, text)) => {
                page.push_str(text);
                rest = &rest[mark.len()..];
            }
            None => {
                page.push_str("{{");
                rest = &rest[2..];
            }
        }
    }
    page.push_str(rest);
    page
}

#[cfg(test)]
mod tests;
