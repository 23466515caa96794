//! Fault rock from clay: the shale-gouge ratio (SGR) of each face of a fault, and the permeability
//! and thickness of the fault rock that follow from it.
//!
//! SGR is the mean clay fraction of the rock that has slipped past a point of the fault (Yielding,
//! Freeman and Needham 1997). With the throw t and depth z, this is the hanging wall between z and
//! z + t, or the footwall between z - t and z. Both walls are sampled by the cells along the
//! fault, or by the image of the clay beside it, at the same place along strike, and the mean of all samples counts: near the top and the bottom of
//! the mesh one of the two walls lies outside.
//!
//! Permeability in mD is that of Manzocchi, Walsh, Nell and Yielding (1999) or of Sperrevik,
//! Gillespie, Fisher, Halvorsen and Knipe (2002):
//!
//! ```text
//! log10 k = -4 SGR - 1/4 log10(t) (1 - SGR)^5
//! ln(k / 80000) = -(19.4 SGR + 0.00403 z_max + (0.0055 z_f - 12.5) (1 - SGR)^7)
//! ```
//!
//! Here z_max is the largest depth of burial, and z_f the depth when the fault was active, in metres. The
//! thickness is t / 66 (Manzocchi et al. 1999). The law is integrated over each face: pieces of a face, each
//! with its own SGR, conduct side by side. So the transmissibility of a fault does not depend on the size of
//! cells, if an image gives the clay; without an image, cells must resolve it.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::parallel::prelude::*;

use super::averaging::ImageProbe;
use super::fault_throws::{MIN_THROW, SurfaceThrow, ThrowSource, read_throws};
use super::gouge_profile::{ClayProfile, FaultFace};
use super::{CellValue, MILLIDARCY, Model, ModelFrame};
use crate::error::cause;
use crate::files::table::{Term, ValueTable, text_rows};
use crate::model::flow::faults::SURFACE_TERM;
use crate::model::flow::faults::parse_selector;
use crate::model::flow::{FaultLaw, Rock};
use crate::model::surface::names::Selector;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, parse_number};
use crate::surface_file::has_extension;
use crate::{Error, Result};

/// Smallest horizontal part of the normal of a face (dip 30 degrees) beside which beds lie flat.
const MIN_HORIZONTAL: f64 = 0.5;
/// Throw over thickness of the fault rock (Manzocchi et al. 1999).
const THROW_PER_THICKNESS: f64 = 66.0;

/// Tables of throws by surface.
const THROWS: ValueTable = ValueTable {
    terms: &[
        SURFACE_TERM,
        Term::new("throw", &["verticalthrow", "displacement", "value"]),
    ],
    meaning: "a surface and its throw",
    remedy: "write surface,throw",
};

/// Options for fault rock that is computed from clay.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct GougeOptions {
    /// Throw (m) of faults, whose fault rock then follows from --clay: their number or name, or a
    /// pattern (fault3:25), negative for reverse faults; a CSV file of lines surface,throw; or the
    /// surfaces with throws that `atomesh surface MESH --survey IMAGE -o FILE.vtp` writes, for the throw of
    /// each face. May be repeated, and the last match applies
    #[arg(long, value_name = "WHICH:THROW", allow_hyphen_values = true)]
    pub throw: Vec<FaultThrow>,
    /// Clay fraction of the rock, 0 to 1, given like a porosity: with --throw it gives the
    /// shale-gouge ratio, the permeability and the thickness of fault rock
    #[arg(long, value_name = "FRACTION", allow_hyphen_values = true)]
    pub clay: Option<CellValue>,
    /// Law of the permeability of fault rock: manzocchi, or sperrevik:MAX,FAULTING with the largest depth of
    /// burial and the depth of faulting in metres [default: manzocchi]
    #[arg(long, value_name = "LAW")]
    pub fault_rock: Option<FaultRockLaw>,
    /// Take beds with a clay fraction of 0.4 or more as smeared along the fault where the throw is below FACTOR
    /// times their thickness: the fault rock there has their clay. 7 is usual
    #[arg(long, value_name = "FACTOR")]
    pub clay_smear: Option<f64>,
}

