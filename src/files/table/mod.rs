//! Tables in text files: the one reader of rows and columns.
//!
//! | part of a file | what is read |
//! |---|---|
//! | separators | semicolons, tabs, commas or blanks, as most lines have them; fields may stand in double quotes |
//! | numbers | with decimal points; with decimal commas unless these may separate thousands |
//! | line ends | those of Unix, Windows and old Macs |
//! | comments | lines that begin with `#`, `!`, `@`, `%`, `//` or `--`, and lines without letters and digits |
//! | names of columns | a line of words before the first row, a comment of names before it, or the lines between `BEGIN HEADER` and `END HEADER` |
//! | units | in the names, such as `X (m)`, `Z [ft]`, `depth_m`, `MD (ftKB)`, or in a line of units after them |
//! | lines before the names | remarks, like comments |
//! | end | `EOF`, `END`, totals, and words after the last row |
//! | `>` or `->` at the start of a line | the next segment |
//! | LAS 2.0 | `~C` has the names of columns, `~A` the rows, `~W` and `~P` remarks, `NULL` the null value |
//!
//! A [`Term`] is what a column may mean, with the names by which it is known. Names are compared without
//! regard to case, blanks, underscores, hyphens and other marks.

mod dialect;
mod header;
mod las;
mod terms;
mod unit_text;
mod values;

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use dialect::{DecimalEvidence, DecimalMark, Separator};
use dialect::{is_missing, is_number, may_have_thousands, parse_number};

pub use terms::{Measure, Term, X_TERM, Y_TERM};
pub use values::{ValueTable, quantities_by_region, text_rows, values_by_region};

use crate::error::{Cause, cause, io_error};
use crate::{Error, Result, units};

/// A column of a table.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Column {
    /// The name as the file writes it, without its unit. Empty in a table without names.
    pub name: String,
    /// The unit that the file states.
    pub unit: Option<String>,
    /// The name of the term that the column's name belongs to.
    pub term: Option<&'static str>,
    /// The quantity that the term measures.
    pub measure: Measure,
    /// The text in place of a unit, if it is not understood.
    pub unknown_unit: Option<String>,
}

/// Largest number of lines that are searched for the header of an ESRI ASCII grid.
const MAX_GRID_HEADER: usize = 8;

/// First letters of Surfer grids: of text, of numbers in single and in double precision.
const SURFER_MARKS: [&str; 3] = ["dsaa", "dsbb", "dsrb"];

/// Units of angles other than degrees, in plain form.
const OTHER_ANGLES: [&str; 11] = [
    "grad", "grads", "gon", "gons", "gradian", "gradians", "rad", "rads", "radian", "radians",
    "mil",
];

/// A table of a text file.
#[derive(Debug, Clone)]
pub struct Table {
    path: PathBuf,
    text: String,
    /// The line that names the columns.
    header_line: Option<usize>,
    columns: Vec<Column>,
    lines: Vec<Line>,
    remarks: Vec<String>,
    separator: Separator,
    decimal_mark: DecimalMark,
    nulls: Vec<f64>,
}

/// A line of a table's text.
#[derive(Debug, Clone, Copy, Default)]
struct Line {
    /// Its number, from 1.
    number: usize,
    /// Its bytes in the text.
    start: usize,
    end: usize,
    /// Number of marks of segments before it.
    segment: usize,
}

impl Line {
    fn text(self, whole: &str) -> &str {
        whole[self.start..self.end].trim_matches([' ', '\r', '\u{a0}'])
    }
}

/// A row of a table.
#[derive(Debug, Clone)]
pub struct TableRow<'a> {
    table: &'a Table,
    /// The number of the line, from 1.
    pub line: usize,
    /// Number of marks of segments before the row.
    pub segment: usize,
    fields: Vec<Cow<'a, str>>,
}

/// Returns the letters and digits of a name, in lower case.
pub(crate) fn plain_name(name: &str) -> String {
    let is_part = |c: &char| c.is_alphanumeric();
    name.chars()
        .filter(is_part)
        .flat_map(char::to_lowercase)
        .collect()
}

