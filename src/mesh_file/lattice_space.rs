//! Where the lattice space of a mesh lies in the world, and the other fields that every mesh file has.

use serde::Deserialize;

use super::array_names::{
    AXES_FIELD, INPUT_HASH_FIELD, LATTICE_EXTENT_FIELD, LATTICE_STEP_FIELD, ORIGIN_FIELD,
    PARAMETERS_FIELD, UNITS_FIELD, VELOCITY_FIELD, VERSION_FIELD,
};
use super::named_regions::read_bent_side;
use super::{FieldValue, MeshFile};
use crate::error::cause;
use crate::geometry::{bounding_box, sub};
use crate::image::Geometry;
use crate::image::time::metres_per_unit;
use crate::mesh::Mesh;
use crate::mesh::check::BOX_TOLERANCE;
use crate::option_text::NumberOrFile;
use crate::{Error, Result};

/// Fields that describe the position of lattice space.
pub(crate) const LATTICE_SPACE_FIELDS: [&str; 4] = [
    ORIGIN_FIELD,
    AXES_FIELD,
    LATTICE_STEP_FIELD,
    LATTICE_EXTENT_FIELD,
];
/// The data from which a result can be reproduced.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Provenance {
    /// All parameters, as the configuration file has them.
    pub parameters: String,
    /// SHA-256 of the input.
    pub input_sha256: String,
}
/// Returns the fields of every mesh file: provenance, and the position of lattice space.
pub(crate) fn common_fields<const D: usize>(
    geometry: &Geometry<D>,
    step: [f64; D],
    extent: [f64; D],
    provenance: &Provenance,
) -> Vec<(String, FieldValue)> {
    let text = |text: &str| FieldValue::Text(text.to_string());
    vec![
        (UNITS_FIELD.into(), text(&geometry.units.join(","))),
        (VERSION_FIELD.into(), text(env!("CARGO_PKG_VERSION"))),
        (PARAMETERS_FIELD.into(), text(&provenance.parameters)),
        (INPUT_HASH_FIELD.into(), text(&provenance.input_sha256)),
        (
            ORIGIN_FIELD.into(),
            FieldValue::F64s(geometry.origin.to_vec()),
        ),
        (AXES_FIELD.into(), FieldValue::F64s(geometry.axes.concat())),
        (LATTICE_STEP_FIELD.into(), FieldValue::F64s(step.to_vec())),
        (
            LATTICE_EXTENT_FIELD.into(),
            FieldValue::F64s(extent.to_vec()),
        ),
    ]
}
/// The position of the lattice space of a mesh in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct LatticeSpace<const D: usize> {
    /// The upper corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis of lattice space.
    pub step: [f64; D],
    /// Map from samples to physical coordinates.
    pub geometry: Geometry<D>,
    /// Number of the side of the box that follows a topography, if there is one: 2 axis for the lower side, 2 axis + 1
    /// for the upper side. All other sides are flat.
    pub bent_side: Option<usize>,
    /// `true` if the file contains the position. Otherwise lattice space is the file's own space,
    /// moved so that the mesh begins at the origin.
    pub is_stored: bool,
    /// Name of the velocity file that converted the mesh to depth, if there is one. Then the image
    /// that was meshed is not the image in its file.
    pub velocities: Option<String>,
}