/// Laws of the permeability of fault rock.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum FaultRockLaw {
    /// Manzocchi, Walsh, Nell and Yielding (1999).
    #[default]
    Manzocchi,
    /// Sperrevik, Gillespie, Fisher, Halvorsen and Knipe (2002).
    Sperrevik {
        /// Largest depth of burial in metres.
        max_depth: f64,
        /// Depth of faulting in metres.
        faulting_depth: f64,
    },
}

impl FaultRockLaw {
    /// Returns the permeability in mD of fault rock with this shale-gouge ratio, after this throw in
    /// metres.
    pub fn permeability(self, gouge_ratio: f64, throw: f64) -> f64 {
        match self {
            Self::Manzocchi => {
                let sand = (1.0 - gouge_ratio).powi(5);
                10f64.powf(-4.0 * gouge_ratio - 0.25 * throw.log10() * sand)
            }
            Self::Sperrevik {
                max_depth,
                faulting_depth,
            } => {
                let sand = (1.0 - gouge_ratio).powi(7);
                let burial = 0.00403 * max_depth;
                80_000.0
                    * (-(19.4 * gouge_ratio + burial + (0.0055 * faulting_depth - 12.5) * sand))
                        .exp()
            }
        }
    }
}

impl FromStr for FaultRockLaw {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give manzocchi, or sperrevik:MAX,FAULTING with depths in metres, such as sperrevik:2500,800";
        if text == "manzocchi" {
            return Ok(Self::Manzocchi);
        }
        let depths = text
            .strip_prefix("sperrevik:")
            .and_then(|t| t.split_once(','));
        let Some((max_depth, faulting_depth)) = depths else {
            return Err(InvalidValue::new("is no law of fault rock", remedy));
        };
        let [max_depth, faulting_depth] = [
            parse_number(max_depth, remedy)?,
            parse_number(faulting_depth, remedy)?,
        ];
        if !(0.0..=max_depth).contains(&faulting_depth) {
            let problem = "needs a depth of faulting from 0 to the largest depth of burial";
            return Err(InvalidValue::new(problem, remedy));
        }
        Ok(Self::Sperrevik {
            max_depth,
            faulting_depth,
        })
    }
}

impl Display for FaultRockLaw {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Manzocchi => write!(f, "manzocchi"),
            Self::Sperrevik {
                max_depth,
                faulting_depth,
            } => write!(f, "sperrevik:{max_depth},{faulting_depth}"),
        }
    }
}

serde_as_text!(FaultRockLaw: [","; 2]);

/// Surfaces and their throw.
#[derive(Debug, Clone, PartialEq)]
pub enum FaultThrow {
    /// The surfaces that the selector selects, and their throw in metres.
    Surfaces(Selector, f64),
    /// A CSV file of lines surface,throw, or surfaces (`.vtp`) with the throw of each face.
    File(PathBuf),
}

impl FromStr for FaultThrow {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give a surface and its throw in metres, such as fault3:25, or a CSV file";
        if Path::new(text).is_file() {
            return Ok(Self::File(text.into()));
        }
        let (surface, throw) = text
            .rsplit_once(':')
            .ok_or_else(|| InvalidValue::new("has no ':' and is not a file", remedy))?;
        let selector = parse_selector(surface)
            .ok_or_else(|| InvalidValue::new("names no surface (numbers begin at 1)", remedy))?;
        let throw = parse_number(throw, remedy)?;
        if throw == 0.0 {
            return Err(InvalidValue::new("has a throw of 0", remedy));
        }
        Ok(Self::Surfaces(selector, throw))
    }
}

impl Display for FaultThrow {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Surfaces(selector, throw) => write!(f, "{selector}:{throw}"),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

serde_as_text!(FaultThrow: [":"; 2]);

impl GougeOptions {
    /// Returns the given option, if there is one.
    pub(crate) fn given_option(&self) -> Option<&'static str> {
        let given = [
            ("throw", !self.throw.is_empty()),
            ("clay", self.clay.is_some()),
            ("fault-rock", self.fault_rock.is_some()),
            ("clay-smear", self.clay_smear.is_some()),
        ];
        given.iter().find(|option| option.1).map(|option| option.0)
    }

