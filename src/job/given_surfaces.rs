//! Surfaces that the user gives: from files to the samples of the image.

use std::borrow::Cow;
use std::sync::Arc;

use super::Params;
use super::spec::SurfaceOption;
use crate::error::cause;
use crate::feature::{GivenPoints, GivenSurface, MIN_FAULT_DIP};
use crate::geometry::{cross, norm, sub};
use crate::image::Geometry;
use crate::image::time::default_metres_per_unit;
use crate::parallel::prelude::*;
use crate::surface_file::interpretation::{
    PickedShape, PickedSurface, read_interpretation, triangulate_points,
};
use crate::surface_file::joining::join_sticks;
use crate::surface_file::point_table::ReadingFrame;
use crate::{Error, Result};

/// A surface to follow.
#[derive(Debug, Clone, PartialEq)]
pub struct FollowedSurface {
    /// The option that names it, for messages.
    pub option: String,
    /// The surface, in physical coordinates.
    pub surface: PickedSurface,
}

/// Given surfaces in an image.
pub(crate) struct SurfacesInImage<const D: usize> {
    /// Their points.
    pub points: Arc<GivenPoints<D>>,
    /// A note on each.
    pub notes: Vec<String>,
}

/// Number of times that a triangle is divided to find the part of it that lies in the image.
const MAX_DIVISIONS: u32 = 5;

/// Reads the surfaces that the options name. `flag` is the name of the options in messages.
///
/// # Errors
/// Returns the errors of the files, and [`Error::Job`] for a name that its file does not have, or
/// that two surfaces have.
pub(super) fn read(flag: &str, options: &[SurfaceOption]) -> Result<Vec<FollowedSurface>> {
    let mut surfaces: Vec<FollowedSurface> = Vec::new();
    for option in options {
        let place = format!("{flag} {option}");
        let mut picked = read_interpretation(&option.path)?;
        if let Some(name) = &option.name {
            let is_named = |surface: &PickedSurface| surface.name == *name;
            // A command line is easier to write with `_` in place of spaces.
            let is_almost = |surface: &PickedSurface| surface.name.replace(' ', "_") == *name;
            let exact = picked.iter().position(is_named);
            match exact.or_else(|| picked.iter().position(is_almost)) {
                Some(index) => picked = vec![picked.swap_remove(index)],
                None if picked.len() == 1 => picked[0].name.clone_from(name),
                None => {
                    let names: Vec<&str> = picked.iter().map(|s| &*s.name).take(20).collect();
                    let problem = format!("names no surface: the file has {}", names.join(", "));
                    return Err(Error::Job(cause(place, problem, "give one of these names")));
                }
            }
        }
        for mut surface in picked {
            surface.is_horizon = option.is_horizon.or(surface.is_horizon);
            let same_name = surfaces.iter().find(|s| s.surface.name == surface.name);
            if let Some(other) = same_name {
                let problem = format!(
                    "gives {} a second time, after {}",
                    surface.name, other.option
                );
                let remedy = "name the surfaces: FILE:NAME";
                return Err(Error::Job(cause(place, problem, remedy)));
            }
            surfaces.push(FollowedSurface {
                option: place.clone(),
                surface,
            });
        }
    }
    Ok(surfaces)
}

impl<const D: usize> Params<D> {
    /// Returns the given surfaces in an image of `dims` samples; `None` if none are given.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a surface outside the image, and for an image that is not 3-D.
    pub(crate) fn surfaces_in_image(
        &self,
        geometry: &Geometry<D>,
        dims: [usize; D],
    ) -> Result<Option<SurfacesInImage<D>>> {
        if self.surfaces.is_empty() {
            return Ok(None);
        }
        let (mut given, mut notes) = (Vec::new(), Vec::new());
        for given_surface in &self.surfaces {
            let (surface, note) = given_surface.in_image(geometry, dims)?;
            given.push(surface);
            notes.push(note);
        }
        let points = GivenPoints::new(&given, dims);
        for (index, note) in notes.iter_mut().enumerate() {
            let count = points.count(index);
            if count == 0 {
                return Err(outside_error(&self.surfaces[index], geometry, dims));
            }
            *note = format!("{note}, {count} points");
        }
        Ok(Some(SurfacesInImage {
            points: Arc::new(points),
            notes,
        }))
    }
}

