//! The one place that brings positions which a user gives into the frame of an image: their units,
//! the sign of z, and two-way time.
//!
//! The statements of the file count, and those of the option replace them. The image gives what both
//! leave out:
//!
//! - units: those of the image. If the image was converted from two-way time to depth, z without a
//!   unit is two-way time, as in the image's file, unless clearly more of the points lie in the image
//!   if z is depth.
//! - direction of z: the one with which more of the points lie in the image, or else that of the
//!   image. What a file says is not followed if hardly any point lies in the image then, but many
//!   do with the opposite sign.
//!
//! [`Placing::notes`] say what was read, assumed and turned.

use super::Geometry;
use super::stated::{CoordinateOptions, Domain, StatedCoordinates, ZDirection};
use super::velocity::VelocityModel;
use crate::error::cause;
use crate::units::{self, Quantity, Unit};
use crate::{Error, Result};

/// Largest number of points that choose between the readings of a file.
pub(crate) const MAX_TESTED_POINTS: usize = 4000;

/// Smallest share of the points in the image, with the opposite sign of z, that refutes a file.
const REFUTING_SHARE: f64 = 0.25;

/// Smallest ratio of the shares, with the opposite and with the stated sign of z, that refutes a file.
const REFUTING_RATIO: f64 = 4.0;

/// Difference between shares of points in the image that counts.
const SHARE_MARGIN: f64 = 0.05;

/// Names that programs write in place of a unit where there is none.
const NO_UNITS: [&str; 7] = ["", "unitless", "none", "unknown", "undefined", "1", "-"];

/// Conversion of two-way time to depth, as the image was converted.
#[derive(Debug, Clone, PartialEq)]
pub enum TimeToDepth<const D: usize> {
    /// One velocity, in m/s.
    Constant(f64),
    /// A volume of velocities.
    Model(Box<VelocityModel<D>>),
}

/// Part of space in which positions are expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Region {
    /// The box of the image.
    Inside,
    /// Above the image.
    Above,
    /// Above, in or below a map, whose z does not matter.
    Column,
}

/// The frame of an image: its physical coordinates, of which the last is vertical.
#[derive(Debug, Clone)]
pub struct Frame<const D: usize> {
    geometry: Geometry<D>,
    /// Index of the last sample along each axis.
    last: [f64; D],
    direction: Option<ZDirection>,
    region: Region,
    /// The conversion of the image to depth, and the unit of time in its file.
    time_to_depth: Option<(TimeToDepth<D>, Unit)>,
}

/// A file of positions: what it and its option say about them.
#[derive(Debug, Clone, Copy)]
pub struct GivenFile<'a> {
    /// The option with the file, for messages.
    pub place: &'a str,
    /// The statements of the file.
    pub stated: &'a StatedCoordinates,
    /// The statements of the option.
    pub options: &'a CoordinateOptions,
}

/// Meaning of z.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Vertical {
    /// z times a factor.
    Scaled(f64),
    /// Two-way time, converted to depth. The number has the seconds in its unit.
    TwoWayTime(f64),
}

/// A way in which positions can be read.
#[derive(Debug, Clone, PartialEq)]
struct Reading<const D: usize> {
    /// Factors of the horizontal coordinates. The last is not used.
    factors: [f64; D],
    vertical: Vertical,
    /// Notes on the units.
    notes: Vec<String>,
}

/// The map from the positions of a file to the frame of an image.
#[derive(Debug, Clone)]
pub struct Placing<'a, const D: usize> {
    frame: &'a Frame<D>,
    reading: Reading<D>,
    /// 1, or -1 if the sign of z is turned.
    sign: f64,
    /// The share of the points that lies in the image.
    pub share: f64,
    /// Parts of sentences on what was read, assumed and turned.
    pub notes: Vec<String>,
}

impl<const D: usize> Frame<D> {
    /// Creates the frame of an image of `dims` samples.
    pub fn new(geometry: &Geometry<D>, dims: [usize; D]) -> Self {
        Self {
            direction: geometry.z_direction(),
            geometry: geometry.clone(),
            last: dims.map(|n| n.max(1) as f64 - 1.0),
            region: Region::Inside,
            time_to_depth: None,
        }
    }

    /// Returns the frame for positions in another region.
    #[must_use]
    pub fn in_region(self, region: Region) -> Self {
        Self { region, ..self }
    }