    /// Checks that throw and clay are given together.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if one of them is missing.
    pub(crate) fn validate(&self) -> Result<()> {
        let (place, missing) = match (self.throw.is_empty(), &self.clay) {
            (true, Some(_)) => ("clay", "throw"),
            (false, None) => ("throw", "clay"),
            (true, None) if self.fault_rock.is_some() => ("fault-rock", "throw"),
            (true, None) if self.clay_smear.is_some() => ("clay-smear", "throw"),
            _ => return self.check_smear(),
        };
        let problem = "needs both the throw of faults and the clay fraction of the rock";
        let remedy = "give both, or omit it";
        Err(Error::Job(
            cause(place, problem, remedy).with_parameter(missing),
        ))
    }

    fn check_smear(&self) -> Result<()> {
        match self.clay_smear {
            Some(factor) if !(factor.is_finite() && factor > 0.0) => Err(Error::Job(cause(
                format!("clay-smear {factor}"),
                "is not a positive factor",
                "give the throw over the thickness of a bed from which its smear is broken: 7 is usual",
            ))),
            _ => Ok(()),
        }
    }

    /// Returns the throws of surfaces, in the order in which they are given.
    ///
    /// # Errors
    /// Returns [`Error::Io`] or [`Error::Job`] for a file that cannot be read.
    pub(crate) fn throws(&self, frame: &ModelFrame) -> Result<Vec<ThrowSource>> {
        let mut throws = Vec::new();
        for throw in &self.throw {
            match throw {
                FaultThrow::Surfaces(selector, throw) => {
                    throws.push(ThrowSource::Constant(selector.clone(), *throw));
                }
                FaultThrow::File(path) if has_extension(path, &["vtp"]) => {
                    throws.push(read_throws(path, frame)?);
                }
                FaultThrow::File(path) => {
                    let row = |words: &[&str]| match words {
                        [surface, throw] => {
                            let throw: f64 = throw.parse().ok()?;
                            let selector = parse_selector(surface)?;
                            (throw.is_finite() && throw != 0.0).then_some((selector, throw))
                        }
                        _ => None,
                    };
                    let rows = text_rows(path, &THROWS, row)?;
                    let rows = rows.into_iter().map(|(_, row)| row);
                    throws.extend(
                        rows.map(|(selector, throw)| ThrowSource::Constant(selector, throw)),
                    );
                }
            }
        }
        Ok(throws)
    }
}

/// The fault rock of a surface, for a note to the user.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultRock {
    /// The name of the surface.
    pub name: String,
    /// Smallest, mean (by area) and largest throw of its faces in metres.
    pub throw: [f64; 3],
    /// Smallest, mean (by area) and largest shale-gouge ratio of its faces.
    pub gouge_ratio: [f64; 3],
    /// Smallest and largest permeability in mD.
    pub permeability: [f64; 2],
    /// Smallest and largest thickness in metres.
    pub thickness: [f64; 2],
}

impl FaultRock {
    /// Returns one line for the user.
    pub fn note(&self) -> String {
        let ([low, mean, high], [k, l]) = (self.gouge_ratio, self.permeability);
        let throw = match self.throw {
            [least, _, most] if least == most => format!("{least} m"),
            [least, mean, most] => format!("{least:.2} to {most:.2} m (mean {mean:.2})"),
        };
        let thickness = match self.thickness {
            [least, most] if least == most => format!("{least:.3} m"),
            [least, most] => format!("{least:.3} to {most:.3} m"),
        };
        format!(
            "{}: throw {throw}, shale-gouge ratio {low:.3} to {high:.3} (mean {mean:.3}), fault rock of {k:.2e} to {l:.2e} mD and {thickness}",
            self.name
        )
    }
}

/// The clay fraction of the rock.
#[derive(Clone, Copy)]
pub(crate) struct RockClay<'a> {
    /// The clay fraction of each cell.
    pub cells: &'a [f64],
    /// The image that gives it, if one does.
    pub image: Option<&'a ImageProbe>,
}