impl FollowedSurface {
    /// Returns the surface in sample coordinates, and a note on it.
    fn in_image<const D: usize>(
        &self,
        geometry: &Geometry<D>,
        dims: [usize; D],
    ) -> Result<(GivenSurface<D>, String)> {
        let PickedSurface {
            name, is_horizon, ..
        } = &self.surface;
        if D != 3 {
            let problem = format!("is for 3-D images, but the image has {D} axes");
            return Err(Error::Job(cause(&self.option, problem, "omit it")));
        }
        let resolved = self.with_fitting_reading(geometry, dims)?;
        let this = resolved.as_ref();
        let is_flipped = this.has_opposite_z(geometry, dims);
        let (triangles, note_on_points) = this.triangles(geometry, is_flipped)?;
        let mut note = format!("surface {name}:{note_on_points}");
        let (is_horizon, origin) = match is_horizon {
            Some(is_horizon) => (*is_horizon, String::new()),
            None => {
                let dip = mean_dip(&triangles, geometry);
                let text = format!(" as it dips by {dip:.0} degrees on average");
                (dip < MIN_FAULT_DIP, text)
            }
        };
        note += if is_horizon { " a horizon" } else { " a fault" };
        note += &origin;
        if is_flipped {
            note += ", with the sign of z turned";
        }
        for text in &this.surface.notes {
            note += &format!(", {text}");
        }
        let outside = outside_fraction(&triangles, dims);
        if outside > 5e-4 {
            note += &format!(", {:.1} % of it outside the image", 100.0 * outside);
        }
        let surface = GivenSurface {
            name: name.clone(),
            is_horizon,
            triangles: (triangles.iter())
                .map(|t| std::array::from_fn(|i| std::array::from_fn(|k| t[i][k])))
                .collect(),
        };
        Ok((surface, note))
    }