impl<const D: usize> LatticeSpace<D> {
    /// Reads the position of lattice space of a mesh with these nodes. Returns `None` if the file
    /// has only some of the fields.
    pub(crate) fn from_file<M>(file: &MeshFile<M>, nodes: &[[f64; D]]) -> Option<Self> {
        let array = |name: &str| match file.field_value(name) {
            Some(FieldValue::F64s(values)) => Some(values.as_slice()),
            _ => None,
        };
        let vector = |name: &str| <[f64; D]>::try_from(array(name)?).ok();
        let known = LATTICE_SPACE_FIELDS.map(|name| array(name).is_some());
        if known == [false; 4] {
            let [low, high] = bounding_box(nodes);
            return Some(Self {
                extent: sub(high, low),
                step: [1.0; D],
                geometry: Geometry::with_spacing(low, [1.0; D]),
                bent_side: None,
                is_stored: false,
                velocities: velocity_file(file),
            });
        }
        let axes = array(AXES_FIELD).filter(|axes| axes.len() == D * D)?;
        let mut units = match file.field_value(UNITS_FIELD) {
            Some(FieldValue::Text(text)) => text.as_str(),
            _ => "",
        }
        .split(',');
        Some(Self {
            extent: vector(LATTICE_EXTENT_FIELD)?,
            step: vector(LATTICE_STEP_FIELD)?,
            geometry: Geometry {
                origin: vector(ORIGIN_FIELD)?,
                axes: std::array::from_fn(|k| std::array::from_fn(|c| axes[D * k + c])),
                units: std::array::from_fn(|_| units.next().unwrap_or_default().to_string()),
                ..Geometry::default()
            },
            bent_side: read_bent_side(file).filter(|side| *side < 2 * D),
            is_stored: true,
            velocities: velocity_file(file),
        })
    }

    /// Converts a position from lattice space to the world.
    pub fn to_world(&self, x: [f64; D]) -> [f64; D] {
        let index = std::array::from_fn(|k| x[k] / self.step[k]);
        self.geometry.to_physical(index)
    }

    /// Converts a position from the world to lattice space; `None` if the axes are linearly
    /// dependent.
    pub fn to_lattice(&self, point: [f64; D]) -> Option<[f64; D]> {
        let index = self.geometry.to_index(point)?;
        Some(std::array::from_fn(|k| index[k] * self.step[k]))
    }

    /// Returns the tolerance with which the mesh fills its box, relative to the box: that of a new
    /// mesh, or the rounding of the coordinates in the file if that is larger (coordinates can be
    /// large compared with the cells, in metres of a national grid for example).
    pub fn tolerance(&self) -> f64 {
        let corner = |c: usize| -> [f64; D] {
            std::array::from_fn(|k| if c >> k & 1 == 1 { self.extent[k] } else { 0.0 })
        };
        let corners = (0..1 << D).flat_map(|c| self.to_world(corner(c)));
        let rounding = f64::EPSILON * corners.fold(0.0, |max, x| x.abs().max(max));
        let without_origin = Geometry {
            origin: [0.0; D],
            ..self.geometry.clone()
        };
        let axis_column = |c: usize| {
            without_origin.to_index(std::array::from_fn(|k| f64::from(u8::from(k == c))))
        };
        let columns: Option<Vec<[f64; D]>> = (0..D).map(axis_column).collect();
        let error_along = |k: usize| -> f64 {
            let columns = columns.iter().flatten();
            columns.map(|column| column[k].abs()).sum::<f64>() * self.step[k] * rounding
        };
        let error: f64 = (0..D).map(|k| error_along(k) / self.extent[k]).sum();
        (4.0 * error).clamp(BOX_TOLERANCE, 1e-3)
    }

    /// Returns the number of samples along each axis of the image that was meshed.
    pub fn dims(&self) -> [f64; D] {
        std::array::from_fn(|k| self.extent[k] / self.step[k] + 1.0)
    }

    /// Returns `true` if the map to the world mirrors space.
    pub fn is_mirrored(&self) -> bool {
        self.geometry.determinant() < 0.0
    }

    /// Returns `true` if an image of these dimensions fills the box.
    pub fn fits_dims(&self, dims: [usize; D]) -> bool {
        let own_dims = self.dims();
        (0..D).all(|k| (dims[k] as f64 - own_dims[k]).abs() <= 1e-6)
    }

    /// Returns `true` if the mesh covers the voxels of an image of these dimensions, and not only the box
    /// through its outermost samples.
    pub fn covers_voxels_of(&self, dims: [usize; D]) -> bool {
        self.fits_dims(dims.map(|n| n + 1))
    }

