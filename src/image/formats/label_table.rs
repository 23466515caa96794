//! Tables of names of labels: of ITK-SNAP, FreeSurfer and 3D Slicer, and plain tables of values and names.
//!
//! - ITK-SNAP: `1 255 0 0 1 1 1 "bone"`, the label descriptions that it saves as `.label` or `.txt`
//! - FreeSurfer and 3D Slicer (`.ctbl`, `.txt`): `1 bone 255 0 0 255`
//! - Tables with commas, semicolons or tabs (`.csv`, `.tsv`), with a line of column names such as
//!   `LabelValue,Name` of 3D Slicer, or without one: `1,bone`
//!
//! Lines that begin with `#` are comments. Names stay as they are written.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::packed::file_error;
use crate::error::{Error, Result, cause, io_error};
use crate::files::{self, atomic_write};
use crate::image::LabelValue;
use crate::names;

/// Largest size of a table, in bytes.
const MAX_TABLE_BYTES: u64 = 1 << 24;

/// Endings of tables that are looked for beside an image.
const TABLE_EXTENSIONS: [&str; 6] = ["label", "ctbl", "lut", "txt", "csv", "tsv"];

/// Names of the column of values, in lower case without spaces and `_`.
const VALUE_COLUMNS: [&str; 9] = [
    "labelvalue",
    "value",
    "label",
    "index",
    "idx",
    "id",
    "no.",
    "no",
    "labelid",
];

/// Names of the column of names, in lower case without spaces and `_`.
const NAME_COLUMNS: [&str; 8] = [
    "name",
    "labelname",
    "segmentname",
    "structure",
    "region",
    "description",
    "segment",
    "labeldescription",
];

/// The values of labels and their names.
pub type LabelNames = Vec<(LabelValue, String)>;

/// A table, and whether its form is that of labels alone.
struct Table {
    names: LabelNames,
    /// `true` if the form of the lines, or the names of its columns, are those of a table of labels.
    is_certain: bool,
}

/// Reads a table of names.
///
/// # Errors
/// Returns an [`Error::Io`] that names the line if the file is no table of labels, or if it names a label
/// twice.
pub fn read(path: &Path) -> Result<LabelNames> {
    let text = read_text(path)?;
    parse(&text).map(|table| table.names).map_err(|problem| {
        let remedy = "give a table of values and names, such as value,name in .csv, or one of ITK-SNAP, FreeSurfer or 3D Slicer";
        Error::Io(cause(path.display(), problem, remedy))
    })
}

/// Returns the text of a table.
fn read_text(path: &Path) -> Result<String> {
    let file = files::open(path, "give a table of labels, or none")?;
    let mut bytes = Vec::new();
    file.take(MAX_TABLE_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| io_error(path, "read", e))?;
    if bytes.len() as u64 > MAX_TABLE_BYTES {
        let problem =
            format!("has more than {MAX_TABLE_BYTES} bytes, too many for a table of labels");
        return Err(file_error(
            path,
            problem,
            "give a table of values and names",
        ));
    }
    Ok(String::from_utf8_lossy(&bytes)
        .trim_start_matches('\u{feff}')
        .to_string())
}

/// Returns the only table of labels beside an image that has the same name but for its ending, and its
/// names. Plain tables without the names of their columns are not taken for one.
pub fn companion_table(image: &Path) -> Option<(PathBuf, LabelNames)> {
    let name = image.file_name()?.to_str()?;
    let lower = name.to_lowercase();
    let endings = [".nii.gz", ".seg.nrrd", ".ome.tif", ".ome.tiff", ".inr.gz"];
    let long = endings.iter().find(|ending| lower.ends_with(**ending));
    let stem = match long {
        Some(ending) => name.get(..name.len() - ending.len())?,
        None => image.file_stem()?.to_str()?,
    };
    let is_table = |ending: &&str| {
        let path = image.with_file_name(format!("{stem}.{ending}"));
        if path == image || !path.is_file() {
            return None;
        }
        let table = parse(&read_text(&path).ok()?).ok()?;
        table.is_certain.then_some((path, table.names))
    };
    let mut tables = TABLE_EXTENSIONS.iter().filter_map(is_table);
    let first = tables.next()?;
    tables.next().is_none().then_some(first)
}

/// Writes a table with the columns value and name.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be written.
pub fn write(path: &Path, names: &[(LabelValue, String)]) -> Result<()> {
    let separator = if super::extension(path) == "tsv" {
        b'\t'
    } else {
        b','
    };
    atomic_write(path, |out| {
        let mut writer = csv::WriterBuilder::new()
            .delimiter(separator)
            .from_writer(out);
        writer.write_record(["value", "name"])?;
        for (value, name) in names {
            writer.write_record([&value.to_string(), name])?;
        }
        Ok(writer.flush()?)
    })
}

