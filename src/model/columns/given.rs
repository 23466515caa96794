//! Horizons that a user gives, brought to one unit and one direction of z over a map.

use super::horizon::{Horizon, TriangleIndex};
use crate::error::cause;
use crate::geometry::grid_index::index_at;
use crate::image::formats::{AnyImage, InputOptions, ReadImage};
use crate::image::placing::{Frame, GivenFile, Region};
use crate::image::point_nulls::{NullSearch, Pairs};
use crate::image::stated::{CoordinateOptions, StatedCoordinates, ZDirection};
use crate::image::{Geometry, Image};
use crate::option_text::InvalidValue;
use crate::progress::Progress;
use crate::store::LatticeSpace;
use crate::surface_file::interpretation::{
    PickedShape, PickedSurface, read_interpretation_as, triangulate_points,
};
use crate::surface_file::{FileOption, has_extension};
use crate::units::{self, Quantity};
use crate::{Error, Result};

/// Smallest ratio between the distances of two horizons, as they are and with the sign of one turned,
/// from which the sign is turned.
const TURNED_RATIO: f64 = 4.0;

/// Largest number of names in a message.
const MAX_NAMES: usize = 20;

/// Endings of files of surfaces and points. All others are images.
const SURFACE_ENDINGS: [&str; 11] = [
    "vtp", "ts", "obj", "pl", "vs", "csv", "xyz", "txt", "dat", "charisma", "asc",
];

/// Returns the error of an impossible value of `--horizon`.
fn refused(text: &str, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(format!("--horizon {text}"), problem, remedy))
}

/// Returns the file that the value of `--horizon` names; `None` if it is a number.
///
/// # Errors
/// Returns [`Error::Job`] for an impossible value.
pub(super) fn horizon_file(text: &str) -> Result<Option<FileOption>> {
    if text.parse::<f64>().is_ok() {
        return Ok(None);
    }
    let option: FileOption = text
        .parse()
        .map_err(|error: InvalidValue| refused(text, &error.problem, &error.remedy))?;
    if option.is_horizon == Some(false) {
        return Err(refused(text, "is a horizon and no fault", "omit ,fault"));
    }
    Ok(Some(option))
}

/// A horizon as a user gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenHorizon {
    /// The option that gives it, for messages.
    pub place: String,
    /// Its shape, in the coordinates of its file.
    pub shape: HorizonShape,
    /// The statements of the option about its coordinates.
    pub options: CoordinateOptions,
}

/// Shape of a horizon in its file.
#[derive(Debug, Clone, PartialEq)]
pub enum HorizonShape {
    /// A constant z.
    Flat(f64),
    /// An image of z.
    Grid(Box<Image<2>>),
    /// Surfaces or points of one name, all of which are one horizon.
    Surfaces(Vec<PickedSurface>),
}

/// Horizons over a map in one unit and one direction of z.
#[derive(Debug, Clone)]
pub struct PlacedHorizons {
    /// The horizons, with their names in messages.
    pub horizons: Vec<(String, Horizon)>,
    /// The unit of z.
    pub z_unit: String,
    /// Notes for the user.
    pub notes: Vec<String>,
}

impl GivenHorizon {
    /// Creates a horizon of constant z, named `place` in messages.
    pub fn flat(place: &str, z: f64) -> Self {
        Self {
            place: place.to_string(),
            shape: HorizonShape::Flat(z),
            options: CoordinateOptions::default(),
        }
    }