/// How fault rock follows from clay and throw.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct FaultRockRule<'a> {
    pub law: FaultRockLaw,
    /// Throw over thickness of a bed below which its smear is continuous, if beds are smeared.
    pub smear: Option<f64>,
    /// The rock in the cells, if it is known.
    pub rock: Option<&'a Rock>,
}

/// The fault rock of one face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FaceRock {
    pub connection: usize,
    /// Throw in metres.
    pub throw: f64,
    /// Mean shale-gouge ratio.
    pub gouge_ratio: f64,
    /// Smallest and largest permeability of its pieces in mD.
    pub permeability: [f64; 2],
    pub law: FaultLaw,
}

impl Model {
    /// Gives the faults with a throw the fault rock that follows from the clay fraction of each cell,
    /// in place of the laws that they have. Call this after [`set_faults`](Self::set_faults) and before
    /// [`set_permeability`](Self::set_permeability). Returns the fault rock of each fault and of each face.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if a throw is for a surface that does not exist, and
    /// [`Error::Export`] for a clay fraction outside [0, 1].
    pub(crate) fn set_fault_rock(
        &mut self,
        clay: RockClay<'_>,
        throws: &[ThrowSource],
        rule: FaultRockRule<'_>,
    ) -> Result<(Vec<FaultRock>, Vec<FaceRock>)> {
        let is_outside = |v: &f64| !(0.0..=1.0).contains(v);
        if let Some(cell) = clay.cells.iter().position(is_outside) {
            return Err(Error::Export(cause(
                "clay",
                format!("is {} in cell {cell}", clay.cells[cell]),
                "give fractions from 0 to 1",
            )));
        }
        let names = self.surfaces.all_names();
        for throw in throws {
            if let ThrowSource::Constant(selector, _) = throw {
                names.check("throw", selector)?;
            }
        }
        let is_upper = self.second_cell_is_upper();
        let extensions = &self.surfaces.extensions;
        let throw_of = |surface: usize| SurfaceThrow::of_surface(throws, &names, surface);
        let mut fault_rocks = Vec::new();
        let mut face_rocks = Vec::new();
        for surface in 0..names.kinds.len() {
            let Some(throw) = throw_of(surface) else {
                continue;
            };
            let number = surface as u32 + 1;
            // An extension without a throw of its own has that of its fault.
            let is_part = |part: u32| {
                part == number
                    || extensions.contains(&(part, number)) && throw_of(part as usize - 1).is_none()
            };
            let faces = self.fault_faces(is_part, &is_upper, clay.cells);
            if faces.is_empty() {
                continue;
            }
            let rocks = self.face_rocks(&faces, clay.image, &throw, rule);
            let name = names.names.get(surface).cloned();
            let name = name.unwrap_or_else(|| "scraps".into());
            fault_rocks.extend(self.fault_rock(name, &rocks));
            face_rocks.extend(rocks);
        }
        let barriers = std::mem::take(&mut self.barriers);
        let face_laws = face_rocks.iter().map(|rock| (rock.connection, rock.law));
        self.barriers = barriers.with_face_laws(face_laws);
        Ok((fault_rocks, face_rocks))
    }

    /// Returns the ranges of the fault rock of a fault; `None` if no face has fault rock.
    fn fault_rock(&self, name: String, rocks: &[FaceRock]) -> Option<FaultRock> {
        let area = |rock: &FaceRock| self.graph.connections[rock.connection].area;
        let total: f64 = rocks.iter().map(area).sum();
        let range = |value: fn(&FaceRock) -> f64| {
            let values = rocks.iter().map(value);
            let low = values.clone().fold(f64::INFINITY, f64::min);
            let high = values.fold(f64::NEG_INFINITY, f64::max);
            let sum: f64 = rocks.iter().map(|rock| area(rock) * value(rock)).sum();
            [low, sum / total, high]
        };
        let thickness = range(|rock| rock.throw.abs() / THROW_PER_THICKNESS);
        (!rocks.is_empty()).then(|| FaultRock {
            name,
            throw: range(|rock| rock.throw),
            gouge_ratio: range(|rock| rock.gouge_ratio),
            permeability: [
                range(|rock| rock.permeability[0])[0],
                range(|rock| rock.permeability[1])[2],
            ],
            thickness: [thickness[0], thickness[2]],
        })
    }

