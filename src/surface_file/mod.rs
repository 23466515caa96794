//! Surfaces of triangles in files of their own: faults and horizons, with names, values and units.
//!
//! - `tsurf`: GOCAD surfaces, lines and points
//! - `vtp`: VTK poly data
//! - `obj`, `stl`, `ply`: triangles of other programs
//! - `grid_surfaces`: faults and horizons of corner-point grids
//! - `sticks`: fault sticks
//! - `joining`: fault sticks become surfaces
//! - `place_terms`, `place_columns`, `point_table`: points and sticks in tables
//! - `file_option`: files of positions as values of options
//! - `interpretation`: surfaces that a user gives, of any of these formats, of grids and of points
//! - `placed`: brings such a surface into the frame of an image
//! - `write`: the choice of the format, and of the names in it

pub(crate) mod file_option;
pub(crate) mod grid_surfaces;
pub mod interpretation;
pub mod joining;
pub mod obj;
pub mod place_columns;
mod place_terms;
pub mod placed;
pub mod ply;
pub mod point_table;
pub mod sticks;
pub mod stl;
pub mod tsurf;
pub mod vtp;
mod write;

use std::path::Path;

use crate::Result;
use crate::files::vtk::DataArray;
use crate::files::vtk::pieces::FieldValue;
use crate::geometry::{sorted_distinct, to_3d};
use crate::image::Geometry;
use crate::image::stated::{StatedCoordinates, ZDirection};
pub use file_option::FileOption;

/// Surfaces in physical coordinates: triangles (`D` = 3), or line segments (`D` = 2) at z = 0.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurfaceFile<const D: usize> {
    /// Node positions.
    pub nodes: Vec<[f64; 3]>,
    /// Nodes of each facet, surface by surface.
    pub facets: Vec<[u32; D]>,
    /// Index of the first facet of each surface, and the number of facets at the end.
    pub surface_starts: Vec<usize>,
    /// Names of the surfaces, as a file or the user gives them, on one line.
    pub names: Vec<String>,
    /// Arrays with one tuple per facet.
    pub cell_data: Vec<DataArray>,
    /// Values that belong to the whole file.
    pub field_data: Vec<(String, FieldValue)>,
    /// Units of the coordinates. Empty if unknown.
    pub units: [String; 3],
    /// `true` if z grows upwards.
    pub z_up: bool,
    /// The statements of the file about its coordinates, if the surfaces were read.
    pub stated: StatedCoordinates,
}

impl<const D: usize> SurfaceFile<D> {
    /// Creates surfaces with the names `name`1, `name`2 ... and only those nodes that they use.
    pub fn new(nodes: &[[f64; D]], facets: &[[u32; D]], start: &[usize], name: &str) -> Self {
        let used = sorted_distinct(facets.as_flattened().iter().copied());
        let new_index = |n: u32| used.partition_point(|&m| m < n) as u32;
        let version = FieldValue::Text(env!("CARGO_PKG_VERSION").to_string());
        let position = |&n: &u32| to_3d(nodes[n as usize]);
        Self {
            nodes: used.iter().map(position).collect(),
            facets: facets.iter().map(|f| f.map(new_index)).collect(),
            surface_starts: start.to_vec(),
            names: (1..start.len()).map(|s| format!("{name}{s}")).collect(),
            cell_data: Vec::new(),
            field_data: vec![("atomesh_version".into(), version)],
            units: Default::default(),
            z_up: true,
            stated: StatedCoordinates::default(),
        }
    }

    /// Returns the facets of a surface.
    pub fn surface_facets(&self, surface: usize) -> &[[u32; D]] {
        &self.facets[self.surface_starts[surface]..self.surface_starts[surface + 1]]
    }

    /// Returns the surface number of each facet, from 1, as in the names.
    pub fn labels(&self) -> Vec<i32> {
        let sizes = self.surface_starts.windows(2).map(|w| w[1] - w[0]);
        let labels = (1..).zip(sizes);
        labels
            .flat_map(|(s, n)| std::iter::repeat_n(s, n))
            .collect()
    }

    /// Sets units and direction of z to those that a file states.
    pub fn set_stated(&mut self, stated: StatedCoordinates) {
        self.units = stated.units.clone().map(Option::unwrap_or_default);
        self.z_up = stated.z_direction != Some(ZDirection::Down);
        self.stated = stated;
    }

    /// Returns the surfaces with the units of a geometry. `z_up` is `true` if z grows upwards.
    pub(crate) fn with_space(self, geometry: &Geometry<D>, z_up: bool) -> Self {
        Self {
            units: geometry.to_3d().units,
            z_up,
            ..self
        }
    }
}

impl SurfaceFile<3> {
    /// Creates surfaces of triangles, each with its name. z grows upwards.
    pub(crate) fn from_triangles(
        surfaces: impl IntoIterator<Item = (String, Vec<[[f64; 3]; 3]>)>,
    ) -> Self {
        let mut file = Self {
            surface_starts: vec![0],
            z_up: true,
            ..Self::default()
        };
        for (name, triangles) in surfaces {
            for triangle in triangles {
                let first = file.nodes.len() as u32;
                file.nodes.extend(triangle);
                file.facets.push([first, first + 1, first + 2]);
            }
            file.names.push(name);
            file.surface_starts.push(file.facets.len());
        }
        file
    }
}

/// Returns `true` if the file's ending is one of `endings`, in upper or lower case.
pub(crate) fn has_extension(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    endings
        .iter()
        .any(|known| ending.eq_ignore_ascii_case(known))
}

/// Surfaces of a mesh in the plane or in space.
#[derive(Debug, Clone, PartialEq)]
pub enum AnySurfaces {
    /// Curves in the plane.
    Curves(SurfaceFile<2>),
    /// Surfaces in space.
    Surfaces(SurfaceFile<3>),
}

impl From<SurfaceFile<2>> for AnySurfaces {
    fn from(file: SurfaceFile<2>) -> Self {
        Self::Curves(file)
    }
}

impl From<SurfaceFile<3>> for AnySurfaces {
    fn from(file: SurfaceFile<3>) -> Self {
        Self::Surfaces(file)
    }
}

/// File endings of the surface formats that can be written.
pub(crate) const SURFACE_EXTENSIONS: [&str; 3] = ["vtp", "obj", "ts"];

impl AnySurfaces {
    /// Writes the surfaces in the format of the file's ending.
    ///
    /// # Errors
    /// Returns the errors of [`SurfaceFile::write`].
    pub fn write(&self, path: &Path) -> Result<()> {
        match self {
            Self::Curves(file) => file.write(path),
            Self::Surfaces(file) => file.write(path),
        }
    }

    /// Returns the number of surfaces.
    pub fn count(&self) -> usize {
        match self {
            Self::Curves(file) => file.names.len(),
            Self::Surfaces(file) => file.names.len(),
        }
    }
}