    /// Reads a horizon from the value `text` of the option: a number, an image of z, or a file of
    /// surfaces or points.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an impossible value, and the errors of reading the file.
    pub fn read(
        text: &str,
        input: &InputOptions,
        read_image: ReadImage<'_>,
        progress: &mut dyn Progress,
    ) -> Result<Self> {
        let nulls = input.point_nulls()?;
        let given = |shape, options: &CoordinateOptions| Self {
            place: text.to_string(),
            shape,
            options: options.with_nulls(nulls.clone()),
        };
        let Some(option) = horizon_file(text)? else {
            let z = text.trim().parse().unwrap_or(f64::NAN);
            if !f64::is_finite(z) {
                return Err(refused(text, "is not a finite number", "give a finite z"));
            }
            return Ok(given(HorizonShape::Flat(z), &CoordinateOptions::default()));
        };
        let path = option.path.as_path();
        if !has_extension(path, &SURFACE_ENDINGS) {
            let AnyImage::Plane(loaded) = read_image(path, input)? else {
                let remedy = "give an image of z over the map";
                return Err(refused(text, "is a 3-D image", remedy));
            };
            loaded.notes.iter().for_each(|note| progress.note(note));
            return Ok(given(
                HorizonShape::Grid(Box::new(loaded.image)),
                &option.coordinates,
            ));
        }
        let mut surfaces = read_interpretation_as(path, &option.coordinates.columns)?;
        if let Some(name) = &option.name {
            let named = surfaces.iter().position(|surface| surface.name == *name);
            let number = name.parse::<usize>().ok();
            let by_number = number.and_then(|number| number.checked_sub(1));
            let Some(k) = named.or(by_number.filter(|&k| k < surfaces.len())) else {
                let names: Vec<&str> = surfaces.iter().map(|s| s.name.as_str()).collect();
                let problem = format!("names no surface: the file has {}", names.join(", "));
                let remedy = "give FILE, FILE:NAME or FILE:NUMBER";
                return Err(refused(text, &problem, remedy));
            };
            surfaces = vec![surfaces.swap_remove(k)];
        }
        Ok(given(HorizonShape::Surfaces(surfaces), &option.coordinates))
    }

    /// Returns the statements of the file.
    fn stated(&self) -> StatedCoordinates {
        match &self.shape {
            HorizonShape::Surfaces(surfaces) => surfaces
                .first()
                .map(|surface| surface.coordinates.clone())
                .unwrap_or_default(),
            HorizonShape::Grid(image) => {
                let unit =
                    |k: usize| Some(image.geometry.units[k].clone()).filter(|u| !u.is_empty());
                StatedCoordinates {
                    units: [unit(0), unit(1), None],
                    ..StatedCoordinates::default()
                }
            }
            HorizonShape::Flat(_) => StatedCoordinates::default(),
        }
    }

    /// Returns the direction of z that the option or the file states.
    fn direction(&self) -> Option<ZDirection> {
        self.options.z_direction.or(self.stated().z_direction)
    }

    /// Returns the unit of z that the option or the file states.
    fn z_unit(&self) -> Option<units::Unit> {
        let stated = self.stated().units;
        let name = self.options.unit(2).map(String::from).or(stated[2].clone());
        name.and_then(|name| units::find(&name))
    }
}

