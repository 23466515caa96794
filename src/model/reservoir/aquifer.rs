//! Aquifers that analytic models describe: beyond a side of the mesh, from which water flows in as
//! the pressure drops.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

use super::Model;
use crate::error::cause;
use crate::mesh::poly::SIDE_NAMES;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, parse_number};
use crate::{Error, Result};

/// Compressibility of water and rock in 1/bar if none is given.
const DEFAULT_COMPRESSIBILITY: f64 = 9e-5;
const REMEDY: &str =
    "give a side and values, such as zmin:permeability=100,porosity=0.2,thickness=50,radius=1500";

/// The model of an aquifer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AquiferModel {
    /// Radial flow in an infinite layer (Carter and Tracy 1960).
    CarterTracy {
        /// Permeability in mD.
        permeability: f64,
        /// Porosity.
        porosity: f64,
        /// Thickness in metres.
        thickness: f64,
        /// Radius of the reservoir in metres.
        radius: f64,
        /// Angle in degrees from which water flows in.
        angle: f64,
    },
    /// Flow from a closed aquifer in equilibrium with itself (Fetkovich 1971).
    Fetkovich {
        /// Volume of water in m^3.
        volume: f64,
        /// Productivity index in m^3/day/bar.
        productivity: f64,
    },
}

/// An aquifer at a side of the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AquiferOption {
    /// The number of the side.
    pub side: u8,
    /// The model.
    pub model: AquiferModel,
    /// Compressibility of water and rock in 1/bar.
    pub compressibility: f64,
    /// Depth in metres below which cells are connected.
    pub below: Option<f64>,
    /// Depth in metres of `pressure`.
    pub datum: Option<f64>,
    /// Initial pressure in bar. By default the aquifer is in equilibrium with the reservoir.
    pub pressure: Option<f64>,
}

/// An aquifer and the cells to which it is connected.
#[derive(Debug, Clone, PartialEq)]
pub struct Aquifer {
    /// The side, the model and its values.
    pub option: AquiferOption,
    /// The cells, each with the area of its faces on the side in m^2.
    pub cells: Vec<(u32, f64)>,
    /// Outward unit normal of the side, the mean by area.
    pub normal: [f64; 3],
    /// Depth in metres of the pressure.
    pub datum: f64,
}

impl AquiferOption {
    /// Returns the value of each name that has one, in the order in which they are written.
    fn values(&self) -> Vec<(&'static str, f64)> {
        let mut values = match self.model {
            AquiferModel::CarterTracy {
                permeability,
                porosity,
                thickness,
                radius,
                angle,
            } => vec![
                ("permeability", permeability),
                ("porosity", porosity),
                ("thickness", thickness),
                ("radius", radius),
                ("angle", angle),
            ],
            AquiferModel::Fetkovich {
                volume,
                productivity,
            } => vec![("volume", volume), ("productivity", productivity)],
        };
        values.push(("compressibility", self.compressibility));
        let optional = [
            ("below", self.below),
            ("datum", self.datum),
            ("pressure", self.pressure),
        ];
        values.extend(
            optional
                .iter()
                .filter_map(|(name, value)| Some((*name, (*value)?))),
        );
        values
    }
}

impl FromStr for AquiferOption {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let (side, list) = text
            .split_once(':')
            .ok_or_else(|| InvalidValue::new("has no ':'", REMEDY))?;
        let side = SIDE_NAMES.iter().position(|name| *name == side);
        let side = side.ok_or_else(|| {
            let remedy = format!("give one of {}", SIDE_NAMES.join(", "));
            InvalidValue::new("does not begin with a side", &remedy)
        })?;
        let mut values: Vec<(&str, f64)> = Vec::new();
        for word in list.split(',') {
            let (name, value) = word
                .split_once('=')
                .ok_or_else(|| InvalidValue::new(format!("has no '=' in '{word}'"), REMEDY))?;
            values.push((name.trim(), parse_number(value, REMEDY)?));
        }
        let mut take = |name: &str| {
            let index = values.iter().position(|(known, _)| *known == name)?;
            Some(values.remove(index).1)
        };
        let missing = |name: &str| InvalidValue::new(format!("gives no {name}"), REMEDY);
        let model = match (take("volume"), take("productivity")) {
            (None, None) => AquiferModel::CarterTracy {
                permeability: take("permeability").ok_or_else(|| missing("permeability"))?,
                porosity: take("porosity").ok_or_else(|| missing("porosity"))?,
                thickness: take("thickness").ok_or_else(|| missing("thickness"))?,
                radius: take("radius").ok_or_else(|| missing("radius"))?,
                angle: take("angle").unwrap_or(360.0),
            },
            (volume, productivity) => AquiferModel::Fetkovich {
                volume: volume.ok_or_else(|| missing("volume"))?,
                productivity: productivity.ok_or_else(|| missing("productivity"))?,
            },
        };
        let option = Self {
            side: side as u8,
            model,
            compressibility: take("compressibility").unwrap_or(DEFAULT_COMPRESSIBILITY),
            below: take("below"),
            datum: take("datum"),
            pressure: take("pressure"),
        };
        if let Some((name, _)) = values.first() {
            let problem = format!("has no value called '{name}', or has it twice");
            return Err(InvalidValue::new(problem, REMEDY));
        }
        let all = option.values();
        let wrong = all.iter().find(|(name, value)| {
            let may_be_negative = ["below", "datum"].contains(name);
            *value <= 0.0 && !may_be_negative
        });
        match wrong {
            Some((name, _)) => Err(InvalidValue::new(
                format!("has a {name} that is not positive"),
                REMEDY,
            )),
            None => Ok(option),
        }
    }
}