    /// Returns the frame of an image that was converted from two-way time in `unit`. An image that is
    /// in two-way time itself needs no conversion.
    #[must_use]
    pub fn with_time_to_depth(
        self,
        conversion: Option<TimeToDepth<D>>,
        unit: Option<&str>,
    ) -> Self {
        let is_time = self
            .unit(D - 1)
            .is_some_and(|unit| unit.quantity == Quantity::Time);
        let millisecond = Unit {
            symbol: "ms",
            quantity: Quantity::Time,
            size: 1e-3,
        };
        let unit = unit
            .and_then(units::find)
            .filter(|unit| unit.quantity == Quantity::Time);
        let conversion = conversion.filter(|_| !is_time);
        Self {
            time_to_depth: conversion.map(|conversion| (conversion, unit.unwrap_or(millisecond))),
            ..self
        }
    }

    /// Returns the frame with this direction of z.
    #[must_use]
    pub fn with_direction(self, direction: Option<ZDirection>) -> Self {
        Self { direction, ..self }
    }

    /// Returns the unit of a coordinate, if it is known.
    pub(crate) fn unit(&self, coordinate: usize) -> Option<Unit> {
        units::find(&self.geometry.units[coordinate])
    }

    /// Returns `true` if a position lies where it is expected.
    pub fn contains(&self, position: [f64; D]) -> bool {
        let Some(index) = self.geometry.to_index(position) else {
            return false;
        };
        let vertical = (0..D).find(|&k| self.geometry.main_coordinate(k) == D - 1);
        (0..D).all(|k| {
            let is_within = (-0.5..=self.last[k] + 0.5).contains(&index[k]);
            match self.region {
                Region::Inside => is_within,
                _ if vertical != Some(k) => is_within,
                Region::Column => true,
                Region::Above => {
                    let falls = self.geometry.axes[k][D - 1] < 0.0;
                    if falls || self.geometry.points_down() {
                        index[k] <= 0.0
                    } else {
                        index[k] >= self.last[k]
                    }
                }
            }
        })
    }

    /// Returns a test of whether a position of a file lies in the image, in any of the ways in which
    /// the file can be read.
    ///
    /// # Errors
    /// Returns the errors of [`Frame::placing`].
    pub fn membership(&self, file: GivenFile<'_>) -> Result<impl Fn([f64; D]) -> bool + '_> {
        let placing = |reading: Reading<D>, sign: f64| Placing {
            frame: self,
            reading,
            sign,
            share: 0.0,
            notes: Vec::new(),
        };
        let readings = self.readings(file)?.into_iter();
        let placings: Vec<Placing<'_, D>> = readings
            .flat_map(|reading| [placing(reading.clone(), 1.0), placing(reading, -1.0)])
            .collect();
        Ok(move |p| {
            placings
                .iter()
                .any(|placing| self.contains(placing.apply(p)))
        })
    }

    /// Returns the middle of the image.
    pub fn middle(&self) -> [f64; D] {
        self.geometry.to_physical(self.last.map(|last| 0.5 * last))
    }

    /// Returns the distances between samples along the axes of the image.
    pub fn spacing(&self) -> [f64; D] {
        self.geometry.spacing()
    }

    /// Returns the domain of z, if the image has one alone.
    pub fn domain(&self) -> Option<Domain> {
        if self.time_to_depth.is_some() {
            return None;
        }
        self.unit(D - 1).map(|unit| match unit.quantity {
            Quantity::Time => Domain::Time,
            Quantity::Length => Domain::Depth,
        })
    }

    /// Returns the map from the positions of a file to this frame.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for units that are not known or do not suit the image, and for
    /// statements that contradict one another.
    pub fn placing(
        &self,
        file: GivenFile<'_>,
        points: &mut dyn Iterator<Item = [f64; D]>,
    ) -> Result<Placing<'_, D>> {
        let readings = self.readings(file)?;
        let points: Vec<[f64; D]> = points.collect();
        let step = points.len().div_ceil(MAX_TESTED_POINTS).max(1);
        let tested: Vec<[f64; D]> = points.into_iter().step_by(step).collect();
        let placings: Vec<Placing<'_, D>> = (readings.into_iter())
            .map(|reading| self.with_sign(reading, file, &tested))
            .collect();
        let best = placings.iter().map(|p| p.share).fold(0.0, f64::max);
        let chosen = placings
            .into_iter()
            .find(|p| p.share >= best - SHARE_MARGIN);
        chosen.ok_or_else(|| {
            let problem = "cannot be placed in the image";
            Error::Job(cause(file.place, problem, "give coordinates of the image"))
        })
    }

