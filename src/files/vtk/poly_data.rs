//! Writes VTK poly data (`.vtp`) whose cells are of one kind.

use std::path::Path;

use super::{ArraySource, Document};
use crate::Result;
use crate::files::atomic_write;

/// The elements of cells in a file, in the order in which a file states their numbers.
pub const POLY_ELEMENTS: &[&str] = &["Verts", "Lines", "Strips", "Polys"];

/// Poly data to be written: vertices, lines or polygons.
pub struct PolyData<'a> {
    /// The element of the cells.
    pub element: &'static str,
    /// The elements whose numbers of cells the file states; all but `element` have none.
    pub counted: &'static [&'static str],
    /// Values that belong to the whole file.
    pub fields: Vec<ArraySource<'a>>,
    /// Values of the points; `None` leaves out their element.
    pub point_data: Option<Vec<ArraySource<'a>>>,
    /// Values of the cells; `None` leaves out their element.
    pub cell_data: Option<Vec<ArraySource<'a>>>,
    /// Name of the values of the cells that programs show first.
    pub scalars: Option<&'static str>,
    /// Positions of the points, with three components.
    pub points: ArraySource<'a>,
    /// Points of the cells, one cell after the other; `None` for all points in their order.
    pub corners: Option<&'a [u32]>,
    /// End of each cell in the list of their points.
    pub ends: ArraySource<'a>,
}

impl<'a> PolyData<'a> {
    /// Creates poly data of `cell_count` cells without values. Cell `i` ends before point `end_of(i)`
    /// of the list of their points.
    pub fn new(
        element: &'static str,
        points: &'a [[f64; 3]],
        cell_count: usize,
        end_of: impl Fn(usize) -> i64 + Sync + 'a,
    ) -> Self {
        Self {
            element,
            counted: POLY_ELEMENTS,
            fields: Vec::new(),
            point_data: None,
            cell_data: None,
            scalars: None,
            points: ArraySource::slice("Points", 3, points.as_flattened()),
            corners: None,
            ends: ArraySource::computed("offsets", 1, cell_count, end_of),
        }
    }

    /// Writes the file.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn write(self, path: &Path) -> Result<()> {
        let (point_count, cell_count) = (self.points.tuple_count(), self.ends.tuple_count());
        let scalars = self.scalars.map(|name| ("Scalars", name.to_string()));
        let connectivity = match self.corners {
            Some(corners) => {
                ArraySource::computed("connectivity", 1, corners.len(), |i| i64::from(corners[i]))
            }
            None => ArraySource::computed("connectivity", 1, point_count, |i| i as i64),
        };
        let count = |element: &str| match element {
            element if element == self.element => cell_count,
            _ => 0,
        };
        let counts: Vec<(String, String)> = (self.counted.iter())
            .map(|element| (format!("NumberOf{element}"), count(element).to_string()))
            .collect();
        let mut attributes = vec![("NumberOfPoints", point_count.to_string())];
        attributes.extend(counts.iter().map(|(name, n)| (name.as_str(), n.clone())));

        let mut document = Document::new("PolyData", &[]);
        if !self.fields.is_empty() {
            document.add_element("FieldData", &[], self.fields);
        }
        document.open("Piece", &attributes);
        if let Some(arrays) = self.point_data {
            document.add_element("PointData", &[], arrays);
        }
        if let Some(arrays) = self.cell_data {
            document.add_element("CellData", scalars.as_slice(), arrays);
        }
        document.add_element("Points", &[], vec![self.points]);
        document.add_element(self.element, &[], vec![connectivity, self.ends]);
        atomic_write(path, |out| document.write(out))
    }
}
