//! Reads unstructured grids in VTKHDF files, as the same grid in VTK's XML format.
//!
//! Layout: <https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html>.

use std::io::Cursor;
use std::path::Path;

use crate::Result;
use crate::error::io_error;
use crate::files::vtk::{ArrayPacking, DataArray, Document, Values, VtkFile};
use crate::image::formats::hdf5::Hdf5Source;
use crate::image::formats::hdf5::source::attribute_text;
use crate::image::formats::samples::{Endian, SampleType};

/// Group of the data.
const GROUP: &str = "/VTKHDF";

/// Returns `true` if a file holds an unstructured grid of VTKHDF.
pub fn is_grid(source: &Hdf5Source) -> bool {
    let group = source.group(GROUP);
    let kind = group.and_then(|group| attribute_text(&group.attribute("Type").ok()?));
    kind.as_deref() == Some("UnstructuredGrid")
}

/// Converts a grid to a VTK file in memory.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) for a damaged file, or one with steps of time.
pub fn to_vtk_file(source: &Hdf5Source, path: &Path) -> Result<VtkFile> {
    if source.group(&format!("{GROUP}/Steps")).is_some() {
        return Err(source.error(
            &format!("{GROUP}/Steps"),
            "has steps of time",
            "write one step, for example from ParaView",
        ));
    }
    let grid = Grid::read(source)?;
    let counts = [
        (
            "NumberOfPoints",
            (grid.points[0].values.len() / 3).to_string(),
        ),
        ("NumberOfCells", grid.cell_count.to_string()),
    ];
    let mut document = Document::with_packing("UnstructuredGrid", &[], ArrayPacking::None);
    document.open("Piece", &counts);
    for (element, arrays) in [
        ("PointData", &grid.point_data),
        ("CellData", &grid.cell_data),
        ("Points", &grid.points),
        ("Cells", &grid.cells),
    ] {
        document.open(element, &[]);
        for array in arrays {
            document.add_array(array.values.source(&array.name, array.components));
        }
        document.close();
    }
    let mut bytes = Cursor::new(Vec::new());
    let written = document.write(&mut bytes);
    written.map_err(|e| io_error(path, "convert", e))?;
    VtkFile::from_bytes(path, bytes.into_inner(), &["UnstructuredGrid"])
}

/// The arrays of a grid.
struct Grid {
    cell_count: usize,
    /// The only array of points.
    points: Vec<DataArray>,
    /// Arrays of the cells' description.
    cells: Vec<DataArray>,
    point_data: Vec<DataArray>,
    cell_data: Vec<DataArray>,
}

impl Grid {
    fn read(source: &Hdf5Source) -> Result<Self> {
        let array = |name: &str| read_array(source, &format!("{GROUP}/{name}"));
        let numbers = |name: &str| Ok(array(name)?.values.to_i64());
        let types = array("Types")?;
        let pieces: Pieces = Pieces {
            points: numbers("NumberOfPoints")?,
            cells: numbers("NumberOfCells")?,
            nodes: numbers("NumberOfConnectivityIds")?,
        };
        let damaged = || {
            let problem = "has cells whose arrays do not match";
            source.error(GROUP, problem, crate::files::REWRITE_DAMAGED)
        };
        let (nodes, offsets) = (numbers("Connectivity")?, numbers("Offsets")?);
        let (nodes, ends) = pieces.joined(nodes, &offsets).ok_or_else(damaged)?;
        let mut cells = vec![
            DataArray::scalars("connectivity", nodes),
            DataArray::scalars("offsets", ends),
        ];
        if has_group_member(source, "PolyhedronToFaces") {
            if pieces.points.len() > 1 {
                let problem = "has polyhedra in several pieces";
                return Err(source.error(
                    GROUP,
                    problem,
                    "merge them into one (ParaView: Merge Blocks)",
                ));
            }
            for (name, written) in [
                ("FaceConnectivity", "face_connectivity"),
                ("PolyhedronToFaces", "polyhedron_to_faces"),
            ] {
                cells.push(DataArray::scalars(written, numbers(name)?));
            }
            for (name, written) in [
                ("FaceOffsets", "face_offsets"),
                ("PolyhedronOffsets", "polyhedron_offsets"),
            ] {
                let ends = numbers(name)?.into_iter().skip(1);
                cells.push(DataArray::scalars(written, ends.collect::<Vec<i64>>()));
            }
        }
        let cell_count = types.values.len();
        cells.push(DataArray {
            name: "types".into(),
            ..types
        });
        Ok(Self {
            cell_count,
            points: vec![array("Points")?],
            cells,
            point_data: read_group(source, "PointData")?,
            cell_data: read_group(source, "CellData")?,
        })
    }
}