    /// Returns the placing of a reading with the sign of z that the statements and the points
    /// determine.
    fn with_sign(
        &self,
        reading: Reading<D>,
        file: GivenFile<'_>,
        points: &[[f64; D]],
    ) -> Placing<'_, D> {
        let mut placing = Placing {
            frame: self,
            notes: reading.notes.clone(),
            reading,
            sign: 1.0,
            share: 0.0,
        };
        let mut share = |sign: f64| {
            placing.sign = sign;
            let count = points
                .iter()
                .filter(|p| self.contains(placing.apply(**p)))
                .count();
            count as f64 / points.len().max(1) as f64
        };
        let [as_given, turned] = [share(1.0), share(-1.0)];
        let share = |sign: f64| if sign > 0.0 { as_given } else { turned };
        let by_option = file.options.z_direction;
        let stated = by_option.or(file.stated.z_direction);
        // In the plane, the last coordinate need not be vertical.
        let stated = stated.filter(|_| D == 3);
        let sign = match (stated, self.direction) {
            (Some(file), Some(image)) if file == image => 1.0,
            (Some(_), Some(_)) => -1.0,
            _ if turned > as_given && D == 3 => -1.0,
            // A surface above the image lies above it with both signs if z is far from 0.
            _ if self.region == Region::Above && turned == as_given && D == 3 => {
                placing.nearer_sign(points)
            }
            _ => 1.0,
        };
        let is_refuted = by_option.is_none()
            && share(-sign) >= REFUTING_SHARE.max(REFUTING_RATIO * share(sign))
            && D == 3;
        let sign = if is_refuted { -sign } else { sign };
        placing.sign = sign;
        placing.share = share(sign);
        placing
            .notes
            .extend(sign_note(sign, stated, self, is_refuted, file));
        placing
    }

    /// Returns the ways in which the positions of a file can be read, the first one preferred.
    fn readings(&self, file: GivenFile<'_>) -> Result<Vec<Reading<D>>> {
        let mut notes = Vec::new();
        let mut stated = [None; 3];
        for (k, unit) in stated.iter_mut().enumerate() {
            *unit = stated_unit(file, k, &mut notes)?;
        }
        let mut factors = [1.0; D];
        for k in 0..D - 1 {
            factors[k] = self.horizontal_factor(file, k, stated[k], &mut notes)?;
        }
        let verticals = if D == 3 {
            self.vertical_readings(file, stated[2])?
        } else {
            let factor = self.horizontal_factor(file, D - 1, stated[D - 1], &mut notes)?;
            vec![(Vertical::Scaled(factor), String::new())]
        };
        let mut readings: Vec<Reading<D>> = (verticals.into_iter())
            .map(|(vertical, note)| Reading {
                factors,
                vertical,
                notes: notes
                    .iter()
                    .cloned()
                    .chain(Some(note))
                    .filter(|n| !n.is_empty())
                    .collect(),
            })
            .collect();
        // A unit of z may be that of x and y, too.
        let given = file.options.unit(2).and_then(units::find);
        let has_own_unit = (0..2).any(|k| stated[k].is_some());
        if let (Some(unit), Some(image), false) = (given, self.unit(0), has_own_unit)
            && unit.quantity == Quantity::Length
            && image.quantity == Quantity::Length
            && unit.size != image.size
        {
            let mut all = readings[0].clone();
            all.factors = [unit.size / image.size; D];
            all.notes
                .insert(0, format!("x and y in {}, too, as z", unit.symbol));
            readings.push(all);
        }
        Ok(readings)
    }

    /// Returns the factor of a horizontal coordinate.
    fn horizontal_factor(
        &self,
        file: GivenFile<'_>,
        k: usize,
        stated: Option<Unit>,
        notes: &mut Vec<String>,
    ) -> Result<f64> {
        let name = ["x", "y", "z"][k];
        match (stated, self.unit(k)) {
            (Some(unit), Some(image)) if unit.quantity == image.quantity => {
                if unit.size != image.size {
                    let [from, to] = [unit.symbol, image.symbol];
                    notes.push(format!("{name} in {from}, converted to {to}"));
                }
                Ok(unit.size / image.size)
            }
            (Some(unit), Some(image)) => {
                let problem = format!(
                    "has {name} in {}, but the image in {}",
                    unit.symbol, image.symbol
                );
                let remedy = format!(
                    "give {name} in {}, or say its unit: ,unit=X,Y,Z",
                    image.symbol
                );
                Err(Error::Job(cause(file.place, problem, remedy)))
            }
            _ => Ok(1.0),
        }
    }

    /// Returns the meanings that z can have, each with a note.
    fn vertical_readings(
        &self,
        file: GivenFile<'_>,
        unit: Option<Unit>,
    ) -> Result<Vec<(Vertical, String)>> {
        let refuse =
            |problem: String, remedy: String| Err(Error::Job(cause(file.place, problem, remedy)));
        let domain = stated_domain(file, unit)?;
        let image = self.unit(2);
        let image_domain = image.map(|unit| match unit.quantity {
            Quantity::Time => Domain::Time,
            Quantity::Length => Domain::Depth,
        });
        let image_name = image.map_or("", |unit| unit.symbol);
        match (unit, domain, image_domain) {
            (Some(unit), Some(domain), Some(other)) if domain == other => {
                let factor = unit.size / image.map_or(1.0, |image| image.size);
                let note = if unit.symbol == image_name {
                    format!("z in {image_name}")
                } else {
                    format!("z in {}, converted to {image_name}", unit.symbol)
                };
                Ok(vec![(Vertical::Scaled(factor), note)])
            }
            (None, Some(domain), Some(other)) if domain == other => {
                let note = format!("z in {image_name} as the image");
                Ok(vec![(Vertical::Scaled(1.0), note)])
            }
            (_, Some(Domain::Time), Some(Domain::Depth)) => match &self.time_to_depth {
                Some((_, file_unit)) => {
                    let unit = unit.unwrap_or(*file_unit);
                    Ok(vec![self.time_reading(unit)])
                }
                None => refuse(
                    format!(
                        "has z in two-way time{}, but the image is in {image_name}",
                        unit.map_or(String::new(), |unit| format!(" ({})", unit.symbol))
                    ),
                    format!(
                        "give the image in time with --velocity, or surfaces in depth; if z is in {image_name}, add ,unit={image_name}"
                    ),
                ),
            },
            (_, Some(Domain::Depth), Some(Domain::Time)) => refuse(
                format!(
                    "has z in depth{}, but the image is in two-way time ({image_name})",
                    unit.map_or(String::new(), |unit| format!(" ({})", unit.symbol))
                ),
                format!(
                    "convert the image to depth with --velocity, or give z in time; if z is in {image_name}, add ,unit={image_name}"
                ),
            ),
            (None, None, Some(_)) => {
                let as_image = (
                    Vertical::Scaled(1.0),
                    format!("z in {image_name} as the image, as the file has no unit"),
                );
                Ok(match &self.time_to_depth {
                    Some((_, unit)) => {
                        let (vertical, note) = self.time_reading(*unit);
                        let note =
                            format!("{note}, as the file has no unit (else add ,domain=depth)");
                        let depth = format!(
                            "z in {image_name}, as the file has no unit (else add ,domain=time)"
                        );
                        vec![(vertical, note), (Vertical::Scaled(1.0), depth)]
                    }
                    None => vec![as_image],
                })
            }
            (unit, _, _) => {
                let note = unit
                    .filter(|unit| unit.symbol != "m")
                    .map_or(String::new(), |unit| {
                        format!("z in {} as it is, as the image has no unit", unit.symbol)
                    });
                Ok(vec![(Vertical::Scaled(1.0), note)])
            }
        }
    }

    /// Returns the reading of two-way time in an image in depth.
    fn time_reading(&self, unit: Unit) -> (Vertical, String) {
        let image = self.unit(D - 1).map_or("", |unit| unit.symbol);
        let velocity = match &self.time_to_depth {
            Some((TimeToDepth::Constant(velocity), _)) => format!("{velocity} m/s"),
            Some((TimeToDepth::Model(model), _)) => model.name.clone(),
            None => String::new(),
        };
        let note = format!(
            "z in two-way time ({}), converted to depth in {image} with {velocity}",
            unit.symbol
        );
        (Vertical::TwoWayTime(unit.size), note)
    }

    /// Returns the depth, in the unit of the frame, of a two-way time in seconds at a position.
    fn depth(&self, position: [f64; D], seconds: f64) -> f64 {
        match &self.time_to_depth {
            Some((TimeToDepth::Constant(velocity), _)) => {
                let metres = self.unit(D - 1).map_or(1.0, |unit| unit.size);
                0.5 * velocity * seconds / metres
            }
            Some((TimeToDepth::Model(model), _)) => model.time_depth_curve(position).depth(seconds),
            None => seconds,
        }
    }

    /// Returns the sign of z downwards.
    fn downward_sign(&self) -> f64 {
        match self.direction {
            Some(ZDirection::Up) => -1.0,
            Some(ZDirection::Down) => 1.0,
            // Without names and units, the side of zero on which the image lies tells.
            None => {
                if self.middle()[D - 1] < 0.0 {
                    -1.0
                } else {
                    1.0
                }
            }
        }
    }

    /// Returns the ranges of the coordinates of the image, for messages.
    pub fn ranges(&self) -> String {
        let corners = (0..1usize << D).map(|corner| {
            let index = std::array::from_fn(|k| {
                if corner >> k & 1 == 1 {
                    self.last[k]
                } else {
                    0.0
                }
            });
            self.geometry.to_physical(index)
        });
        ranges(corners, &self.geometry.units)
    }

    /// Returns the ranges of the coordinates of points in this frame, for messages.
    pub fn ranges_of<const N: usize>(&self, points: impl Iterator<Item = [f64; N]>) -> String {
        ranges(points, &self.geometry.units)
    }
}