    /// Returns the fault rock of the faces of one fault.
    fn face_rocks(
        &self,
        faces: &[FaultFace],
        image: Option<&ImageProbe>,
        throw: &SurfaceThrow<'_>,
        rule: FaultRockRule<'_>,
    ) -> Vec<FaceRock> {
        let profile = ClayProfile::new(faces, image);
        let face_rock = |face: &FaultFace| {
            let c = &self.graph.connections[face.connection];
            let throw = throw.at(c.point);
            if throw.abs() < MIN_THROW {
                return None;
            }
            let thickness = throw.abs() / THROW_PER_THICKNESS;
            // The layer is not thicker than the distance between the sites.
            let layer = thickness.min(2.0 * c.distance[0].min(c.distance[1]));
            let rock_resistance = |side: usize| {
                let mobility = rule
                    .rock?
                    .mobility(c.cells[side] as usize)
                    .normal_component(c.normal);
                (mobility > 0.0).then(|| (c.distance[side] - 0.5 * layer).max(0.0) / mobility)
            };
            let resistance = rock_resistance(0).unwrap_or(0.0) + rock_resistance(1).unwrap_or(0.0);
            let (mut conductance, mut area, mut ratio_sum) = (0.0, 0.0, 0.0);
            let mut range = [f64::INFINITY, f64::NEG_INFINITY];
            for piece in face.pieces(2.0 * profile.height) {
                let mean = || 0.5 * (face.clay[0] + face.clay[1]);
                let mut ratio = profile
                    .gouge_ratio(piece.centre, throw)
                    .unwrap_or_else(mean);
                let smear = rule
                    .smear
                    .and_then(|factor| profile.smear(piece.centre, throw, factor));
                ratio = ratio.max(smear.unwrap_or(0.0));
                let k = rule.law.permeability(ratio, throw.abs());
                range = [range[0].min(k), range[1].max(k)];
                conductance += piece.area / (resistance + thickness / (k * MILLIDARCY));
                ratio_sum += piece.area * ratio;
                area += piece.area;
            }
            let layer_resistance = area / conductance - resistance;
            Some(FaceRock {
                connection: face.connection,
                throw,
                gouge_ratio: ratio_sum / area,
                permeability: range,
                law: FaultLaw::layer(layer / layer_resistance, layer),
            })
        };
        let rocks: Vec<Option<FaceRock>> = faces.par_iter().map(face_rock).collect();
        rocks.into_iter().flatten().collect()
    }