/// Returns the text of a file: in UTF-8, with or without a byte order mark, in UTF-16 with one, or in
/// Latin-1.
fn decode(bytes: Vec<u8>) -> String {
    let wide = |decode: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = (bytes[2..].chunks_exact(2))
            .map(|pair| decode([pair[0], pair[1]]))
            .collect();
        String::from_utf16_lossy(&units)
    };
    if bytes.starts_with(&[0xff, 0xfe]) {
        return wide(u16::from_le_bytes);
    }
    if bytes.starts_with(&[0xfe, 0xff]) {
        return wide(u16::from_be_bytes);
    }
    match String::from_utf8(bytes) {
        Ok(text) => match text.strip_prefix('\u{feff}') {
            Some(rest) => rest.to_string(),
            None => text,
        },
        Err(error) => error.into_bytes().into_iter().map(char::from).collect(),
    }
}

/// Returns the text of a comment; `None` if the line is none.
fn comment_text(line: &str) -> Option<&str> {
    let line = line.trim_start();
    let has_words = line.contains(char::is_alphanumeric);
    if let Some(text) = line.strip_prefix("--") {
        return Some(text.trim_start_matches('-').trim());
    }
    let text = (line.strip_prefix("//")).or_else(|| line.strip_prefix(['#', '!', '@', '%']));
    if text.is_none() && !has_words && !line.starts_with('>') {
        return Some("");
    }
    text.map(|text| text.trim_start_matches(['#', '!', '%', '/']).trim())
}

/// Returns a line without a comment at its end.
fn without_comment(line: &str) -> &str {
    let marks = [" # ", " ! ", " // ", " -- "];
    let end = marks.iter().filter_map(|mark| line.find(mark)).min();
    end.map_or(line, |end| line[..end].trim_end())
}

/// Returns `true` if a line ends a table or sums it up.
fn is_footer(line: &str) -> bool {
    let words = [
        "eof",
        "end",
        "endoffile",
        "endofdata",
        "enddata",
        "total",
        "totals",
        "sum",
        "subtotal",
        "grandtotal",
        "mean",
        "average",
        "count",
        "rows",
        "points",
    ];
    let first = line
        .split([',', ';', '\t', ' ', ':', '='])
        .next()
        .unwrap_or("");
    words.contains(&&*plain_name(first)) || words.contains(&&*plain_name(line))
}

impl Table {
    /// Reads a table whose columns may have the meanings `terms`.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be read, and [`Error::Job`], with the line, for a text
    /// that is not a table.
    pub fn read(path: &Path, terms: &'static [Term]) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| io_error(path, "read", e))?;
        Self::parse(path, decode(bytes), terms)
    }

