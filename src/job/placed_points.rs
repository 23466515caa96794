//! Wells and fixed atoms in the frame of the image.

use std::borrow::Cow;

use super::{FixedAtom, Params, WellPath};
use crate::Result;
use crate::error::{Error, cause};
use crate::geometry::spread::along_path;
use crate::geometry::to_3d;
use crate::image::Geometry;
use crate::image::placing::{Frame, GivenFile, MAX_TESTED_POINTS};
use crate::image::point_nulls::{NullSearch, consecutive_pairs};
use crate::image::stated::{CoordinateOptions, StatedCoordinates};
use crate::units::{self, Quantity, Unit};
use crate::well_file::SurveyOffsets;

/// A file of points: what it and its option say about its coordinates.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointFile {
    /// The option that names the file, for messages.
    pub place: String,
    /// The statements of the file.
    pub stated: StatedCoordinates,
    /// The statements of the option.
    pub options: CoordinateOptions,
    /// Notes on assumptions when the file was read.
    pub notes: Vec<String>,
    /// The wellhead of a deviation survey whose offsets may have another unit than the wellhead.
    pub survey: Option<SurveyOffsets>,
}

/// Points of a file in the frame of an image.
struct PlacedPoints<const D: usize> {
    /// The index of each point that is left, and its position.
    points: Vec<(usize, [f64; D])>,
    /// The factor of lengths along x.
    scale: f64,
    /// The share of the points, or of the path, in the image.
    share: f64,
    /// A note, if coordinates changed.
    note: Option<String>,
}

impl PointFile {
    /// Returns points of a deviation survey with offsets from the wellhead in the units of coordinates, and
    /// other points as they are. Measured depths without a unit have that of z.
    fn with_converted_offsets<const D: usize>(
        &self,
        points: &[[f64; D]],
        frame: &Frame<D>,
    ) -> Vec<[f64; D]> {
        let Some(survey) = &self.survey else {
            return points.to_vec();
        };
        let length = |unit: Option<Unit>| unit.filter(|unit| unit.quantity == Quantity::Length);
        let coordinate = |k: usize| {
            let by_file = self.stated.units[k].as_deref();
            let given = self.options.unit(k).or(by_file).and_then(units::find);
            length(given.or_else(|| frame.unit(k)))
        };
        let measured = survey.unit.as_deref().and_then(units::find);
        let measured = length(measured).or_else(|| coordinate(D - 1));
        let factor = |k: usize| match (measured, coordinate(k)) {
            (Some(from), Some(to)) if from != to => from.size / to.size,
            _ => 1.0,
        };
        let factors = std::array::from_fn(factor);
        (points.iter())
            .map(|point| survey.converted(*point, factors))
            .collect()
    }

    /// Returns points of the file in the frame of an image. If `is_path`, lines join them. A wellhead that
    /// the option gives is in the unit of measured depths if the well lies in the image only so.
    fn placed<const D: usize>(
        &self,
        points: &[[f64; D]],
        is_path: bool,
        frame: &Frame<D>,
    ) -> Result<PlacedPoints<D>> {
        let converted = self.with_converted_offsets(points, frame);
        let placed = self.placed_as(&self.stated, &converted, is_path, frame)?;
        let unit = self.survey.as_ref().and_then(|survey| survey.unit.clone());
        let Some(unit) = unit.filter(|_| placed.share == 0.0) else {
            return Ok(placed);
        };
        let stated = StatedCoordinates {
            units: std::array::from_fn(|_| Some(unit.clone())),
            ..self.stated.clone()
        };
        let all_in_unit = self.placed_as(&stated, points, is_path, frame)?;
        Ok(if all_in_unit.share > 0.0 {
            all_in_unit
        } else {
            placed
        })
    }

    /// Returns points of the file, about which `stated` is said, in the frame of an image.
    fn placed_as<const D: usize>(
        &self,
        stated: &StatedCoordinates,
        points: &[[f64; D]],
        is_path: bool,
        frame: &Frame<D>,
    ) -> Result<PlacedPoints<D>> {
        let named: Vec<f64> = (self.stated.nulls.iter())
            .chain(self.options.nulls.iter().flatten())
            .copied()
            .collect();
        let in_space: Vec<[f64; 3]> = points.iter().map(|p| to_3d(*p)).collect();
        let nulls = NullSearch {
            points: &in_space,
            named: &named,
            recognises: D == 3 && self.options.nulls.as_deref() != Some(&[]),
        }
        .find(|| vec![consecutive_pairs(0, points.len())]);
        let known: Vec<usize> = (0..points.len()).filter(|&i| !nulls.flags[i]).collect();
        if known.is_empty() {
            let problem = format!("has no point: {}", nulls.notes.join(", "));
            let remedy = "export it again, or keep all values: ,null=none";
            return Err(Error::Job(cause(&self.place, problem, remedy)));
        }
        let file = GivenFile {
            place: &self.place,
            stated,
            options: &self.options,
        };
        let mut tested: Vec<[f64; D]> = known.iter().map(|&i| points[i]).collect();
        if is_path {
            tested = along_path(&tested, MAX_TESTED_POINTS);
        }
        let placing = frame.placing(file, &mut tested.into_iter())?;
        let mut texts = self.notes.clone();
        if !placing.is_identity() {
            texts.extend(placing.notes.iter().cloned());
        }
        texts.extend(nulls.notes);
        Ok(PlacedPoints {
            points: known
                .iter()
                .map(|&i| (i, placing.apply(points[i])))
                .collect(),
            scale: placing.length(1.0),
            share: placing.share,
            note: (!texts.is_empty()).then(|| format!("{}: {}", self.place, texts.join(", "))),
        })
    }
}

impl<const D: usize> Params<D> {
    /// Returns the parameters with wells and fixed atoms in the frame of an image of `dims` samples,
    /// and notes on those whose coordinates changed.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for coordinates that do not suit the image.
    pub(super) fn with_points_in(
        &self,
        geometry: &Geometry<D>,
        dims: [usize; D],
    ) -> Result<(Cow<'_, Self>, Vec<String>)> {
        if self.fixed_atoms.is_empty() && self.wells.is_empty() {
            return Ok((Cow::Borrowed(self), Vec::new()));
        }
        let frame = self.frame(geometry, dims);
        let (mut params, mut notes) = (self.clone(), Vec::new());
        if !self.fixed_atoms.is_empty() {
            let positions: Vec<[f64; D]> = self.fixed_atoms.iter().map(|a| a.position).collect();
            let placed = self.atom_file.placed(&positions, false, &frame)?;
            notes.extend(placed.note);
            let atom = |(i, position): (usize, [f64; D])| FixedAtom {
                name: self.fixed_atoms[i].name.clone(),
                position,
            };
            params.fixed_atoms = placed.points.into_iter().map(atom).collect();
        }
        for well in &mut params.wells {
            let placed = well.file.placed(&well.points, true, &frame)?;
            notes.extend(placed.note);
            *well = WellPath {
                points: placed.points.into_iter().map(|(_, point)| point).collect(),
                radius: well.radius * placed.scale,
                ..well.clone()
            };
        }
        Ok((Cow::Owned(params), notes))
    }
}
