//! Fault rock from clay: the shale-gouge ratio (SGR) of each face of a fault, and the permeability
//! and thickness of the fault rock that follow from it.
//!
//! SGR is the mean clay fraction of the rock that has slipped past a point of the fault (Yielding,
//! Freeman and Needham 1997). With the throw t and depth z, this is the hanging wall between z and
//! z + t, or the footwall between z - t and z. Both walls are sampled by the cells along the
//! fault at the same place along strike, and the mean of all samples counts: near the top and the bottom of
//! the mesh one of the two walls lies outside.
//!
//! Permeability in mD and thickness are those of Manzocchi, Walsh, Nell and Yielding (1999):
//!
//! ```text
//! log k = -4 SGR - 1/4 log(t) (1 - SGR)^5,    thickness = t / 66
//! ```

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::parallel::prelude::*;

use super::{CellValue, MILLIDARCY, Model};
use crate::error::cause;
use crate::files::table::{Term, ValueTable, text_rows};
use crate::geometry::{dot, norm, sub};
use crate::model::flow::FaultLaw;
use crate::model::flow::faults::SURFACE_TERM;
use crate::model::flow::faults::parse_selector;
use crate::model::surface::names::Selector;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, parse_number};
use crate::{Error, Result};

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
    /// pattern (fault3:25), negative for reverse faults. May be repeated, and the last match
    /// applies; or a CSV file of lines surface,throw
    #[arg(long, value_name = "WHICH:THROW", allow_hyphen_values = true)]
    pub throw: Vec<FaultThrow>,
    /// Clay fraction of the rock, 0 to 1, given like a porosity: with --throw it gives the
    /// shale-gouge ratio, the permeability and the thickness of fault rock
    #[arg(long, value_name = "FRACTION", allow_hyphen_values = true)]
    pub clay: Option<CellValue>,
}