    /// Reads lines of fields that have no names, and of which each may have its own number of fields.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be read.
    pub fn read_lines(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| io_error(path, "read", e))?;
        let mut table = Self::empty(path, decode(bytes));
        let lines = split_lines(&table.text);
        let (content, _) = without_comments(&table.text, lines);
        let texts = content.iter().map(|line| line.text(&table.text));
        table.separator = Separator::of_lines(texts);
        table.lines = content;
        table.find_decimal_mark();
        Ok(table)
    }

    /// Reads a table from a text. `path` is its file in messages.
    ///
    /// # Errors
    /// Returns [`Error::Job`], with the line, for a text that is not a table.
    pub fn parse(path: &Path, text: String, terms: &'static [Term]) -> Result<Self> {
        let lines = split_lines(&text);
        let mut table = Self::empty(path, text);
        table.refuse_grid(&lines)?;
        if table.is_las(&lines) {
            table.parse_las(&lines, terms)?;
        } else {
            table.find_rows(lines, terms)?;
        }
        table.check_widths()?;
        Ok(table)
    }

    /// Refuses grids of heights whose lines of numbers are no rows of points.
    fn refuse_grid(&self, lines: &[Line]) -> Result<()> {
        let first_words = lines.iter().take(MAX_GRID_HEADER).map(|line| {
            let word = line.text(&self.text).split_whitespace().next();
            word.unwrap_or("").to_lowercase()
        });
        let words: Vec<String> = first_words.collect();
        let has = |word: &str| words.iter().any(|other| other == word);
        let is_surfer = (words.first())
            .is_some_and(|first| SURFER_MARKS.iter().any(|mark| first.starts_with(*mark)));
        let format = if has("ncols") && has("nrows") {
            "an ESRI ASCII grid"
        } else if is_surfer {
            "a Surfer grid"
        } else {
            return Ok(());
        };
        let problem = format!("is {format} of heights, not a table");
        let remedy = "give it as a surface, or give the rows as x y z";
        Err(self.error(problem, remedy))
    }

    fn empty(path: &Path, text: String) -> Self {
        Self {
            path: path.to_path_buf(),
            text,
            header_line: None,
            columns: Vec::new(),
            lines: Vec::new(),
            remarks: Vec::new(),
            separator: Separator::Blanks,
            decimal_mark: DecimalMark::Point,
            nulls: Vec::new(),
        }
    }

    /// Keeps the lines that are rows, and takes names, units and remarks from the others.
    fn find_rows(&mut self, lines: Vec<Line>, terms: &'static [Term]) -> Result<()> {
        let text = std::mem::take(&mut self.text);
        let (mut content, comments) = without_comments(&text, lines);
        let numeric = content.iter().map(|line| line.text(&text));
        let numeric = numeric.filter(|line| has_number(line)).count();
        let is_numeric = |line: &&Line| numeric == 0 || has_number(line.text(&text));
        let lines_of_numbers = content.iter().filter(is_numeric);
        self.separator = Separator::of_lines(lines_of_numbers.map(|line| line.text(&text)));
        let header = header::find(&text, &content, self.separator, terms);
        let before = content[..header.first_row].iter();
        let before = before.filter(|line| Some(line.number) != header.line);
        let last_comment = content
            .get(header.first_row)
            .map_or(usize::MAX, |row| row.number);
        self.remarks = before.map(|line| line.text(&text).to_string()).collect();
        (self.remarks).extend(comments.iter().map(|comment| comment.1.clone()));
        self.header_line = header.line;
        self.columns = header.columns;
        self.lines = content.split_off(header.first_row);
        self.text = text;
        self.drop_footer();
        if self.columns.is_empty() {
            let comments: Vec<&(usize, String)> =
                comments.iter().filter(|c| c.0 < last_comment).collect();
            let width = self.usual_width();
            if let Some((line, columns)) = header::from_comments(&comments, width, terms) {
                self.header_line = Some(line);
                self.columns = columns;
            } else {
                self.columns = vec![Column::default(); width];
            }
        }
        self.find_decimal_mark();
        Ok(())
    }

    fn find_decimal_mark(&mut self) {
        let mut evidence = DecimalEvidence::default();
        for line in &self.lines {
            let fields = self.separator.split(line.text(&self.text));
            fields.iter().for_each(|field| evidence.add(field));
        }
        self.decimal_mark = evidence.mark();
    }

    /// Removes what follows the last row: the words that end a table, and totals.
    fn drop_footer(&mut self) {
        let width = match self.columns.len() {
            0 => self.usual_width(),
            width => width,
        };
        let numbers = |line: &Line| {
            let fields = self.separator.split(line.text(&self.text));
            fields.iter().filter(|field| is_number(field)).count()
        };
        let usual = self.lines.first().map_or(0, numbers);
        let has_numbers = self
            .lines
            .iter()
            .any(|line| has_number(line.text(&self.text)));
        let is_end = |line: &Line| {
            let text = line.text(&self.text);
            let has_row_width = self.separator.split(text).len() == width;
            if is_footer(text) {
                !has_row_width || numbers(line) < usual
            } else {
                has_numbers && !has_row_width && !has_number(text)
            }
        };
        let mut end = self.lines.len();
        while end > 0 && is_end(&self.lines[end - 1]) {
            end -= 1;
        }
        let dropped = self.lines.split_off(end);
        (self.remarks).extend(dropped.iter().map(|line| line.text(&self.text).to_string()));
    }

    /// Returns the largest number of fields in a line with numbers that is no total, or in any line.
    fn usual_width(&self) -> usize {
        let widths = |is_row: &dyn Fn(&&str) -> bool| {
            let texts = self.lines.iter().map(|line| line.text(&self.text));
            texts
                .filter(is_row)
                .map(|text| self.separator.split(text).len())
                .max()
        };
        let of_rows = widths(&|text| has_number(text) && !is_footer(text));
        of_rows.or_else(|| widths(&|_| true)).unwrap_or(0)
    }

    /// Refuses rows that have more fields than there are columns.
    fn check_widths(&self) -> Result<()> {
        for row in self.rows() {
            let extra = row.fields.get(self.columns.len()..).unwrap_or(&[]);
            let is_short = self.separator == Separator::Blanks
                && self.has_names()
                && row.fields.len() < self.columns.len();
            if !is_short && extra.iter().all(|field| field.is_empty()) {
                continue;
            }
            let counts = [row.fields.len(), self.columns.len()];
            let problem = format!(
                "has {} fields, but the table {} columns",
                counts[0], counts[1]
            );
            let remedy = match (is_short, self.separator) {
                (true, _) => "write nan where a value is missing, or separate fields by commas",
                (_, Separator::Mark(',')) => {
                    "write decimal points, no separators of thousands, and quotes around texts with commas"
                }
                _ => "write a field for each column, and quotes around texts with separators",
            };
            return Err(row.error(problem, remedy));
        }
        Ok(())
    }

    /// Returns the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the columns.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// Returns `true` if the columns have names.
    pub fn has_names(&self) -> bool {
        self.columns.iter().any(|column| !column.name.is_empty())
    }

    /// Returns the comments, and the lines before and after the table.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// Returns the null values that the file names.
    pub fn nulls(&self) -> &[f64] {
        &self.nulls
    }

    /// Returns `true` if the table has no rows.
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    /// Returns the rows.
    pub fn rows(&self) -> impl Iterator<Item = TableRow<'_>> {
        self.lines.iter().map(|line| self.row(line))
    }

    fn row(&self, line: &Line) -> TableRow<'_> {
        let mut fields = self.separator.split(line.text(&self.text));
        let width = self.columns.len();
        // Between blanks, the words of a name without quotes are one field.
        if self.separator == Separator::Blanks && self.has_names() && fields.len() > width {
            let extra = fields.len() - width;
            let first = fields.iter().position(|field| !is_number(field));
            if let Some(first) = first.filter(|first| first + extra < fields.len()) {
                let name = fields[first..=first + extra].join(" ");
                fields.splice(first..=first + extra, [Cow::Owned(name)]);
            }
        }
        TableRow {
            table: self,
            line: line.number,
            segment: line.segment,
            fields,
        }
    }

    /// Gives columns the meanings that a user names, in place of what the file says; `_` is a column
    /// without meaning.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a name that is none of `terms`, or more names than columns.
    pub fn set_columns(&mut self, names: &[String], terms: &'static [Term]) -> Result<()> {
        if names.len() > self.columns.len() {
            let problem = format!("has {} columns, not {}", self.columns.len(), names.len());
            return Err(self.error(
                problem,
                "name as many columns, with _ for those without use",
            ));
        }
        for column in &mut self.columns {
            column.term = None;
        }
        for (index, name) in names.iter().enumerate() {
            if matches!(name.trim(), "" | "_") {
                continue;
            }
            let mut column = header::column(name, terms);
            if column.term.is_none() {
                return Err(self.unknown(&column, terms));
            }
            column.unit = column.unit.or_else(|| self.columns[index].unit.clone());
            self.columns[index] = column;
        }
        Ok(())
    }

    /// Returns the column of a term.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if two columns have this meaning and different values.
    pub fn column(&self, term: &str) -> Result<Option<usize>> {
        let has_term = |&k: &usize| self.columns[k].term == Some(term);
        let columns: Vec<usize> = (0..self.columns.len()).filter(has_term).collect();
        let [first, others @ ..] = &columns[..] else {
            return Ok(None);
        };
        for &other in others {
            if self.rows().any(|row| row.text(*first) != row.text(other)) {
                let names = [*first, other].map(|k| self.columns[k].name.as_str());
                let problem = format!(
                    "the columns '{}' and '{}' both mean {term}",
                    names[0], names[1]
                );
                let remedy = "remove or rename one of them";
                return Err(self.header_error(problem, remedy));
            }
        }
        match self.columns[*first].measure {
            Measure::Place => self.check_unit(*first)?,
            Measure::Angle => self.check_degrees(*first)?,
            Measure::Other => {}
        }
        Ok(Some(*first))
    }

    /// Refuses a column of coordinates with a unit that is not known.
    ///
    /// # Errors
    /// Returns [`Error::Job`], with the text in place of the unit.
    pub fn check_unit(&self, column: usize) -> Result<()> {
        let column = self.columns.get(column);
        match column.map(|column| (&column.name, &column.unknown_unit)) {
            Some((name, Some(text))) => {
                let problem = format!(
                    "column {name} has '{text}', which is not known as a unit of length or time"
                );
                let remedy = "write a unit such as m, ft or ms in its place, or remove it";
                Err(self.header_error(problem, remedy))
            }
            _ => Ok(()),
        }
    }

    /// Refuses a column of angles in another unit than degrees.
    fn check_degrees(&self, column: usize) -> Result<()> {
        let column = &self.columns[column];
        let text = column.unknown_unit.as_deref().unwrap_or("");
        if OTHER_ANGLES.contains(&&*plain_name(text)) {
            let problem = format!("column {} has angles in '{text}'", column.name);
            return Err(self.header_error(problem, "give angles in degrees"));
        }
        Ok(())
    }

    /// Returns the column of a term that must be there.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if no column, or more than one, has this meaning.
    pub fn required(&self, term: &Term) -> Result<usize> {
        self.column(term.name)?
            .ok_or_else(|| self.missing(&[*term]))
    }

    /// Returns the error of a table without a column for one of `terms`, which lists its names and
    /// those that are known.
    pub fn missing(&self, terms: &[Term]) -> Error {
        let names: Vec<&str> = terms.iter().map(|term| term.name).collect();
        let own: Vec<&str> = self.columns.iter().map(|column| &*column.name).collect();
        let known = terms.iter().flat_map(|term| {
            let aliases = term.aliases.iter().take(4 / terms.len());
            [term.name].into_iter().chain(aliases.copied())
        });
        let known: Vec<&str> = known.collect();
        let problem = if self.has_names() {
            format!(
                "has no column {}: its columns are {}",
                names.join(" or "),
                own.join(", ")
            )
        } else {
            format!(
                "has {} columns without names, and none is known as {}",
                own.len(),
                names.join(" or ")
            )
        };
        let remedy = format!("name a column one of {}", known.join(", "));
        self.header_error(problem, remedy)
    }

    /// Returns the error of a column whose name is none of `terms`.
    pub fn unknown(&self, column: &Column, terms: &[Term]) -> Error {
        let known: Vec<&str> = terms.iter().map(|term| term.name).collect();
        let problem = format!("'{}' is not known as the name of a column", column.name);
        self.header_error(problem, format!("give names from: {}", known.join(", ")))
    }

    /// Returns an error of the whole file.
    pub fn error(&self, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Job(self.cause(None, problem, remedy))
    }

    /// Returns an error at a line.
    pub fn error_at(
        &self,
        line: usize,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Error {
        Error::Job(self.cause(Some(line), problem, remedy))
    }

    /// Returns an error at the names of the columns.
    fn header_error(&self, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Job(self.cause(self.header_line, problem, remedy))
    }

    fn cause(
        &self,
        line: Option<usize>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Cause {
        let place = match line {
            Some(line) => format!("{}:{line}", self.path.display()),
            None => self.path.display().to_string(),
        };
        cause(place, problem.into(), remedy.into())
    }

    /// Returns the number, and the unit if there is one, of the first remark `KEY: NUMBER (UNIT)` whose
    /// key, in plain form, is one of `keys`, or ends with a long one.
    pub fn remark_value(&self, keys: &[&str]) -> Option<(f64, Option<String>)> {
        self.remarks.iter().find_map(|remark| {
            let (key, value) = remark.split_once([':', '='])?;
            let key = plain_name(key.split('(').next().unwrap_or(key));
            let is_key =
                |known: &&&str| key == **known || known.len() > 4 && key.ends_with(**known);
            keys.iter().find(is_key)?;
            let mut words = value.split(|c: char| c.is_whitespace() || "()[],;".contains(c));
            let number = words.find_map(|word| parse_number(word, DecimalMark::Comma))?;
            let unit = words.find(|word| !word.is_empty() && units::find(word).is_some());
            Some((number, unit.map(String::from)))
        })
    }

    /// Returns the text of the first remark `KEY: TEXT` with one of `keys`, in plain form.
    pub fn remark_text(&self, keys: &[&str]) -> Option<&str> {
        self.remarks.iter().find_map(|remark| {
            let (key, value) = remark.split_once([':', '='])?;
            let is_known = keys.contains(&&*plain_name(key));
            (is_known && !value.trim().is_empty()).then(|| value.trim().trim_matches('"'))
        })
    }
}

impl TableRow<'_> {
    /// Returns the number of fields.
    pub fn len(&self) -> usize {
        self.fields.len()
    }

    /// Returns `true` if the row has no fields.
    pub fn is_empty(&self) -> bool {
        self.fields.is_empty()
    }

    /// Returns the text in a column; `None` if it is empty.
    pub fn text(&self, column: usize) -> Option<&str> {
        let text = self.fields.get(column).map(|field| &**field);
        text.filter(|text| !text.is_empty())
    }

    /// Returns the number in a column; `None` if the field is empty or says that there is no value.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a field that is not a finite number.
    pub fn number(&self, column: usize) -> Result<Option<f64>> {
        let Some(text) = self.text(column) else {
            return Ok(None);
        };
        if let Some(value) = parse_number(text, self.table.decimal_mark) {
            return Ok(Some(value));
        }
        if is_missing(text) {
            return Ok(None);
        }
        let remedy = if may_have_thousands(text) {
            "write decimal points and no separators of thousands"
        } else if text.contains(',') && is_number(text) {
            "write decimal points in all numbers, or decimal commas in all"
        } else {
            "write a number, or nan where there is none"
        };
        let column = self.table.columns.get(column);
        let name = column
            .map(|column| &*column.name)
            .filter(|name| !name.is_empty());
        let place = name.map_or(String::new(), |name| format!(" in column {name}"));
        Err(self.error(format!("'{text}'{place} is not a number"), remedy))
    }

    /// Returns the numbers of all fields; `None` if one of them is no finite number.
    pub fn numbers(&self) -> Option<Vec<f64>> {
        let mark = self.table.decimal_mark;
        self.fields
            .iter()
            .map(|field| parse_number(field, mark))
            .collect()
    }

    /// Returns the fields, with decimal points in numbers.
    pub fn texts(&self) -> Vec<String> {
        let text = |field: &Cow<'_, str>| match self.table.decimal_mark {
            DecimalMark::Comma if is_number(field) => field.replace(',', "."),
            _ => field.to_string(),
        };
        self.fields.iter().map(text).collect()
    }

    /// Returns an error at the row's line.
    pub fn error(&self, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Job(self.table.cause(Some(self.line), problem, remedy))
    }
}