    /// Returns the surface with the reading of its table that fits an image.
    fn with_fitting_reading<const D: usize>(
        &self,
        geometry: &Geometry<D>,
        dims: [usize; D],
    ) -> Result<Cow<'_, Self>> {
        let PickedShape::Readings(table) = &self.surface.shape else {
            return Ok(Cow::Borrowed(self));
        };
        let is_inside = |p: [f64; D]| {
            let index = geometry.to_index(p);
            index.is_some_and(|index| {
                (0..D).all(|k| (-0.5..=dims[k] as f64 - 0.5).contains(&index[k]))
            })
        };
        let middle = geometry.to_physical(dims.map(|n| 0.5 * (n as f64 - 1.0)));
        let spacing = geometry.spacing();
        let frame = ReadingFrame {
            contains: &|p| {
                [1.0, -1.0]
                    .iter()
                    .any(|&sign| is_inside(with_z_sign(p, sign)))
            },
            contains_in_plane: &|[x, y]| {
                is_inside(std::array::from_fn(|k| {
                    [x, y].get(k).copied().unwrap_or(middle[k])
                }))
            },
            spacing: std::array::from_fn(|k| spacing.get(k).copied().unwrap_or(1.0)),
            domain: None,
        };
        let fitting = table.fit(&self.option, &frame)?;
        let mut resolved = self.clone();
        resolved.surface.shape = PickedShape::Points(fitting.points);
        resolved.surface.coordinates = fitting.coordinates;
        resolved.surface.notes.push(fitting.note);
        Ok(Cow::Owned(resolved))
    }

    /// Returns `true` if the surface lies in the image only with the opposite sign of z. Programs
    /// differ in the sign of depths and times.
    fn has_opposite_z<const D: usize>(&self, geometry: &Geometry<D>, dims: [usize; D]) -> bool {
        let is_inside = |p: [f64; D]| {
            geometry.to_index(p).is_some_and(|index| {
                (0..D).all(|k| (-0.5..=dims[k] as f64 - 0.5).contains(&index[k]))
            })
        };
        let is_anywhere = |sign| {
            let mut points = self.surface.shape.points();
            points.any(|p| is_inside(with_z_sign(p, sign)))
        };
        !is_anywhere(1.0) && is_anywhere(-1.0)
    }

    /// Returns the surface's triangles in sample coordinates, and a note on points that are joined.
    pub(super) fn triangles<const D: usize>(
        &self,
        geometry: &Geometry<D>,
        is_flipped: bool,
    ) -> Result<(Vec<[[f64; 3]; 3]>, String)> {
        let sign = if is_flipped { -1.0 } else { 1.0 };
        let index = |p: [f64; 3]| -> Result<[f64; 3]> {
            let index = geometry.to_index(with_z_sign(p, sign)).ok_or_else(|| {
                let problem = "cannot be placed: the image's axes are linearly dependent";
                Error::Job(cause(&self.option, problem, "correct the image's geometry"))
            })?;
            Ok(std::array::from_fn(|k| {
                index.get(k).copied().unwrap_or(0.0)
            }))
        };
        match &self.surface.shape {
            PickedShape::Triangles(triangles) => {
                let triangles = (triangles.iter())
                    .map(|t| Ok([index(t[0])?, index(t[1])?, index(t[2])?]))
                    .collect::<Result<_>>()?;
                Ok((triangles, String::new()))
            }
            PickedShape::Sticks(sticks) => {
                let units: [&str; 3] =
                    std::array::from_fn(|k| geometry.units.get(k).map_or("", |unit| unit));
                let scale = units.map(default_metres_per_unit);
                let joined = join_sticks(&self.surface.name, sticks, scale)?;
                let triangles = (joined.triangles.iter())
                    .map(|t| Ok([index(t[0])?, index(t[1])?, index(t[2])?]))
                    .collect::<Result<_>>()?;
                let notes = joined.notes.iter().map(|note| format!(" {note},"));
                Ok((triangles, notes.collect()))
            }
            shape => {
                let points = shape.points().map(index).collect::<Result<Vec<_>>>()?;
                let triangles = triangulate_points(&points).map_err(|error| {
                    let problem = format!("its {} points span no surface", points.len());
                    let remedy = "give at least three points that are not on one line";
                    Error::Job(cause(&self.option, problem, remedy).with_source(error))
                })?;
                let note = format!(
                    " {} points joined in their best-fitting plane,",
                    points.len()
                );
                Ok((triangles, note))
            }
        }
    }
}

/// Returns a point with its z multiplied by a sign.
fn with_z_sign<const D: usize>(p: [f64; 3], sign: f64) -> [f64; D] {
    std::array::from_fn(|k| if k == 2 { sign * p[k] } else { p[k] })
}

/// Returns the fraction of the area of triangles that lies outside an image of `dims` samples.
fn outside_fraction<const D: usize>(triangles: &[[[f64; 3]; 3]], dims: [usize; D]) -> f64 {
    let last = dims.map(|n| n as f64 - 1.0);
    let last: [f64; 3] = std::array::from_fn(|k| last.get(k).copied().unwrap_or(0.0));
    let areas: Vec<[f64; 2]> = (triangles.par_iter())
        .map(|t| [inside_area(t, last, MAX_DIVISIONS), area(t)])
        .collect();
    let [inside, total] = areas
        .iter()
        .fold([0.0; 2], |sum, a| [sum[0] + a[0], sum[1] + a[1]]);
    1.0 - inside / total.max(f64::MIN_POSITIVE)
}

/// Returns the area of a triangle.
fn area(t: &[[f64; 3]; 3]) -> f64 {
    0.5 * norm(cross(sub(t[1], t[0]), sub(t[2], t[0])))
}

