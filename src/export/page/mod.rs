//! Writes a page for the browser: one HTML file with a mesh, its image and its report. It needs no
//! network.
//!
//! - `culling`: the faces that the cutting plane of the page can show
//! - `pack`: numbers as bytes, and bytes as text
//! - `values`: values by which the page colours cells
//! - `texture`: the image as a texture
//! - `page.html`, `style.css` and the scripts: the parts of the page, which are joined here
//!
//! The browser shows a face if exactly one of its two cells is shown. So the mesh has a closed
//! surface of whole cells wherever it is cut. The cutting plane of an axis has at most `steps - 1`
//! positions. A face whose two cells are never separated by such a position cannot be seen, and is
//! omitted. Large meshes get fewer positions.

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
use texture::Texture;
use values::CellValues;

/// Information for the page besides the mesh.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PageInfo {
    /// Heading of the page.
    pub title: String,
    /// `Report` of the run.
    pub report: Value,
    /// Parameters of the run, as a configuration file has them. Empty if unknown.
    pub parameters: String,
    /// Hash of the image file, with its kind. Empty if unknown.
    pub input_hash: String,
}

/// Size and contents of a page that was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct PageStats {
    /// Size of the file in bytes.
    pub bytes: usize,
    /// Number of steps into which the positions of the cutting plane divide each axis.
    pub cut_steps: usize,
    /// `true` if the page has fewer positions of the cutting plane than a browser can show, because
    /// of its size.
    pub is_thinned: bool,
    /// Number of faces in the page.
    pub faces: usize,
    /// Number of faces of the mesh.
    pub total_faces: usize,
}

impl PageStats {
    /// Returns the size of the page as text.
    pub fn size_text(self) -> String {
        let megabytes = self.bytes as f64 * 1e-6;
        let thinned = if self.is_thinned {
            format!(
                ", {} of {} faces: its cut stops at {} places along each axis",
                self.faces,
                self.total_faces,
                self.cut_steps - 1
            )
        } else {
            String::new()
        };
        format!("{megabytes:.1} MB{thinned}")
    }
}

/// Maximum size of a page in bytes.
pub const MAX_PAGE_BYTES: usize = 10_000_000;
/// Numbers of steps along an axis that are tried, from the largest (a bin is stored as a byte) to
/// two (one cut through the middle).
const CUT_STEPS: [usize; 24] = [
    256, 192, 128, 96, 80, 64, 56, 48, 40, 32, 28, 24, 20, 16, 14, 12, 10, 8, 7, 6, 5, 4, 3, 2,
];

/// Writes a page of at most `max_bytes` bytes. The file appears complete or not at all.
///
/// # Errors
/// Returns [`Error::Export`] if the mesh does not fit even with one position of the cutting plane,
/// and [`Error::Io`] if the file cannot be written.
pub fn write<const D: usize, M: Storable<D>>(
    path: &Path,
    image: Option<&Image<D>>,
    stored: &StoredMesh<D, M>,
    info: &PageInfo,
    max_bytes: usize,
) -> Result<PageStats> {
    let content = PageContent::new(image, stored, info)?;
    let faces = &content.faces;
    // Estimates of the bytes that every page has, and of the bytes of a face and of a cell. Each
    // page that is made corrects them.
    let fixed_bytes = 120_000.0
        + content
            .texture
            .as_ref()
            .map_or(0.0, |t| 1.35 * t.bytes.len() as f64);
    let bytes_per_cell = 3.0 + 2.6 * content.arrays.len() as f64;
    let estimate = |steps: usize| {
        let (kept, cells) = culling::count(faces, steps);
        5.5 * kept as f64 + bytes_per_cell * cells as f64
    };
    let mut correction = 1.0;
    // Search for the finest steps that fit. Steps before `finest` give pages that are too large.
    // Steps from `coarsest` on are not finer than those of the page found so far.
    let (mut finest, mut coarsest) = (0, CUT_STEPS.len());
    let (mut fitting_page, mut too_large) = (None, 0);
    while finest < coarsest {
        let is_small_enough = |&index: &usize| {
            fixed_bytes + correction * estimate(CUT_STEPS[index]) <= max_bytes as f64
        };
        let index = match (finest..coarsest).find(is_small_enough) {
            Some(index) => index,
            None if fitting_page.is_some() => break,
            None => coarsest - 1,
        };
        let steps = CUT_STEPS[index];
        let (page, kept_faces) = content.page(steps);
        correction = 1.01 * (page.len() as f64 - fixed_bytes).max(0.0) / estimate(steps);
        if page.len() > max_bytes {
            finest = index + 1;
            too_large = page.len();
        } else {
            coarsest = index;
            let stats = PageStats {
                bytes: page.len(),
                cut_steps: steps,
                is_thinned: steps < CUT_STEPS[0],
                faces: kept_faces,
                total_faces: faces.len(),
            };
            fitting_page = Some((page, stats));
        }
    }
    let Some((page, stats)) = fitting_page else {
        return Err(Error::Export(cause(
            path.display(),
            format!(
                "would have {:.1} MB even with only the sides, the features and one cut, but the limit is \
                 {:.1} MB",
                too_large as f64 * 1e-6,
                max_bytes as f64 * 1e-6
            ),
            "mesh a part of the image, or use a larger distance",
        )));
    };
    atomic_write(path, |out| out.write_all(page.as_bytes()))?;
    Ok(stats)
}