/// The number of points, of cells and of their nodes in each piece of a grid.
struct Pieces {
    points: Vec<i64>,
    cells: Vec<i64>,
    nodes: Vec<i64>,
}

impl Pieces {
    /// Returns the nodes of all cells and the end of each cell among them. In a file, both count from
    /// the beginning of their piece, and each piece has an offset more than cells. `None` if the
    /// arrays do not match.
    fn joined(&self, mut nodes: Vec<i64>, offsets: &[i64]) -> Option<(Vec<i64>, Vec<i64>)> {
        let mut ends = Vec::new();
        let (mut point, mut node, mut offset) = (0i64, 0i64, 0usize);
        let counts = self.points.iter().zip(&self.cells).zip(&self.nodes);
        for ((points, cells), count) in counts {
            let cells = usize::try_from(*cells).ok()?;
            let piece = offsets.get(offset..offset.checked_add(cells)?.checked_add(1)?)?;
            ends.extend(piece.iter().skip(1).map(|end| end + node));
            offset += cells + 1;
            let end = node.checked_add(*count)?;
            let range = usize::try_from(node).ok()?..usize::try_from(end).ok()?;
            nodes.get_mut(range)?.iter_mut().for_each(|n| *n += point);
            node = end;
            point = point.checked_add(*points)?;
        }
        Some((nodes, ends))
    }
}

fn has_group_member(source: &Hdf5Source, name: &str) -> bool {
    let group = source.group(GROUP);
    let names = group.and_then(|group| Some(group.member_names().ok()?.1));
    names.is_some_and(|names| names.iter().any(|known| known == name))
}

/// Reads the arrays of numbers of a group.
fn read_group(source: &Hdf5Source, name: &str) -> Result<Vec<DataArray>> {
    let path = format!("{GROUP}/{name}");
    let Some(group) = source.group(&path) else {
        return Ok(Vec::new());
    };
    let mut names = group
        .member_names()
        .map_or_else(|_| Vec::new(), |names| names.1);
    names.sort();
    let read = |name: String| read_array(source, &format!("{path}/{name}"));
    names.into_iter().map(read).collect()
}

/// Reads an array of numbers. Its last axis holds the components of each tuple.
fn read_array(source: &Hdf5Source, path: &str) -> Result<DataArray> {
    let set = source.dataset(path)?;
    let encoding = set.encoding()?;
    let bytes = set.read_bytes()?;
    let is_big = encoding.endian == Endian::Big;
    let kind = match encoding.sample_type {
        SampleType::I8 => "Int8",
        SampleType::U8 => "UInt8",
        SampleType::I16 => "Int16",
        SampleType::U16 => "UInt16",
        SampleType::I32 => "Int32",
        SampleType::U32 => "UInt32",
        SampleType::I64 => "Int64",
        SampleType::U64 => "UInt64",
        SampleType::F64 => "Float64",
        _ => "Float32",
    };
    let values = if encoding.sample_type == SampleType::F16 {
        let mut numbers = vec![0f32; bytes.len() / 2];
        encoding.decode(&bytes, &mut numbers);
        Some(Values::from(numbers))
    } else {
        Values::from_bytes(kind, &bytes, is_big)
    };
    let components = set.shape().iter().skip(1).product::<usize>().max(1);
    Ok(DataArray {
        name: path.rsplit('/').next().unwrap_or_default().to_string(),
        components,
        values: values.unwrap_or_else(|| Values::from(Vec::<f64>::new())),
    })
}