/// Returns `true` if a line has a number between any separators.
fn has_number(line: &str) -> bool {
    let mut words = line.split(|c: char| c.is_whitespace() || c == ';');
    words.any(|word| {
        is_number(word)
            || word
                .split(',')
                .any(|part| is_number(part.trim_matches('"')))
    })
}

/// Returns the lines that are not comments, and the comments with the numbers of their lines.
fn without_comments(text: &str, lines: Vec<Line>) -> (Vec<Line>, Vec<(usize, String)>) {
    let mut content: Vec<Line> = Vec::new();
    let mut comments: Vec<(usize, String)> = Vec::new();
    let mut segment = 0;
    for mut line in lines {
        let words = line.text(text).trim_start();
        if words.starts_with('>') || words.starts_with("->") {
            segment += 1;
        } else if let Some(comment) = comment_text(words) {
            comments.push((line.number, comment.to_string()));
        } else {
            line.end = line.start + without_comment(&text[line.start..line.end]).len();
            line.segment = segment;
            content.push(line);
        }
    }
    (content, comments)
}

/// Returns the lines that have text.
fn split_lines(text: &str) -> Vec<Line> {
    let mut lines = Vec::new();
    let (mut number, mut start) = (1, 0);
    let bytes = text.as_bytes();
    for (at, &byte) in bytes.iter().enumerate() {
        let ends = byte == b'\n' || (byte == b'\r' && bytes.get(at + 1) != Some(&b'\n'));
        if ends {
            push_line(&mut lines, text, number, start..at);
            number += 1;
            start = at + 1;
        }
    }
    push_line(&mut lines, text, number, start..text.len());
    lines
}

fn push_line(lines: &mut Vec<Line>, text: &str, number: usize, bytes: std::ops::Range<usize>) {
    if !text[bytes.clone()].trim().is_empty() {
        lines.push(Line {
            number,
            start: bytes.start,
            end: bytes.end,
            segment: 0,
        });
    }
}

#[cfg(test)]
mod tests;