/// Returns the area of the part of a triangle that lies in the box `[0, last]`. A triangle on the
/// side of the box is divided up to `divisions` times.
fn inside_area(t: &[[f64; 3]; 3], last: [f64; 3], divisions: u32) -> f64 {
    const ROUNDING: f64 = 1e-6;
    let is_inside = |p: &[f64; 3]| (0..3).all(|k| (-ROUNDING..=last[k] + ROUNDING).contains(&p[k]));
    if t.iter().all(is_inside) {
        return area(t);
    }
    let is_beyond = |k: usize| t.iter().all(|p| p[k] < 0.0) || t.iter().all(|p| p[k] > last[k]);
    if (0..3).any(is_beyond) {
        return 0.0;
    }
    let middle =
        |a: usize, b: usize| -> [f64; 3] { std::array::from_fn(|k| 0.5 * (t[a][k] + t[b][k])) };
    if divisions == 0 {
        let centre = std::array::from_fn(|k| (t[0][k] + t[1][k] + t[2][k]) / 3.0);
        return if is_inside(&centre) { area(t) } else { 0.0 };
    }
    let [p, q, r] = [middle(0, 1), middle(1, 2), middle(2, 0)];
    [[t[0], p, r], [p, t[1], q], [r, q, t[2]], [p, q, r]]
        .iter()
        .map(|part| inside_area(part, last, divisions - 1))
        .sum()
}

/// Returns the mean dip of triangles in physical space, in degrees. Two-way time counts at 2,000
/// m/s.
fn mean_dip<const D: usize>(triangles: &[[[f64; 3]; 3]], geometry: &Geometry<D>) -> f64 {
    let factors = geometry
        .units
        .each_ref()
        .map(|unit| default_metres_per_unit(unit));
    let (mut upright, mut total) = (0.0, 0.0);
    for t in triangles {
        let world = t.map(|p| {
            let index = std::array::from_fn(|k| p.get(k).copied().unwrap_or(0.0));
            let x: [f64; D] = geometry.to_physical(index);
            std::array::from_fn::<f64, 3, _>(|k| {
                x.get(k).copied().unwrap_or(0.0) * factors.get(k).copied().unwrap_or(1.0)
            })
        });
        let n = cross(sub(world[1], world[0]), sub(world[2], world[0]));
        let length = norm(n);
        if length > 0.0 {
            total += length;
            upright += length * (n[2].abs() / length).min(1.0).acos();
        }
    }
    (upright / f64::max(total, f64::MIN_POSITIVE)).to_degrees()
}

/// Returns the error of a surface outside the image.
fn outside_error<const D: usize>(
    given_surface: &FollowedSurface,
    geometry: &Geometry<D>,
    dims: [usize; D],
) -> Error {
    let corner_ranges = (0..1usize << D).map(|corner| {
        geometry.to_physical(std::array::from_fn(|k| {
            if corner >> k & 1 == 1 {
                dims[k] as f64 - 1.0
            } else {
                0.0
            }
        }))
    });
    let ranges = |points: &mut dyn Iterator<Item = Vec<f64>>| {
        let points: Vec<Vec<f64>> = points.collect();
        let range = |(k, name): (usize, &str)| {
            let values = points.iter().map(|p| p[k]);
            let low = values.clone().fold(f64::INFINITY, f64::min);
            let high = values.fold(f64::NEG_INFINITY, f64::max);
            format!("{name} {low} to {high}")
        };
        let names = ["x", "y", "z"];
        names
            .into_iter()
            .enumerate()
            .map(range)
            .collect::<Vec<_>>()
            .join(", ")
    };
    let surface = ranges(&mut given_surface.surface.shape.points().map(|p| p.to_vec()));
    let image = ranges(&mut corner_ranges.map(|p| p.to_vec()));
    Error::Job(cause(
        &given_surface.option,
        format!(
            "{} lies outside the image: it has {surface}, the image {image}",
            given_surface.surface.name
        ),
        "give the image's physical coordinates, which `atomesh info` shows",
    ))
}