    /// Checks that an image of these dimensions fills the box. `place` names the image in errors.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if it does not.
    pub fn check_dims(&self, dims: [usize; D], place: &str) -> Result<()> {
        if self.fits_dims(dims) {
            return Ok(());
        }
        if self.covers_voxels_of(dims) {
            return Err(Error::Image(cause(
                place,
                "has samples in the middle of voxels, which the mesh covers as a whole (--cover voxels)",
                "mesh the image without --cover to use both together",
            )));
        }
        Err(Error::Image(cause(
            place,
            format!("has {dims:?} samples, but the mesh has {:?}", self.dims()),
            "give the image that was meshed, or one of the same dimensions",
        )))
    }
}
/// The option among the recorded parameters of a mesh that says whether velocities converted it to depth.
#[derive(Deserialize)]
struct ParametersRecord {
    velocity: Option<NumberOrFile>,
}

/// Returns the name of the velocity file that converted a mesh to depth, if there is one.
fn velocity_file<M>(file: &MeshFile<M>) -> Option<String> {
    if let Some(FieldValue::Text(name)) = file.field_value(VELOCITY_FIELD) {
        return Some(name.trim_end_matches('\0').to_string());
    }
    let Some(FieldValue::Text(record)) = file.field_value(PARAMETERS_FIELD) else {
        return None;
    };
    let record: ParametersRecord = toml::from_str(record.trim_end_matches('\0')).ok()?;
    Some(record.velocity?.file()?.display().to_string())
}
impl<const D: usize> LatticeSpace<D> {
    /// Checks that an image fills the box of the mesh, sample by sample. `place` names the image in
    /// errors.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if the image has other dimensions, or if it is in two-way time and
    /// the mesh was made of an image that velocities had converted to depth.
    pub fn check_image(&self, image: &Geometry<D>, dims: [usize; D], place: &str) -> Result<()> {
        self.check_time(image, dims, place)?;
        self.check_dims(dims, place)
    }

    /// Returns an error for an image in two-way time with a mesh in depth. A mesh converted with a
    /// constant velocity is accepted: then the numbers of samples agree.
    fn check_time(&self, image: &Geometry<D>, dims: [usize; D], place: &str) -> Result<()> {
        let is_in_depth = |c: usize| {
            self.velocities.is_some() || metres_per_unit(&self.geometry.units[c]).is_some()
        };
        if !image.time_coordinate().is_some_and(is_in_depth) {
            return Ok(());
        }
        let (source, velocity) = match &self.velocities {
            None if self.fits_dims(dims) => return Ok(()),
            None => (String::new(), "V"),
            Some(name) => (format!(" by {name}"), name.as_str()),
        };
        let problem = format!("is in two-way time, the mesh in depth{source}");
        let remedy = format!(
            "make the image in depth: atomesh convert --velocity {velocity} {place} depth.vti"
        );
        Err(Error::Image(cause(place, problem, remedy)))
    }
}

/// Returns the geometry in depth of an image in two-way time whose mesh was converted to depth.
/// Returns `None` if image and mesh are in the same domain, or if the mesh was not made of an image
/// with these dimensions. `place` names the image in errors.
///
/// # Errors
/// Returns [`Error::Image`] if a constant velocity cannot map the image to the mesh.
pub fn image_geometry_in_depth<const D: usize, M: Mesh<D>>(
    file: &MeshFile<M>,
    image: &Geometry<D>,
    dims: [usize; D],
    place: &str,
) -> Result<Option<Geometry<D>>> {
    let Some(space) = LatticeSpace::from_file(file, file.mesh.nodes()) else {
        return Ok(None);
    };
    if image.time_coordinate().is_none() {
        return Ok(None);
    }
    space.check_time(image, dims, place)?;
    let is_in_depth =
        space.is_stored && space.fits_dims(dims) && space.geometry.time_coordinate().is_none();
    Ok(is_in_depth.then(|| Geometry {
        names: image.names.clone(),
        ..space.geometry
    }))
}
