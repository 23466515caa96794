//! Surfaces that the user gives: from files to the samples of the image.

use std::sync::Arc;

use super::Params;
use super::extended_surfaces::continue_faults;
use super::spec::{FileOption, NumberOrFile};
use crate::error::cause;
use crate::feature::{GivenPoints, GivenSurface, MIN_FAULT_DIP};
use crate::geometry::{cross, norm, sub};
use crate::image::Geometry;
use crate::image::placing::{Frame, TimeToDepth};
use crate::image::stated::CoordinateOptions;
use crate::image::time::default_metres_per_unit;
use crate::parallel::prelude::*;
use crate::surface_file::interpretation::{
    PickedShape, PickedSurface, read_interpretation_as, triangulate_points,
};
use crate::surface_file::joining::join_sticks;
use crate::surface_file::placed::PlacedSurface;
use crate::{Error, Result};

/// A surface to follow.
#[derive(Debug, Clone, PartialEq)]
pub struct FollowedSurface {
    /// The option that names it, for messages.
    pub option: String,
    /// The statements of the option about its coordinates.
    pub coordinates: CoordinateOptions,
    /// The surface, in the coordinates of its file.
    pub surface: PickedSurface,
    /// The options that give the surface again, and its names there.
    pub duplicates: Vec<String>,
}

/// Given surfaces in an image.
pub(crate) struct SurfacesInImage<const D: usize> {
    /// Their points.
    pub points: Arc<GivenPoints<D>>,
    /// Notes on each.
    pub notes: Vec<String>,
    /// The name of each, and the fraction of its area outside the image.
    pub outside: Vec<(String, f64)>,
}

/// Number of times that a triangle is divided to find the part of it that lies in the image.
const MAX_DIVISIONS: u32 = 5;

/// Share of a surface outside the image from which a note gives the ranges of both.
const MAX_OUTSIDE_SHARE: f64 = 0.5;

/// Reads the surfaces that the options name. `flag` is the name of the options in messages, and
/// `nulls` are the null values of all files.
///
/// # Errors
/// Returns the errors of the files, and [`Error::Job`] for a name that its file does not have, or
/// that two surfaces have.
pub(crate) fn read(
    flag: &str,
    options: &[FileOption],
    nulls: Option<&[f64]>,
) -> Result<Vec<FollowedSurface>> {
    let mut surfaces: Vec<FollowedSurface> = Vec::new();
    for option in options {
        let place = format!("{flag} {option}");
        let mut picked = read_interpretation_as(&option.path, &option.coordinates.columns)?;
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
            let known = surfaces
                .iter_mut()
                .find(|s| s.surface.is_duplicate(&surface));
            if let Some(known) = known {
                known
                    .duplicates
                    .push(format!("{} of {place}", surface.name));
                continue;
            }
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
                coordinates: option.coordinates.with_nulls(nulls.map(<[f64]>::to_vec)),
                surface,
                duplicates: Vec::new(),
            });
        }
    }
    Ok(surfaces)
}

impl<const D: usize> Params<D> {
    /// Returns the frame of an image of `dims` samples, into which the positions that the user gives
    /// are brought.
    pub(crate) fn frame(&self, geometry: &Geometry<D>, dims: [usize; D]) -> Frame<D> {
        let constant = match self.spec.velocity {
            Some(NumberOrFile::Constant(velocity)) => Some(TimeToDepth::Constant(velocity)),
            _ => None,
        };
        let model = (self.velocities.clone()).map(|model| TimeToDepth::Model(Box::new(model)));
        Frame::new(geometry, dims).with_time_to_depth(model.or(constant), self.time_unit.as_deref())
    }

