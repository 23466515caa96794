//! The options of `atomesh edit`, as one value.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::{AtomChange, Edit};
use crate::error::cause;
use crate::files::output::check_output;
use crate::files::table::Table;
use crate::image::formats::InputOptions;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, PointValue};
use crate::{Error, Result};

const POINT_REMEDY: &str = "give a point such as 1500,2000,300 (1500,2000 in 2-D)";
const ATOM_REMEDY: &str = "give the number of a point of the mesh, as ParaView shows it";
const MOVE_REMEDY: &str = "give an atom and its new place such as 812:1500,2000,300";

/// Options of `atomesh edit`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct EditSpec {
    /// A new atom, in the image's physical coordinates (X,Y in 2-D). This and the other edits may
    /// be repeated
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub add: Vec<PointValue>,
    /// Move atom N to X,Y,Z. N is the number of a point of the mesh as ParaView shows it, or of a
    /// cell for Voronoi cells
    #[arg(long = "move", value_name = "N:X,Y,Z", allow_hyphen_values = true)]
    #[serde(rename = "move")]
    pub moves: Vec<AtomMove>,
    /// Remove atom N
    #[arg(long, value_name = "N")]
    pub remove: Vec<AtomNumber>,
    /// A CSV file of edits, one per line: add,X,Y,Z or move,N,X,Y,Z or remove,N
    #[arg(long, value_name = "FILE.csv")]
    pub edits: Option<PathBuf>,
    /// Let added and moved atoms move like all others. By default they stay in place, as wells do
    #[arg(long)]
    pub free: bool,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// The number of an atom.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AtomNumber(pub u32);

impl FromStr for AtomNumber {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let number = text.trim().parse().map(Self);
        number.map_err(|_| InvalidValue::new("does not name an atom", ATOM_REMEDY))
    }
}

impl Display for AtomNumber {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// An atom and its new place, in physical coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct AtomMove {
    /// The atom.
    pub atom: AtomNumber,
    /// Its new place.
    pub target: PointValue,
}

impl FromStr for AtomMove {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let (atom, target) =
            (text.split_once(':')).ok_or_else(|| InvalidValue::new("has no colon", MOVE_REMEDY))?;
        Ok(Self {
            atom: atom.parse()?,
            target: (target.parse())
                .map_err(|_| InvalidValue::new("has no new place", MOVE_REMEDY))?,
        })
    }
}

impl Display for AtomMove {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.atom, self.target)
    }
}

serde_as_text!(AtomNumber: [","; 2], AtomMove: [",", ":"]);

impl EditSpec {
    /// Checks that there is an edit, and that the output replaces no input.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, mesh: &Path, image: &Path, output: &Path) -> Result<()> {
        let mut inputs = vec![mesh, image];
        inputs.extend(self.edits.as_deref());
        check_output(output, "--output", &["vtu"], &inputs)?;
        self.validate()
    }

    /// Checks that there is an edit.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there is none.
    pub fn validate(&self) -> Result<()> {
        self.input.refuse_label_table()?;
        let has_edit = !(self.add.is_empty() && self.moves.is_empty() && self.remove.is_empty());
        if has_edit || self.edits.is_some() {
            return Ok(());
        }
        Err(nothing_to_do())
    }

    /// Returns all edits: `add`, `move`, `remove`, then those of the file.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a point that does not have `D` coordinates, and the errors of
    /// reading the file.
    pub(super) fn edits<const D: usize>(&self) -> Result<Vec<Edit<D>>> {
        let mut edits = Vec::new();
        for point in &self.add {
            edits.push(Edit {
                name: format!("--add {point}"),
                change: AtomChange::Add(point.coordinates("add", POINT_REMEDY)?),
            });
        }
        for moved in &self.moves {
            let target = moved.target.coordinates("move", POINT_REMEDY)?;
            edits.push(Edit {
                name: format!("--move {moved}"),
                change: AtomChange::Move(moved.atom.0, target),
            });
        }
        for atom in &self.remove {
            edits.push(Edit {
                name: format!("--remove {atom}"),
                change: AtomChange::Remove(atom.0),
            });
        }
        if let Some(path) = &self.edits {
            edits.extend(read_edits(path)?);
        }
        if edits.is_empty() {
            return Err(nothing_to_do());
        }
        Ok(edits)
    }
}