/// Returns a note on the names of a table.
pub fn note(path: &Path, names: &[(LabelValue, String)], is_found: bool) -> String {
    let place = path.display();
    let count = names.len();
    if is_found {
        format!(
            "{count} names of labels are read from {place}, which lies beside the image (--label-table none: they are not)"
        )
    } else {
        format!("{count} names of labels are read from {place}")
    }
}

/// Parses a table. The error is the problem.
fn parse(text: &str) -> std::result::Result<Table, String> {
    let lines = || {
        let numbered = text
            .lines()
            .enumerate()
            .map(|(k, line)| (k + 1, line.trim()));
        numbered.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
    };
    let Some((_, first)) = lines().next() else {
        return Err("has no label".into());
    };
    let described = snap_line(first).is_some();
    let colored = color_line(first).is_some();
    let rows: Vec<(usize, LabelValue, String)> = if described || colored {
        let parse_line = if described { snap_line } else { color_line };
        let row = |(number, line): (usize, &str)| {
            let (value, name) = parse_line(line)
                .ok_or_else(|| format!("line {number} is no label as those before it: {line}"))?;
            Ok((number, value, name))
        };
        lines()
            .map(row)
            .collect::<std::result::Result<_, String>>()?
    } else {
        return delimited(text);
    };
    Ok(Table {
        names: distinct(rows)?,
        is_certain: true,
    })
}

/// Returns label and name of a line of ITK-SNAP: a value, six numbers and a name in quotes.
fn snap_line(line: &str) -> Option<(LabelValue, String)> {
    let (numbers, name) = line.strip_suffix('"')?.split_once('"')?;
    let mut words = numbers.split_whitespace();
    let value = LabelValue::parse(words.next()?)?;
    let rest: Option<Vec<f64>> = words.map(|word| word.parse().ok()).collect();
    (rest?.len() == 6).then(|| (value, names::from_file(name)))
}

/// Returns label and name of a line of FreeSurfer or 3D Slicer: a value, a name, and three or four
/// numbers of a colour.
fn color_line(line: &str) -> Option<(LabelValue, String)> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [value, name, color @ ..] = &words[..] else {
        return None;
    };
    let value = LabelValue::parse(value)?;
    let is_color = matches!(color.len(), 3 | 4) && color.iter().all(|c| c.parse::<f64>().is_ok());
    (is_color && name.parse::<f64>().is_err()).then(|| (value, names::from_file(name)))
}

/// Parses a table with separators.
fn delimited(text: &str) -> std::result::Result<Table, String> {
    let head = text
        .lines()
        .find(|line| !line.trim().is_empty() && !line.starts_with('#'));
    let head = head.unwrap_or_default();
    let separators = [b'\t', b',', b';'];
    let Some(separator) = separators
        .into_iter()
        .find(|&c| head.as_bytes().contains(&c))
    else {
        return Err(format!("is no table of labels: its first line is {head}"));
    };
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .delimiter(separator)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let mut columns: Option<[usize; 2]> = None;
    let mut is_certain = false;
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| format!("is no table of labels: {e}"))?;
        let number = record
            .position()
            .map_or(0, |position| position.line() as usize);
        let field = |k: usize| record.get(k).unwrap_or_default();
        if record.iter().all(str::is_empty) {
            continue;
        }
        let Some([value, name]) = columns else {
            let found = header_columns(&record);
            is_certain = found.is_some();
            columns = Some(found.unwrap_or([0, 1]));
            if found.is_none() {
                let value = LabelValue::parse(field(0)).ok_or_else(|| {
                    format!("line {number} names no columns such as value,name, and is no label")
                })?;
                rows.push((number, value, names::from_file(field(1))));
            }
            continue;
        };
        let label = LabelValue::parse(field(value)).ok_or_else(|| {
            format!(
                "line {number} has '{}' for the value of a label",
                field(value)
            )
        })?;
        rows.push((number, label, names::from_file(field(name))));
    }
    Ok(Table {
        names: distinct(rows)?,
        is_certain,
    })
}

/// Returns the columns of values and names, if these are the names of columns.
fn header_columns(record: &csv::StringRecord) -> Option<[usize; 2]> {
    let fields: Vec<String> = record
        .iter()
        .map(|field| field.to_lowercase().replace([' ', '_', '"'], ""))
        .collect();
    let find = |names: &[&str]| {
        let mut places = names
            .iter()
            .filter_map(|name| fields.iter().position(|f| f == name));
        places.next()
    };
    let columns = [find(&VALUE_COLUMNS)?, find(&NAME_COLUMNS)?];
    (columns[0] != columns[1]).then_some(columns)
}