    /// Returns the distance, in the unit of the metric, up to which given faults are continued to what
    /// they end near.
    fn extension_of_faults(&self) -> f64 {
        let given = self.spec.extend_faults.map(|length| length.value);
        given.unwrap_or_else(|| self.spacing().max())
    }

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
        let frame = self.frame(geometry, dims);
        let found: Vec<SurfaceInImage<D>> = (self.surfaces.iter())
            .map(|surface| surface.in_image(&frame, geometry, dims))
            .collect::<Result<_>>()?;
        let mut given: Vec<GivenSurface<D>> = found.iter().map(|s| s.surface.clone()).collect();
        let lengths = self.spec.metric.lengths(geometry);
        let continued = continue_faults(&mut given, dims, lengths, self.extension_of_faults());
        let points = GivenPoints::new(&given, dims);
        let mut notes = Vec::new();
        for (index, (found, option)) in found.iter().zip(&self.surfaces).enumerate() {
            let count = points.count(index);
            let problem = || option.outside_problem(&found.placed, &frame);
            if count == 0 {
                let remedy = "give coordinates of the image, which `atomesh info` shows, or say how they differ: \
                              ,unit=ft ,z=down ,domain=time";
                return Err(Error::Job(cause(&option.option, problem(), remedy)));
            }
            notes.push(format!("{}, {count} points", found.note));
            if found.outside > MAX_OUTSIDE_SHARE {
                notes.push(format!(
                    "warning: {:.0} % of surface {}",
                    100.0 * found.outside,
                    problem()
                ));
            }
        }
        notes.extend(continued.iter().map(|continued| {
            format!(
                "surface {} ends up to {:.1} samples from {}, and is continued to there (--extend-faults 0 leaves it as it is)",
                given[continued.index].name,
                continued.longest / lengths[0],
                continued.targets.join(" and ")
            )
        }));
        Ok(Some(SurfacesInImage {
            points: Arc::new(points),
            notes,
            outside: (found.iter())
                .map(|found| (found.surface.name.clone(), found.outside))
                .collect(),
        }))
    }
}

/// A given surface in an image.
struct SurfaceInImage<const D: usize> {
    /// The surface in physical coordinates.
    placed: PlacedSurface,
    /// The surface in sample coordinates.
    surface: GivenSurface<D>,
    /// The share of its area outside the image.
    outside: f64,
    note: String,
}

impl FollowedSurface {
    /// Returns the surface in the physical coordinates of an image.
    ///
    /// # Errors
    /// Returns the errors of [`PickedSurface::placed`].
    pub(crate) fn placed<const D: usize>(&self, frame: &Frame<D>) -> Result<PlacedSurface> {
        self.surface.placed(frame, &self.option, &self.coordinates)
    }

    /// Returns the surface in an image, and a note on it.
    fn in_image<const D: usize>(
        &self,
        frame: &Frame<D>,
        geometry: &Geometry<D>,
        dims: [usize; D],
    ) -> Result<SurfaceInImage<D>> {
        let PickedSurface {
            name, is_horizon, ..
        } = &self.surface;
        if D != 3 {
            let problem = format!("is for 3-D images, but the image has {D} axes");
            return Err(Error::Job(cause(&self.option, problem, "omit it")));
        }
        let placed = self.placed(frame)?;
        let (triangles, note_on_points) = self.triangles(&placed.shape, geometry)?;
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
        for duplicate in &self.duplicates {
            note += &format!(", the same as {duplicate}");
        }
        for text in &placed.notes {
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
        Ok(SurfaceInImage {
            placed,
            surface,
            outside,
            note,
        })
    }

    /// Returns a shape's triangles in sample coordinates, and a note on points that are joined.
    pub(super) fn triangles<const D: usize>(
        &self,
        shape: &PickedShape,
        geometry: &Geometry<D>,
    ) -> Result<(Vec<[[f64; 3]; 3]>, String)> {
        let index = |p: [f64; 3]| -> Result<[f64; 3]> {
            let index = geometry
                .to_index(std::array::from_fn(|k| p[k]))
                .ok_or_else(|| {
                    let problem = "cannot be placed: the image's axes are linearly dependent";
                    Error::Job(cause(&self.option, problem, "correct the image's geometry"))
                })?;
            Ok(std::array::from_fn(|k| {
                index.get(k).copied().unwrap_or(0.0)
            }))
        };
        match shape {
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

    /// Returns that the surface lies outside the image, with the ranges of both.
    fn outside_problem<const D: usize>(&self, placed: &PlacedSurface, frame: &Frame<D>) -> String {
        let notes = match placed.notes.join(", ") {
            notes if notes.is_empty() => notes,
            notes => format!(" ({notes})"),
        };
        format!(
            "{} lies outside the image: it has {}{notes}, the image {}",
            self.surface.name,
            frame.ranges_of(placed.shape.points()),
            frame.ranges()
        )
    }
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