fn nothing_to_do() -> Error {
    let remedy = "give --add, --move, --remove or --edits";
    Error::Job(cause("atomesh edit", "has nothing to do", remedy))
}

/// Reads edits from a table, one in each line.
fn read_edits<const D: usize>(path: &Path) -> Result<Vec<Edit<D>>> {
    let mut edits = Vec::new();
    for row in Table::read_lines(path)?.rows() {
        let line = row.texts().join(",");
        let line = line.trim_end_matches(',');
        let place = format!("{}:{}", path.display(), row.line);
        let refuse = |problem: String, remedy: &str| Error::Job(cause(&place, problem, remedy));
        let atom = |text: &str| {
            let atom = text.parse::<AtomNumber>();
            atom.map_err(|e| refuse(format!("'{text}' {}", e.problem), &e.remedy))
        };
        let point = |text: &str| {
            let point = text.parse::<PointValue>();
            let point =
                point.map_err(|e| refuse(format!("'{text}' {}", e.problem), POINT_REMEDY))?;
            point.coordinates::<D>(&place, POINT_REMEDY)
        };
        let (verb, rest) = line.split_once(',').unwrap_or((line, ""));
        let change = match verb.trim().to_ascii_lowercase().as_str() {
            "add" => AtomChange::Add(point(rest)?),
            "remove" => AtomChange::Remove(atom(rest)?.0),
            "move" => {
                let (node, target) = rest.split_once(',').unwrap_or((rest, ""));
                AtomChange::Move(atom(node)?.0, point(target)?)
            }
            _ => {
                let remedy = "write add,X,Y,Z or move,N,X,Y,Z or remove,N";
                return Err(refuse(format!("'{line}' is not an edit"), remedy));
            }
        };
        let name = format!("{place}: {line}");
        edits.push(Edit { name, change });
    }
    Ok(edits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edits_are_read_from_texts_lists_and_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("e.csv");
        std::fs::write(&path, "# edits\nadd,7,8,9\n\nMove, 5, 1,1,2\nremove,3\n").unwrap();
        let json = r#"{"add": [[1, 2, 3]], "move": [[812, [4, 5, 6]]], "remove": [9, "10"]}"#;
        let mut spec: EditSpec = serde_json::from_str(json).unwrap();
        spec.edits = Some(path.clone());
        spec.validate().unwrap();
        let edits = spec.edits::<3>().unwrap();
        let names: Vec<&str> = edits.iter().map(|edit| edit.name.as_str()).collect();
        assert_eq!(
            names[..3],
            ["--add 1,2,3", "--move 812:4,5,6", "--remove 9"]
        );
        let changes: Vec<_> = edits[4..].iter().map(|edit| edit.change).collect();
        let expected = [
            AtomChange::Add([7.0, 8.0, 9.0]),
            AtomChange::Move(5, [1.0, 1.0, 2.0]),
            AtomChange::Remove(3),
        ];
        assert_eq!(changes, expected);
        for (text, expected) in [
            ("add,1,2", "e.csv:1 1,2: has 2 values, not 3"),
            ("remove,x", "e.csv:1: 'x' does not name an atom"),
            ("jump,1", "e.csv:1: 'jump,1' is not an edit"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = spec.edits::<3>().unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn impossible_edits_are_refused_by_name() {
        let error = EditSpec::default().validate().unwrap_err().to_string();
        assert!(error.contains("nothing to do"), "{error}");
        let spec: EditSpec = serde_json::from_str(r#"{"add": ["1,2"]}"#).unwrap();
        let error = spec.edits::<3>().unwrap_err().to_string();
        assert!(error.starts_with("add 1,2: has 2 values, not 3"), "{error}");
        for text in ["7", "7:1", "x:1,2,3"] {
            assert!(text.parse::<AtomMove>().is_err(), "{text}");
        }
    }
}