/// Returns the labels of a table, none of which has two names. Labels without a name are left out.
fn distinct(rows: Vec<(usize, LabelValue, String)>) -> std::result::Result<LabelNames, String> {
    let mut names: LabelNames = Vec::new();
    let mut known = std::collections::BTreeMap::new();
    for (line, value, name) in rows {
        if name.is_empty() {
            continue;
        }
        if name.chars().any(char::is_control) {
            return Err(format!("line {line} has a name with a control character"));
        }
        match known.insert(value.to_string(), name.clone()) {
            None => names.push((value, name)),
            Some(other) if other == name => {}
            Some(other) => {
                return Err(format!(
                    "line {line} names label {value} '{name}', which is '{other}' above"
                ));
            }
        }
    }
    if names.is_empty() {
        return Err("has no label with a name".into());
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: &str) -> Vec<(String, String)> {
        let table = parse(text).unwrap();
        table
            .names
            .into_iter()
            .map(|(value, name)| (value.to_string(), name))
            .collect()
    }

    fn pairs(expected: &[(&str, &str)]) -> Vec<(String, String)> {
        expected
            .iter()
            .map(|(a, b)| ((*a).to_string(), (*b).to_string()))
            .collect()
    }

    #[test]
    fn tables_of_other_programs_give_values_and_names() {
        let snap = "# ITK-SnAP Label Description File\n#\n    0     0    0    0        0  0  0    \"Clear Label\"\n    4   255    0    0        1  1  1    \"left lung, upper\"\n";
        assert_eq!(
            names(snap),
            pairs(&[("0", "Clear Label"), ("4", "left lung, upper")])
        );
        let freesurfer = "#No. Label Name:   R G B A\n\n17  Left-Hippocampus   220 216 20 0\n18\tLeft-Amygdala 103 255 255 0\n";
        assert_eq!(
            names(freesurfer),
            pairs(&[("17", "Left-Hippocampus"), ("18", "Left-Amygdala")])
        );
        let slicer = "# Color table file /tmp/a.ctbl\n# 2 values\n1 upper_bone 241 214 145 255\n2 tooth .9 .9 .8 1\n";
        assert_eq!(names(slicer), pairs(&[("1", "upper_bone"), ("2", "tooth")]));
        let terminology = "LabelValue,Name,Color_R,Color_G,Color_B,Color_A,CategoryCode\n1,\"bone, cortical\",1,2,3,255,\n3,skin,1,2,3,255,\n";
        assert_eq!(
            names(terminology),
            pairs(&[("1", "bone, cortical"), ("3", "skin")])
        );
        assert_eq!(
            names("1;Knochen\n2;Haut\n"),
            pairs(&[("1", "Knochen"), ("2", "Haut")])
        );
        assert_eq!(names("name\tid\nbone\t7\n"), pairs(&[("7", "bone")]));
        assert_eq!(names("1,bone,#ff0000\n2,,\n"), pairs(&[("1", "bone")]));
    }

    #[test]
    fn what_is_no_table_names_its_line() {
        for (text, expected) in [
            ("", "no label"),
            ("bone is hard\n", "first line is bone is hard"),
            (
                "1,bone\n2,skin\n1,tooth\n",
                "line 3 names label 1 'tooth', which is 'bone'",
            ),
            ("value,name\nx,bone\n", "line 2 has 'x'"),
            ("x,bone\n", "line 1 names no columns"),
            ("1 bone 1 2 3 4\n2 skin\n", "line 2 is no label"),
            ("value,name\n3,\n", "no label with a name"),
        ] {
            let Err(problem) = parse(text) else {
                panic!("{text} is read as a table");
            };
            assert!(
                problem.contains(expected),
                "{problem} (expected: {expected})"
            );
        }
    }

    #[test]
    fn the_only_certain_table_beside_an_image_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let image = path("scan.nii.gz");
        assert_eq!(companion_table(&image), None);
        std::fs::write(path("scan.csv"), "1,bone\n").unwrap();
        assert_eq!(
            companion_table(&image),
            None,
            "columns without names may be anything"
        );
        std::fs::write(path("scan.csv"), "label,name\n1,bone\n").unwrap();
        assert_eq!(
            companion_table(&image).unwrap().1,
            [(LabelValue::Whole(1), "bone".into())]
        );
        std::fs::write(path("scan.txt"), "1 skin 1 2 3 4\n").unwrap();
        assert_eq!(companion_table(&image), None, "two tables are ambiguous");
    }

    #[test]
    fn a_written_table_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let names = vec![
            (LabelValue::Whole(1 << 60), "a, \"b\"".to_string()),
            (LabelValue::Whole(-3), "\u{e4}".to_string()),
        ];
        for name in ["a.csv", "a.tsv"] {
            let path = folder.path().join(name);
            write(&path, &names).unwrap();
            assert_eq!(read(&path).unwrap(), names);
        }
    }
}