/// Contents of a page for any number of positions of the cutting planes.
struct PageContent<'a, const D: usize, M> {
    info: &'a PageInfo,
    stored: &'a StoredMesh<D, M>,
    faces: DrawableFaces,
    arrays: Vec<CellValues>,
    texture: Option<Texture>,
    frame: BoxFrame,
    /// Kind of each surface, large ones first.
    kinds: Vec<&'static str>,
    large_surfaces: usize,
}

impl<'a, const D: usize, M: Storable<D>> PageContent<'a, D, M> {
    fn new(
        image: Option<&Image<D>>,
        stored: &'a StoredMesh<D, M>,
        info: &'a PageInfo,
    ) -> Result<Self> {
        let surfaces = stored
            .feature_marks()
            .map(|marks| surfaces_by_bend(stored, &marks));
        let surfaces = surfaces.unwrap_or_default();
        let faces = DrawableFaces::from_mesh(stored, &surfaces.facets)?;
        Ok(Self {
            info,
            stored,
            arrays: values::scalar_arrays(stored, &faces, image),
            faces,
            texture: image.map(texture::from_image),
            frame: BoxFrame::new(&stored.space, image.map(|image| &image.geometry)),
            kinds: surfaces.kinds.iter().map(|kind| kind.name()).collect(),
            large_surfaces: surfaces.kept_count,
        })
    }

    /// Returns the page for `steps` positions of each cutting plane, and its number of faces.
    fn page(&self, steps: usize) -> (String, usize) {
        let (faces, lattice) = (&self.faces, &self.stored.lattice);
        let kept = PageMesh::new(faces, steps);
        let mut streams = ByteStreams::default();
        streams.add_faces(faces, &kept);
        let arrays: Vec<Value> = (self.arrays.iter())
            .map(|array| array.add_to_streams(&mut streams, &kept))
            .collect();
        if let Some(texture) = &self.texture {
            streams.add_image(texture);
        }
        let PackedStreams { base64, layout } = streams.pack();
        let metadata = json!({
            "about": self.info,
            "dimensions": D,
            "cells": M::CELLS_NAME,
            "counts": {
                "nodes": lattice.nodes().len(),
                "cells": lattice.len(),
                "faces": faces.len(),
                "kept": kept.faces.len(),
            },
            "steps": steps,
            "thinned": steps < CUT_STEPS[0],
            "frame": self.frame,
            "arrays": arrays,
            "surfaces": self.kinds,
            "large_surfaces": self.large_surfaces,
            "image": self.texture.as_ref().map(|texture| &texture.metadata),
            "streams": layout,
        });
        (html(&self.info.title, &metadata, &base64), kept.faces.len())
    }
}

/// Scripts of the page. Later scripts use earlier ones.
const SCRIPTS: [&str; 6] = [
    include_str!("unpack.js"),
    include_str!("maths.js"),
    include_str!("scene.js"),
    include_str!("labels.js"),
    include_str!("panel.js"),
    include_str!("view.js"),
];

/// Fills in the template of the page.
fn html(title: &str, metadata: &Value, base64: &str) -> String {
    // No text in the metadata may end the element that holds it.
    let metadata = metadata.to_string().replace('<', "\\u003c");
    let escaped = title
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;");
    let scripts = SCRIPTS.concat();
    let replacements = [
        ("{{title}}", escaped.as_str()),
        ("{{style}}", include_str!("style.css")),
        ("{{facts}}", metadata.as_str()),
        ("{{data}}", base64),
        ("{{script}}", scripts.as_str()),
    ];
    let mut page = String::with_capacity(base64.len() + metadata.len() + (1 << 17));
    let mut remaining = include_str!("page.html");
    while let Some(start) = remaining.find("{{") {
        page.push_str(&remaining[..start]);
        remaining = &remaining[start..];
        match replacements
            .iter()
            .find(|(placeholder, _)| remaining.starts_with(placeholder))
        {
            Some((placeholder, text)) => {
                page.push_str(text);
                remaining = &remaining[placeholder.len()..];
            }
            None => {
                page.push_str("{{");
                remaining = &remaining[2..];
            }
        }
    }
    page.push_str(remaining);
    page
}

#[cfg(test)]
mod tests;