impl Display for AquiferOption {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let values = self.values();
        let values: Vec<String> = values
            .iter()
            .map(|(name, v)| format!("{name}={v}"))
            .collect();
        write!(
            f,
            "{}:{}",
            SIDE_NAMES[usize::from(self.side)],
            values.join(",")
        )
    }
}

serde_as_text!(AquiferOption: [":"; 2]);

impl Aquifer {
    /// Finds the active cells at the side of an aquifer.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if there are none.
    pub fn new(option: AquiferOption, model: &Model) -> Result<Self> {
        let mut cells: Vec<(u32, f64)> = Vec::new();
        let (mut normal, mut area, mut depth) = ([0.0; 3], 0.0, 0.0);
        for face in &model.graph.boundary {
            let cell = face.cell as usize;
            let is_deep = option.below.is_none_or(|below| model.depth(cell) > below);
            if face.side != Some(option.side) || !is_deep || !model.is_active(cell) {
                continue;
            }
            cells.push((face.cell, face.area));
            area += face.area;
            depth += face.area * model.depth(cell);
            (0..3).for_each(|k| normal[k] += face.area * face.normal[k]);
        }
        if area <= 0.0 {
            let problem = "meets no active cell at its side, below its depth";
            let remedy = "give another side or a smaller depth";
            return Err(Error::Export(cause(
                format!("aquifer {option}"),
                problem,
                remedy,
            )));
        }
        cells.sort_by_key(|(cell, _)| *cell);
        let mut merged: Vec<(u32, f64)> = Vec::with_capacity(cells.len());
        for (cell, area) in cells {
            match merged.last_mut() {
                Some(last) if last.0 == cell => last.1 += area,
                _ => merged.push((cell, area)),
            }
        }
        Ok(Self {
            option,
            cells: merged,
            normal: normal.map(|n| n / area),
            datum: option.datum.unwrap_or(depth / area),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn aquifers_are_read_and_refused() {
        let text = "xmin:permeability=100,porosity=0.2,thickness=50,radius=1500,below=2450";
        let aquifer: AquiferOption = text.parse().unwrap();
        assert_eq!((aquifer.side, aquifer.below), (0, Some(2450.0)));
        assert_eq!(aquifer.to_string().parse(), Ok(aquifer));
        let fetkovich: AquiferOption = "zmax:volume=1e9,productivity=500".parse().unwrap();
        assert_eq!(fetkovich.to_string().parse(), Ok(fetkovich));
        for (text, expected) in [
            ("permeability=100", "has no ':'"),
            ("top:volume=1,productivity=1", "side"),
            ("xmin:volume=1", "gives no productivity"),
            ("xmin:porosity=0.2", "gives no permeability"),
            ("xmin:volume=1,productivity=1,x=3", "called 'x'"),
            (
                "xmin:volume=-1,productivity=1",
                "volume that is not positive",
            ),
        ] {
            let error = text.parse::<AquiferOption>().unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn an_aquifer_meets_the_cells_at_its_side() {
        let model = Model::new(two_cells::<3>(0.75), None);
        let option = |text: &str| text.parse::<AquiferOption>().unwrap();
        let bottom = Aquifer::new(option("zmin:volume=1,productivity=1"), &model).unwrap();
        assert_eq!(bottom.cells.len(), 2);
        let area: f64 = bottom.cells.iter().map(|cell| cell.1).sum();
        assert!((area - 2.0).abs() < 1e-12 && (bottom.normal[2] + 1.0).abs() < 1e-12);
        let right = Aquifer::new(option("xmax:volume=1,productivity=1"), &model).unwrap();
        assert_eq!(right.cells, [(1, 1.0)]);
        assert!(Aquifer::new(option("xmax:volume=1,productivity=1,below=9"), &model).is_err());
    }
}