/// Returns horizons in the frame of a map. `z_unit` is the unit of z, by default that of the map's x;
/// horizons of which the first states a unit of time are in that unit. z grows as in the first horizon
/// that states it.
///
/// # Errors
/// Returns [`Error::Job`] for horizons in units that do not suit the map, or that are no surfaces.
pub fn place_horizons(
    given: Vec<GivenHorizon>,
    map: &LatticeSpace<2>,
    z_unit: Option<&str>,
) -> Result<PlacedHorizons> {
    let stated_unit = given.iter().find_map(GivenHorizon::z_unit);
    let x_unit = &map.geometry.units[0];
    let is_time = stated_unit.is_some_and(|unit| unit.quantity == Quantity::Time);
    let z_unit = match (z_unit, stated_unit) {
        (Some(unit), _) => unit.to_string(),
        (None, Some(unit)) if is_time || x_unit.is_empty() => unit.symbol.to_string(),
        _ => x_unit.clone(),
    };
    let direction = given.iter().find_map(GivenHorizon::direction);
    let mut geometry = map.geometry.to_3d();
    geometry.units[2].clone_from(&z_unit);
    let [nx, ny] = map.dims().map(|n| n.round() as usize);
    let frame = Frame::new(&geometry, [nx, ny, 1])
        .in_region(Region::Column)
        .with_direction(direction);
    let reference = given
        .iter()
        .position(|horizon| horizon.direction() == direction);
    let is_stated: Vec<bool> = given.iter().map(|h| h.direction().is_some()).collect();
    let mut notes = Vec::new();
    let mut horizons = Vec::new();
    for horizon in given {
        let place = horizon.place.clone();
        let (placed, texts) = horizon.placed(&frame, map)?;
        if !texts.is_empty() {
            notes.push(format!("{place}: {}", texts.join(", ")));
        }
        horizons.push((place, placed));
    }
    let reference_z = reference.and_then(|r| mean_z(&horizons[r].1));
    for (k, (place, horizon)) in horizons.iter_mut().enumerate() {
        let (Some(z), Some(other)) = (mean_z(horizon), reference_z) else {
            continue;
        };
        let is_opposite = !is_stated[k] && (z - other).abs() > TURNED_RATIO * (z + other).abs();
        if is_opposite {
            turn(horizon);
            notes.push(format!(
                "{place}: with the sign of z turned, as that of the other horizons (else add ,z=up or ,z=down)"
            ));
        }
    }
    Ok(PlacedHorizons {
        horizons,
        z_unit,
        notes,
    })
}

impl GivenHorizon {
    /// Returns the horizon in a frame, and notes.
    fn placed(self, frame: &Frame<3>, map: &LatticeSpace<2>) -> Result<(Horizon, Vec<String>)> {
        let stated = self.stated();
        let Self {
            place,
            shape,
            options,
        } = self;
        let file = GivenFile {
            place: &place,
            stated: &stated,
            options: &options,
        };
        match shape {
            HorizonShape::Flat(z) => Ok((Horizon::Flat(z), Vec::new())),
            HorizonShape::Grid(image) => placed_grid(*image, file, frame, map),
            HorizonShape::Surfaces(surfaces) => {
                check_one_horizon(&surfaces, &place)?;
                let mut triangles = Vec::new();
                let mut notes: Vec<String> = Vec::new();
                for surface in &surfaces {
                    let placed = surface.placed(frame, &place, &options)?;
                    triangles.extend(horizon_triangles(&placed.shape, &place)?);
                    let new = placed
                        .notes
                        .into_iter()
                        .filter(|note| !notes.contains(note));
                    notes.extend(new.collect::<Vec<_>>());
                }
                if triangles.is_empty() {
                    let remedy = "give a surface, a grid of heights or points";
                    return Err(Error::Job(cause(place, "has no such surface", remedy)));
                }
                Ok((Horizon::Surface(TriangleIndex::new(triangles)), notes))
            }
        }
    }
}

/// Refuses surfaces of several names, which are several horizons.
fn check_one_horizon(surfaces: &[PickedSurface], place: &str) -> Result<()> {
    let mut names: Vec<&str> = Vec::new();
    for surface in surfaces {
        if !names.contains(&surface.name.as_str()) {
            names.push(&surface.name);
        }
    }
    if names.len() < 2 {
        return Ok(());
    }
    let count = names.len();
    names.truncate(MAX_NAMES);
    let more = if count > MAX_NAMES { " ..." } else { "" };
    let problem = format!("has {count} surfaces: {}{more}", names.join(", "));
    let remedy = format!("name one of them as FILE:NAME, such as FILE:{}", names[0]);
    Err(Error::Job(cause(place, problem, remedy)))
}

/// Returns the triangles of a horizon.
fn horizon_triangles(shape: &PickedShape, place: &str) -> Result<Vec<[[f64; 3]; 3]>> {
    match shape {
        PickedShape::Triangles(triangles) => Ok(triangles.clone()),
        PickedShape::Sticks(_) => {
            let remedy = "give a file of surfaces, a grid of heights or points";
            Err(Error::Job(cause(
                place,
                "holds fault sticks and no horizon",
                remedy,
            )))
        }
        shape => {
            let points: Vec<[f64; 3]> = shape.points().collect();
            triangulate_points(&points).map_err(|error| {
                let problem = format!("its {} points span no surface", points.len());
                let remedy = "give at least three points that are not on one line";
                Error::Job(cause(place, problem, remedy).with_source(error))
            })
        }
    }
}