    /// Returns the faces of the surfaces for which `is_part`, with the clay of their two walls. The hanging wall is
    /// on the upper side.
    fn fault_faces(
        &self,
        is_part: impl Fn(u32) -> bool,
        is_upper: &[bool],
        clay: &[f64],
    ) -> Vec<FaultFace> {
        let surfaces = &self.surfaces.connection_surfaces;
        let connections = self.graph.connections.iter().enumerate();
        let on_fault = connections.filter(|(index, _)| is_part(surfaces[*index]));
        let face = |(connection, c): (usize, &crate::mesh::graph::Connection<3>)| {
            let nodes = self.mesh.faces.get(c.face as usize);
            let [x, y, z] = c.normal;
            let horizontal = x.hypot(y);
            let upper = usize::from(is_upper[connection]);
            // Normals lead from the first cell to the second.
            let sign = if is_upper[connection] { 1.0 } else { -1.0 };
            let across = if horizontal > MIN_HORIZONTAL {
                [x, y, 0.0].map(|n| sign * n / horizontal.powi(2))
            } else {
                [x, y, z].map(|n| sign * n)
            };
            FaultFace {
                connection,
                strike: if horizontal > 0.0 {
                    [-y / horizontal, x / horizontal]
                } else {
                    [0.0; 2]
                },
                area: c.area,
                corners: nodes.iter().map(|&n| self.mesh.nodes[n as usize]).collect(),
                clay: [upper, 1 - upper].map(|side| clay[c.cells[side] as usize]),
                across,
            }
        };
        on_fault.map(face).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the faces of a vertical plane, `size` m wide and high, of which each wall has the clay at the
    /// middle of the face.
    fn faces(size: f64, clay: impl Fn(f64) -> [f64; 2]) -> Vec<FaultFace> {
        let [columns, rows] = [20.0 / size, 48.0 / size].map(|n| n as usize);
        let face = |n: usize| {
            let [y, top] = [n % columns, n / columns].map(|i| i as f64 * size);
            let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
            let corner = |(v, w): (f64, f64)| [3.0, y + v * size, -top - w * size];
            FaultFace {
                connection: n,
                strike: [0.0, if n.is_multiple_of(2) { 1.0 } else { -1.0 }],
                area: size * size,
                corners: corners.map(corner).to_vec(),
                clay: clay(top + 0.5 * size),
                across: [1.0, 0.0, 0.0],
            }
        };
        (0..columns * rows).map(face).collect()
    }

    /// A bed of clay from 10 to 14 m in the footwall, 8 m deeper in the hanging wall.
    fn bed(depth: f64) -> [f64; 2] {
        let is_bed = |depth: f64| f64::from(u8::from((10.0..14.0).contains(&depth)));
        [is_bed(depth - 8.0), is_bed(depth)]
    }

    #[test]
    fn the_gouge_ratio_is_the_mean_clay_that_slipped_past() {
        let profile = ClayProfile::new(&faces(1.0, bed), None);
        let exact = |depth: f64| (depth.min(14.0) - (depth - 8.0).max(10.0)).max(0.0) / 8.0;
        for i in 0..240 {
            // Walls that reach beyond the mesh have no samples there.
            let depth = 8.0 + 0.1 * f64::from(i);
            let ratio = profile.gouge_ratio([3.0, 7.3, -depth], 8.0).unwrap();
            assert!((ratio - exact(depth)).abs() < 0.01, "{depth} {ratio}");
        }
        // Reverse faults move the hanging wall up.
        let mirrored = profile.gouge_ratio([3.0, 7.3, -15.0], -8.0).unwrap();
        assert!((mirrored - exact(15.0)).abs() > 0.1);
    }

    #[test]
    fn a_thick_bed_is_smeared_and_a_thin_one_is_not() {
        let profile = ClayProfile::new(&faces(1.0, bed), None);
        let at = |depth: f64, factor: f64| profile.smear([3.0, 7.3, -depth], 8.0, factor);
        // The bed of 4 m is continuous up to a throw of 28 m.
        assert_eq!(at(16.0, 7.0), Some(1.0));
        assert_eq!(at(16.0, 1.5), None);
        assert_eq!(at(30.0, 7.0), None);
    }

    #[test]
    fn the_law_is_integrated_over_faces_of_any_size() {
        let law = FaultRockLaw::Manzocchi;
        // Beds of 12 m, as faces resolve them; throw 8.
        let beds = |depth: f64| {
            let clay = |depth: f64| {
                if (depth / 12.0).floor() as i64 % 2 == 0 {
                    0.1
                } else {
                    0.6
                }
            };
            [clay(depth), clay(depth)]
        };
        let exact = {
            let n = 48_000;
            let profile = |depth: f64| beds(depth)[0];
            let mean = |z: f64| {
                let slipped = (0..200).map(|i| z - 8.0 + 16.0 * (f64::from(i) + 0.5) / 200.0);
                let inside = slipped.filter(|z| (0.0..48.0).contains(z));
                let (count, sum) = inside.fold((0.0, 0.0), |s, z| (s.0 + 1.0, s.1 + profile(z)));
                sum / count
            };
            let depths = (0..n / 100).map(|i| (f64::from(i) + 0.5) * 0.1);
            depths
                .map(|z| law.permeability(mean(z), 8.0) * 0.1 * 20.0)
                .sum::<f64>()
        };
        for size in [1.0, 2.0, 4.0] {
            let faces = faces(size, beds);
            let profile = ClayProfile::new(&faces, None);
            let pieces = faces
                .iter()
                .flat_map(|face| face.pieces(2.0 * profile.height));
            let integral: f64 = pieces
                .map(|piece| {
                    let ratio = profile.gouge_ratio(piece.centre, 8.0).unwrap();
                    piece.area * law.permeability(ratio, 8.0)
                })
                .sum();
            assert!(
                (integral / exact - 1.0).abs() < 0.01,
                "{size} {integral} {exact}"
            );
        }
    }

    #[test]
    fn throws_of_a_table_are_converted_to_metres() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("throws.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let options = GougeOptions {
                throw: vec![FaultThrow::File(path.clone())],
                ..GougeOptions::default()
            };
            let throws = options.throws(&ModelFrame::default());
            throws.map_err(|error| error.to_string())
        };
        for text in [
            "surface,throw\nFA,30.48\n",
            "surface,throw (ft)\nFA,100\n",
            "throw [cm];surface\n3048;FA\n",
        ] {
            let throws = read(text).unwrap();
            let [ThrowSource::Constant(_, throw)] = throws[..] else {
                panic!("{throws:?}")
            };
            assert!((throw / 30.48 - 1.0).abs() < 1e-12, "{text}");
        }
        let error = read("surface,throw (psi)\nFA,100\n").unwrap_err();
        assert!(
            error.contains(
                "throws.csv:1: column 'throw' has the unit 'psi', which is none of length"
            ),
            "{error}"
        );
    }

    #[test]
    fn permeability_of_fault_rock_is_that_of_the_papers() {
        // log k = -4 * 0.2 - 0.25 * log10(100) * 0.8^5
        let expected = 10f64.powf(-0.8 - 0.5 * 0.327_68);
        let manzocchi = FaultRockLaw::Manzocchi;
        assert!((manzocchi.permeability(0.2, 100.0) / expected - 1.0).abs() < 1e-12);
        assert!((manzocchi.permeability(1.0, 30.0) - 1e-4).abs() < 1e-16);
        let sperrevik: FaultRockLaw = "sperrevik:2500,800".parse().unwrap();
        assert_eq!(sperrevik.to_string(), "sperrevik:2500,800");
        // 19.4 * 0.3 + 0.00403 * 2500 + (0.0055 * 800 - 12.5) * 0.7^7
        let exponent: f64 = 5.82 + 10.075 - 8.1 * 0.082_354_3;
        let expected = 80_000.0 * (-exponent).exp();
        assert!((sperrevik.permeability(0.3, 50.0) / expected - 1.0).abs() < 1e-9);
        for text in [
            "sperrevik",
            "sperrevik:1",
            "sperrevik:500,800",
            "sperrevik:a,1",
            "other",
        ] {
            assert!(text.parse::<FaultRockLaw>().is_err(), "{text}");
        }
    }

    #[test]
    fn uniform_clay_gives_the_transmissibility_of_a_layer() {
        use crate::mesh::poly::samples::two_cells;
        use crate::model::flow::Tensor;
        let mut model = Model::new(two_cells::<3>(0.75), None);
        let throws = [ThrowSource::Constant(Selector::Number(1), 6.6)];
        let rock_k = 100.0 * MILLIDARCY;
        let rock = Rock::uniform(Tensor::isotropic(rock_k), 1.0);
        let rule = FaultRockRule {
            rock: Some(&rock),
            ..FaultRockRule::default()
        };
        let clay = |cells: &'static [f64]| RockClay { cells, image: None };
        let uniform = clay(&[0.3, 0.3]);
        let (rocks, _) = model.set_fault_rock(uniform, &throws, rule).unwrap();
        let k = FaultRockLaw::Manzocchi.permeability(0.3, 6.6) * MILLIDARCY;
        assert!((rocks[0].gouge_ratio[1] - 0.3).abs() < 1e-12, "{rocks:?}");
        model.set_permeability(rock.clone()).unwrap();
        let c = &model.graph.connections[0];
        let length = c.distance[0] + c.distance[1];
        let expected = c.area / ((length - 0.1) / rock_k + 0.1 / k);
        let t = model.permeability.as_ref().unwrap().transmissibility[0];
        assert!((t / expected - 1.0).abs() < 1e-12, "{t} {expected}");
        let error = model
            .set_fault_rock(clay(&[0.3, 1.5]), &throws, rule)
            .unwrap_err();
        assert!(error.to_string().starts_with("clay: is 1.5 in cell 1"));
    }
}
