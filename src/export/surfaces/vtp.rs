//! Surfaces as VTK poly data (`.vtp`): triangles, or line segments of a 2-D mesh; triangles back in.

use std::path::Path;

use crate::error::Result;
use crate::export::surfaces::file::SurfaceFile;
use crate::files::atomic_write;
use crate::files::vtk::{Document, Source, VtkFile};
use crate::store::vtu::{self, FieldValue, cell_values, check_lengths, read_nodes};

/// Writes surfaces with the number of each facet's surface (`surface`), the numbers of the file's
/// table of surfaces as cell data, and names as one text, a line a surface.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be written, [`Error::Mesh`](crate::Error::Mesh)
/// if an array does not have a tuple per facet.
pub fn write_vtp<const D: usize>(path: &Path, file: &SurfaceFile<D>) -> Result<()> {
    let (points, cells) = (file.nodes.len(), file.facets.len());
    check_lengths(path, &file.cell_data, cells, "facets")?;
    let names = file.names.join("\n");
    let labels = file.labels();
    let mut document = Document::new("PolyData", &[]);
    document.open("FieldData", &[]);
    document.array(Source::text("surfaces", &names));
    for (name, value) in &file.field_data {
        document.array(match value {
            FieldValue::Text(text) => Source::text(name, text),
            FieldValue::F64s(numbers) => Source::slice(name, 1, numbers),
            FieldValue::Ints(numbers) => Source::slice(name, 1, numbers),
        });
    }
    document.close();
    let shape = if D == 2 { "Lines" } else { "Polys" };
    let count = |of: &str| if of == shape { cells } else { 0 };
    let counts = ["Verts", "Lines", "Strips", "Polys"]
        .map(|of| (format!("NumberOf{of}"), count(of).to_string()));
    let mut attributes = vec![("NumberOfPoints", points.to_string())];
    attributes.extend(counts.iter().map(|(name, n)| (name.as_str(), n.clone())));
    document.open("Piece", &attributes);
    document.open("CellData", &[("Scalars", "surface".to_string())]);
    document.array(Source::slice("surface", 1, &labels));
    for array in &file.cell_data {
        document.array(array.values.source(&array.name, array.components));
    }
    document.close();
    document.open("Points", &[]);
    document.array(Source::slice("Points", 3, file.nodes.as_flattened()));
    document.close();
    document.open(shape, &[]);
    let corners = file.facets.as_flattened();
    document.array(Source::computed("connectivity", 1, corners.len(), |i| {
        i64::from(corners[i])
    }));
    document.array(Source::computed("offsets", 1, cells, |i| {
        (D * (i + 1)) as i64
    }));
    document.close();
    atomic_write(path, |out| document.write(out))
}

/// The triangles of a file, ours or VTK's (polygons are cut into fans): all, or those of the surface
/// of that number.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be read, is damaged, or does not number its
/// surfaces though a number is given.
pub fn read_triangles(path: &Path, number: Option<i64>) -> Result<Vec<[[f64; 3]; 3]>> {
    let file = VtkFile::read(path, "PolyData")?;
    let piece = file.piece()?;
    let points = vtu::count(&file, piece, "NumberOfPoints")?;
    let nodes: Vec<[f64; 3]> = read_nodes(&file, file.child(piece, "Points")?, points)?;
    let element = file.child(piece, "Polys")?;
    let corners = cell_values(&file, element, "connectivity")?;
    let ends = cell_values(&file, element, "offsets")?;
    let labels = match number {
        None => Vec::new(),
        Some(_) => cell_values(&file, file.child(piece, "CellData")?, "surface")?,
    };
    let mut found = Vec::new();
    let mut start = 0;
    for (i, &end) in ends.iter().enumerate() {
        let ring = usize::try_from(end)
            .ok()
            .and_then(|end| corners.get(start..end));
        let node = |&n: &i64| usize::try_from(n).ok().and_then(|n| nodes.get(n)).copied();
        let ring: Option<Vec<[f64; 3]>> = ring.and_then(|ring| ring.iter().map(node).collect());
        let Some(ring) = ring else {
            let problem = format!("its polygon {i} is damaged");
            return Err(file.fault(problem, "write it again"));
        };
        start = end as usize;
        if labels.get(i).copied() == number || number.is_none() {
            found.extend((2..ring.len()).map(|k| [ring[0], ring[k - 1], ring[k]]));
        }
    }
    Ok(found)
}