/// Returns a grid of z in a frame, and notes. A grid without a position of its own, and with as many
/// samples as the map, has the position of the map.
fn placed_grid(
    mut image: Image<2>,
    file: GivenFile<'_>,
    frame: &Frame<3>,
    map: &LatticeSpace<2>,
) -> Result<(Horizon, Vec<String>)> {
    let unplaced = Geometry::<2>::default();
    let is_placed =
        (image.geometry.origin, image.geometry.axes) != (unplaced.origin, unplaced.axes);
    if !is_placed && map.fits_dims(image.dims()) {
        image.geometry = map.geometry.clone();
    }
    let [nx, _] = image.dims();
    let geometry = image.geometry.clone();
    let point = |(i, z): (usize, &f32)| {
        let [x, y] = geometry.to_physical(index_at(image.dims(), i).map(|i| i as f64));
        [x, y, f64::from(*z)]
    };
    let points: Vec<[f64; 3]> = image.as_slice().iter().enumerate().map(point).collect();
    let nulls = NullSearch {
        points: &points,
        named: file.options.nulls.as_deref().unwrap_or_default(),
        recognises: file.options.nulls.as_deref() != Some(&[]),
    };
    let neighbours = || {
        let count = points.len() as u32;
        let nx = nx as u32;
        let along_x = (1..count).filter(|i| i % nx > 0).map(|i| [i - 1, i]);
        let pairs: Pairs = along_x.chain((nx..count).map(|i| [i - nx, i])).collect();
        vec![pairs]
    };
    let mut nulls = nulls.find(neighbours);
    // Cells without z are usual in grids.
    nulls.notes.retain(|note| note.contains("common"));
    let known = points.iter().zip(&nulls.flags).filter(|(_, null)| !**null);
    let placing = frame.placing(file, &mut known.map(|(p, _)| *p))?;
    let mut samples = Vec::with_capacity(points.len());
    for (p, null) in points.iter().zip(&nulls.flags) {
        let z = if *null {
            f64::NAN
        } else {
            placing.apply(*p)[2]
        };
        samples.push(z as f32);
    }
    let mut placed = Geometry {
        units: map.geometry.units.clone(),
        ..geometry
    };
    for c in 0..2 {
        let mut unit = [0.0; 3];
        unit[c] = 1.0;
        let factor = placing.apply(unit)[c];
        placed.origin[c] *= factor;
        placed.axes.iter_mut().for_each(|axis| axis[c] *= factor);
    }
    let mut notes = placing.notes.clone();
    notes.append(&mut nulls.notes);
    Ok((
        Horizon::Grid(Image::new(image.dims(), samples, placed)),
        notes,
    ))
}

/// Returns the mean of a horizon's z, if there is any.
fn mean_z(horizon: &Horizon) -> Option<f64> {
    let mean = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = values.fold((0.0, 0usize), |(sum, count), z| (sum + z, count + 1));
        (count > 0).then(|| sum / count as f64)
    };
    match horizon {
        Horizon::Flat(z) => Some(*z),
        Horizon::Grid(image) => {
            let finite = image.as_slice().iter().filter(|z| z.is_finite());
            mean(&mut finite.map(|z| f64::from(*z)))
        }
        Horizon::Surface(triangles) => mean(&mut triangles.corners().map(|p| p[2])),
    }
}

/// Turns the sign of a horizon's z.
fn turn(horizon: &mut Horizon) {
    match horizon {
        Horizon::Flat(z) => *z = -*z,
        Horizon::Grid(image) => image.samples.mapv_inplace(|z| -z),
        Horizon::Surface(triangles) => triangles.turn(),
    }
}