impl<const D: usize> Placing<'_, D> {
    /// Returns a position of the file in the frame of the image.
    pub fn apply(&self, position: [f64; D]) -> [f64; D] {
        let mut placed: [f64; D] = std::array::from_fn(|k| position[k] * self.reading.factors[k]);
        let z = self.sign * position[D - 1];
        placed[D - 1] = match self.reading.vertical {
            Vertical::Scaled(factor) => factor * z,
            Vertical::TwoWayTime(seconds) => {
                let down = self.frame.downward_sign();
                down * self.frame.depth(placed, down * z * seconds)
            }
        };
        placed
    }

    /// Returns the sign of z with which points lie nearer to the middle of the image.
    fn nearer_sign(&mut self, points: &[[f64; D]]) -> f64 {
        let middle = self.frame.middle()[D - 1];
        let mut distance = |sign: f64| {
            self.sign = sign;
            let heights = points.iter().map(|p| self.apply(*p)[D - 1]);
            heights.map(|z| (z - middle).abs()).sum::<f64>()
        };
        if distance(-1.0) < distance(1.0) {
            -1.0
        } else {
            1.0
        }
    }

    /// Returns a length along x of the file in the frame of the image.
    pub fn length(&self, length: f64) -> f64 {
        length * self.reading.factors[0]
    }

    /// Returns `true` if positions stay as they are in the file.
    pub fn is_identity(&self) -> bool {
        self.sign > 0.0
            && self.reading.factors.iter().all(|factor| *factor == 1.0)
            && self.reading.vertical == Vertical::Scaled(1.0)
    }
}