/// Surfaces and their throw.
#[derive(Debug, Clone, PartialEq)]
pub enum FaultThrow {
    /// The surfaces that the selector selects, and their throw in metres.
    Surfaces(Selector, f64),
    /// A CSV file of lines surface,throw.
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
            _ => return Ok(()),
        };
        let problem = "needs both the throw of faults and the clay fraction of the rock";
        let remedy = "give both, or omit it";
        Err(Error::Job(
            cause(place, problem, remedy).with_parameter(missing),
        ))
    }

    /// Returns the selectors of surfaces with their throws, in the order in which they are given.
    ///
    /// # Errors
    /// Returns [`Error::Io`] or [`Error::Job`] for a file that cannot be read.
    pub(crate) fn throws(&self) -> Result<Vec<(Selector, f64)>> {
        let mut throws = Vec::new();
        for throw in &self.throw {
            match throw {
                FaultThrow::Surfaces(selector, throw) => throws.push((selector.clone(), *throw)),
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
                    throws.extend(rows.into_iter().map(|(_, row)| row));
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
    /// Throw in metres.
    pub throw: f64,
    /// Smallest, mean (by area) and largest shale-gouge ratio of its faces.
    pub gouge_ratio: [f64; 3],
    /// Smallest and largest permeability in mD.
    pub permeability: [f64; 2],
    /// Thickness in metres.
    pub thickness: f64,
}

impl FaultRock {
    /// Returns one line for the user.
    pub fn note(&self) -> String {
        let ([low, mean, high], [k, l]) = (self.gouge_ratio, self.permeability);
        format!(
            "{}: throw {} m, shale-gouge ratio {low:.3} to {high:.3} (mean {mean:.3}), fault rock of {k:.2e} to {l:.2e} mD and {:.3} m",
            self.name, self.throw, self.thickness
        )
    }
}

/// A face of a fault, as the samples of both walls.
struct FaultFace {
    connection: usize,
    /// Centre of the face.
    centre: [f64; 3],
    /// Horizontal unit vector along strike.
    strike: [f64; 2],
    area: f64,
    /// Smallest and largest depth of the face.
    depths: [f64; 2],
    /// Clay fraction of the hanging wall and of the footwall.
    clay: [f64; 2],
}

/// Returns the permeability in mD of fault rock with this shale-gouge ratio, after this throw in
/// metres (Manzocchi et al. 1999).
pub fn fault_rock_permeability(gouge_ratio: f64, throw: f64) -> f64 {
    let exponent = -4.0 * gouge_ratio - 0.25 * throw.log10() * (1.0 - gouge_ratio).powi(5);
    10f64.powf(exponent)
}

impl Model {
    /// Gives the faults with a throw the fault rock that follows from the clay fraction of each cell,
    /// in place of the laws that they have. Call this after [`set_faults`](Self::set_faults) and before
    /// [`set_permeability`](Self::set_permeability). Returns the fault rock of each fault.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if a throw is for a surface that does not exist, and
    /// [`Error::Export`] for a clay fraction outside [0, 1].
    pub fn set_fault_rock(
        &mut self,
        clay: &[f64],
        throws: &[(Selector, f64)],
    ) -> Result<Vec<FaultRock>> {
        if let Some(cell) = clay.iter().position(|v| !(0.0..=1.0).contains(v)) {
            return Err(Error::Export(cause(
                "clay",
                format!("is {} in cell {cell}", clay[cell]),
                "give fractions from 0 to 1",
            )));
        }
        let names = self.surfaces.all_names();
        for (selector, _) in throws {
            names.check("throw", selector)?;
        }
        let mut fault_rocks = Vec::new();
        let mut face_laws = Vec::new();
        for surface in 0..names.kinds.len() {
            let mut matching = throws.iter().rev();
            let Some((_, throw)) = matching.find(|(s, _)| s.selects(&names, surface)) else {
                continue;
            };
            let faces = self.fault_faces(surface as u32 + 1, clay);
            if faces.is_empty() {
                continue;
            }
            let ratios = gouge_ratios(&faces, *throw);
            let thickness = throw.abs() / THROW_PER_THICKNESS;
            let name = names.names.get(surface).cloned();
            let mut rock = FaultRock {
                name: name.unwrap_or_else(|| "scraps".into()),
                throw: *throw,
                gouge_ratio: [f64::INFINITY, 0.0, f64::NEG_INFINITY],
                permeability: [f64::INFINITY, f64::NEG_INFINITY],
                thickness,
            };
            let (mut area, [low, _, high]) = (0.0, &mut rock.gouge_ratio);
            let mut sum = 0.0;
            for (face, ratio) in faces.iter().zip(ratios) {
                let k = fault_rock_permeability(ratio, throw.abs());
                (*low, *high) = (low.min(ratio), high.max(ratio));
                let [k_low, k_high] = rock.permeability;
                rock.permeability = [k_low.min(k), k_high.max(k)];
                sum += face.area * ratio;
                area += face.area;
                // The layer is not thicker than the distance between the sites.
                let [d, e] = self.graph.connections[face.connection].distance;
                let layer = thickness.min(2.0 * d.min(e));
                let law = FaultLaw::layer(k * MILLIDARCY * layer / thickness, layer);
                face_laws.push((face.connection, law));
            }
            rock.gouge_ratio[1] = sum / area;
            fault_rocks.push(rock);
        }
        let barriers = std::mem::take(&mut self.barriers);
        self.barriers = barriers.with_face_laws(face_laws);
        Ok(fault_rocks)
    }

    /// Returns the faces of a surface with the clay of their two walls. The hanging wall is the
    /// upper one.
    fn fault_faces(&self, surface: u32, clay: &[f64]) -> Vec<FaultFace> {
        let connections = self.graph.connections.iter().enumerate();
        let on_surface =
            connections.filter(|(index, _)| self.surfaces.connection_surfaces[*index] == surface);
        let face = |(connection, c): (usize, &crate::mesh::graph::Connection<3>)| {
            let nodes = self.mesh.faces.get(c.face as usize);
            let points = nodes.iter().map(|&n| self.mesh.nodes[n as usize]);
            let mut depths = [f64::INFINITY, f64::NEG_INFINITY];
            let mut centre = [0.0; 3];
            for p in points {
                depths = [depths[0].min(-p[2]), depths[1].max(-p[2])];
                (0..3).for_each(|k| centre[k] += p[k] / nodes.len() as f64);
            }
            let [x, y, z] = c.normal;
            let horizontal = x.hypot(y);
            let upper = usize::from(z > 0.0);
            let clay = [upper, 1 - upper].map(|side| clay[c.cells[side] as usize]);
            FaultFace {
                connection,
                centre,
                strike: if horizontal > 0.0 {
                    [-y / horizontal, x / horizontal]
                } else {
                    [0.0; 2]
                },
                area: c.area,
                depths,
                clay,
            }
        };
        on_surface.map(face).collect()
    }
}

/// Returns the shale-gouge ratio of each face of one fault.
fn gouge_ratios(faces: &[FaultFace], throw: f64) -> Vec<f64> {
    // Faces are sorted along the mean strike, so that only near ones are looked at.
    let mut mean = [0.0; 2];
    let reference = faces[0].strike;
    for face in faces {
        let sign = face.area * dot(face.strike, reference).signum();
        (0..2).for_each(|k| mean[k] += sign * face.strike[k]);
    }
    let length = norm(mean).max(f64::MIN_POSITIVE);
    let position = |face: &FaultFace| dot([face.centre[0], face.centre[1]], mean) / length;
    let mut order: Vec<(f64, usize)> = (faces.iter().map(position)).zip(0..).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let area: f64 = faces.iter().map(|face| face.area).sum();
    let reach = (area / faces.len() as f64).sqrt();
    let ratio = |(face, at): (&FaultFace, f64)| {
        let depth = 0.5 * (face.depths[0] + face.depths[1]);
        // Depths of the rock that slipped past, on the hanging wall and on the footwall.
        let intervals = [[depth, depth + throw], [depth - throw, depth]];
        let intervals = intervals.map(|[a, b]| [a.min(b), a.max(b)]);
        let start = order.partition_point(|(other, _)| *other < at - 3.0 * reach);
        let near = order[start..].iter();
        let near = near.take_while(|(other, _)| *other <= at + 3.0 * reach);
        let (mut sum, mut weight) = (0.0, 0.0);
        for &(_, index) in near {
            let other = &faces[index];
            let offset = sub(other.centre, face.centre);
            if dot([offset[0], offset[1]], face.strike).abs() > reach {
                continue;
            }
            let [top, bottom] = other.depths;
            let height = (bottom - top).max(f64::MIN_POSITIVE);
            for (interval, clay) in intervals.iter().zip(other.clay) {
                let overlap = bottom.min(interval[1]) - top.max(interval[0]);
                let part = other.area * overlap.max(0.0) / height;
                sum += part * clay;
                weight += part;
            }
        }
        if weight > 0.0 {
            sum / weight
        } else {
            0.5 * (face.clay[0] + face.clay[1])
        }
    };
    faces
        .par_iter()
        .map(|face| ratio((face, position(face))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the faces of a vertical plane, 1 m wide and 1 m high, whose clay depends on the depth.
    fn faces(clay: impl Fn(f64) -> [f64; 2]) -> Vec<FaultFace> {
        let face = |n: usize| {
            let (along, depth) = ((n % 20) as f64 + 0.5, (n / 20) as f64 + 0.5);
            FaultFace {
                connection: n,
                centre: [3.0, along, -depth],
                strike: [0.0, if n.is_multiple_of(2) { 1.0 } else { -1.0 }],
                area: 1.0,
                depths: [depth - 0.5, depth + 0.5],
                clay: clay(depth),
            }
        };
        (0..20 * 40).map(face).collect()
    }

    #[test]
    fn the_gouge_ratio_is_the_mean_clay_that_slipped_past() {
        // A bed of clay from 10 to 14 m in the footwall, 8 m deeper in the hanging wall.
        let is_bed = |depth: f64| f64::from(u8::from((10.0..14.0).contains(&depth)));
        let faces = faces(|depth| [is_bed(depth - 8.0), is_bed(depth)]);
        let ratios = gouge_ratios(&faces, 8.0);
        for (face, ratio) in faces.iter().zip(&ratios) {
            let depth = -face.centre[2];
            let bed = (depth.min(14.0) - (depth - 8.0).max(10.0)).max(0.0) / 8.0;
            // Walls that reach beyond the mesh have no samples there.
            if (8.0..32.0).contains(&depth) {
                assert!((ratio - bed).abs() < 1e-12, "{depth} {ratio} {bed}");
            }
        }
        assert!(ratios.iter().any(|ratio| (ratio - 0.5).abs() < 1e-12));
        // Reverse faults move the hanging wall up.
        let mirrored = gouge_ratios(&faces, -8.0);
        assert!(
            mirrored
                .iter()
                .zip(&ratios)
                .any(|(a, b)| (a - b).abs() > 0.1)
        );
    }

    #[test]
    fn throws_of_a_table_are_converted_to_metres() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("throws.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let options = GougeOptions {
                throw: vec![FaultThrow::File(path.clone())],
                clay: None,
            };
            options.throws().map_err(|error| error.to_string())
        };
        for text in [
            "surface,throw\nFA,30.48\n",
            "surface,throw (ft)\nFA,100\n",
            "throw [cm];surface\n3048;FA\n",
        ] {
            let throws = read(text).unwrap();
            assert!((throws[0].1 / 30.48 - 1.0).abs() < 1e-12, "{text}");
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
    fn permeability_of_fault_rock_is_that_of_manzocchi() {
        // log k = -4 * 0.2 - 0.25 * log10(100) * 0.8^5
        let expected = 10f64.powf(-0.8 - 0.5 * 0.327_68);
        assert!((fault_rock_permeability(0.2, 100.0) / expected - 1.0).abs() < 1e-12);
        assert!((fault_rock_permeability(1.0, 30.0) - 1e-4).abs() < 1e-16);
    }

    #[test]
    fn uniform_clay_gives_the_transmissibility_of_a_layer() {
        use crate::mesh::poly::samples::two_cells;
        use crate::model::flow::{Rock, Tensor};
        let mut model = Model::new(two_cells::<3>(0.75), None);
        let throws = [(Selector::Number(1), 6.6)];
        let rocks = model.set_fault_rock(&[0.3, 0.3], &throws).unwrap();
        let k = fault_rock_permeability(0.3, 6.6) * MILLIDARCY;
        assert!((rocks[0].gouge_ratio[1] - 0.3).abs() < 1e-12, "{rocks:?}");
        let rock_k = 100.0 * MILLIDARCY;
        model
            .set_permeability(Rock::uniform(Tensor::isotropic(rock_k), 1.0))
            .unwrap();
        let c = &model.graph.connections[0];
        let length = c.distance[0] + c.distance[1];
        let expected = c.area / ((length - 0.1) / rock_k + 0.1 / k);
        let t = model.permeability.as_ref().unwrap().transmissibility[0];
        assert!((t / expected - 1.0).abs() < 1e-12, "{t} {expected}");
        let error = model.set_fault_rock(&[0.3, 1.5], &throws).unwrap_err();
        assert!(error.to_string().starts_with("clay: is 1.5 in cell 1"));
    }
}