/// Returns the ranges of the coordinates of points, each with its unit, for messages.
pub fn ranges<const D: usize>(points: impl Iterator<Item = [f64; D]>, units: &[String]) -> String {
    let unbounded = [[f64::INFINITY, f64::NEG_INFINITY]; D];
    let bounds = points.fold(unbounded, |bounds, p| {
        std::array::from_fn(|k| [bounds[k][0].min(p[k]), bounds[k][1].max(p[k])])
    });
    let rounded = |value: f64| (value * 1e3).round() / 1e3;
    let names = ["x", "y", "z"].into_iter().zip(bounds).enumerate();
    let texts: Vec<String> = names
        .map(|(k, (name, bounds))| {
            let [low, high] = bounds.map(rounded);
            let unit = units.get(k).map_or("", String::as_str);
            format!("{name} {low} to {high} {unit}")
                .trim_end()
                .to_string()
        })
        .collect();
    texts.join(", ")
}

/// Returns the domain of z that a file, its option or the `unit` of z says.
///
/// # Errors
/// Returns [`Error::Job`] for a unit that is none of the domain.
fn stated_domain(file: GivenFile<'_>, unit: Option<Unit>) -> Result<Option<Domain>> {
    let domain = file.options.domain.or(match unit {
        // The unit of the option says the domain better than the file.
        Some(_) if file.options.unit(2).is_some() => None,
        _ => file.stated.domain,
    });
    let domain_of_unit = unit.map(|unit| match unit.quantity {
        Quantity::Time => Domain::Time,
        Quantity::Length => Domain::Depth,
    });
    if let (Some(domain), Some(unit), Some(other)) = (domain, unit, domain_of_unit)
        && domain != other
    {
        let problem = format!("has z in {}, which is no unit of {domain}", unit.symbol);
        let remedy = format!("say the unit: ,unit=U, or omit domain={domain}");
        return Err(Error::Job(cause(file.place, problem, remedy)));
    }
    Ok(domain.or(domain_of_unit))
}

/// Returns the unit of a coordinate of a file, if it or the option says it.
fn stated_unit(file: GivenFile<'_>, k: usize, notes: &mut Vec<String>) -> Result<Option<Unit>> {
    let name = ["x", "y", "z"][k];
    let text = file.stated.units[k].as_deref().unwrap_or_default();
    let is_none = NO_UNITS.contains(&text.trim().to_lowercase().as_str());
    let by_file = units::find(text);
    if let Some(by_option) = file.options.unit(k).and_then(units::find) {
        if by_file.is_some_and(|unit| unit != by_option) {
            notes.push(format!(
                "the option's unit of {name} replaces the file's, {text}"
            ));
        }
        return Ok(Some(by_option));
    }
    if by_file.is_none() && !is_none {
        let problem = format!("has {name} in {text}, which is no known unit of length or time");
        let remedy = "say the unit after the file: ,unit=m (of z), or ,unit=m,m,ft";
        return Err(Error::Job(cause(file.place, problem, remedy)));
    }
    Ok(by_file)
}

/// Returns a note on the sign of z, if it is not as in the image.
fn sign_note<const D: usize>(
    sign: f64,
    stated: Option<ZDirection>,
    frame: &Frame<D>,
    is_refuted: bool,
    file: GivenFile<'_>,
) -> Option<String> {
    let by_option = file.options.z_direction;
    if let (Some(option), Some(other)) = (by_option, file.stated.z_direction)
        && option != other
    {
        return Some(format!(
            "z {option} as the option says, though the file says {other}"
        ));
    }
    let words = |direction: ZDirection| match direction {
        ZDirection::Up => "upwards",
        ZDirection::Down => "downwards",
    };
    match (sign < 0.0, stated) {
        (true, Some(_)) if is_refuted => {
            Some("with the sign of z turned, as it fits the image only so".into())
        }
        (false, Some(stated)) if is_refuted => Some(format!(
            "with the sign of z kept, though the file says that z grows {}, as it fits the image only so",
            words(stated)
        )),
        (true, Some(stated)) if frame.direction.is_some() => Some(format!(
            "with the sign of z turned, as it grows {} in the file",
            words(stated)
        )),
        (true, _) => {
            let reason = match frame.region {
                Region::Above => "as it lies above the image and nearer to it so",
                _ => "as more of it lies in the image so",
            };
            Some(format!(
                "with the sign of z turned, {reason} (else add ,z=up or ,z=down)"
            ))
        }
        (false, _) => None,
    }
}

impl<const D: usize> Geometry<D> {
    /// Returns the direction in which the last physical coordinate grows, if names and units tell.
    pub fn z_direction(&self) -> Option<ZDirection> {
        let without_units = self.units.iter().all(String::is_empty);
        let along = (0..D).find(|&k| self.main_coordinate(k) == D - 1);
        let plain = ["x", "y", "z", "w", ""];
        let has_plain_name = along.is_none_or(|k| plain.contains(&&*self.names[k]));
        if without_units && has_plain_name {
            return None;
        }
        Some(ZDirection::from_up(!self.points_down()))
    }
}
