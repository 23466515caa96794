//! Reads corner-point grids as text: GRDECL, or the sections of a deck up to SUMMARY.
//!
//! A keyword stands at the start of a line. Its data end at a slash, `3*1.5` stands for three numbers, and
//! `--` begins a comment. What follows a slash in its line is a comment, too. Arrays that are not
//! wanted are counted and not kept.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use super::{
    BYTES_PER_CELL, FaultFaces, GridFile, GridProperty, MapFrame, NOSIM_REMEDY, PropertyFilter,
    check_dims, length_unit,
};
use crate::error::{Error, Result, cause, io_error};
use crate::memory;

/// Keywords of which one stands near the start of a file with a grid.
const MARKS: [&str; 10] = [
    "SPECGRID", "COORD", "ZCORN", "MAPAXES", "MAPUNITS", "GRIDUNIT", "RUNSPEC", "DIMENS", "PINCH",
    "COORDSYS",
];

/// Keywords without data.
const BARE: [&str; 21] = [
    "RUNSPEC", "GRID", "EDIT", "PROPS", "REGIONS", "SOLUTION", "NOECHO", "ECHO", "INIT", "OIL",
    "WATER", "GAS", "DISGAS", "VAPOIL", "UNIFOUT", "UNIFIN", "NEWTRAN", "OLDTRAN", "FMTOUT",
    "NOSIM", "NOGGF",
];

/// Keywords that change values of other keywords, each with the number of leading words that may name
/// the keyword that is changed.
const CHANGES: [(&str, usize); 14] = [
    ("EQUALS", 1),
    ("ADD", 1),
    ("MULTIPLY", 1),
    ("MINVALUE", 1),
    ("MAXVALUE", 1),
    ("COPY", 2),
    ("OPERATE", 1),
    ("OPERATER", 1),
    ("EQUALREG", 1),
    ("ADDREG", 1),
    ("MULTIREG", 1),
    ("COPYREG", 2),
    ("ADDZCORN", 0),
    ("EQLZCORN", 0),
];

/// Keywords of which each record ends with a slash, and all of them with another.
const RECORD_LISTS: [&str; 7] = [
    "MULTFLT", "MULTREGT", "NNC", "EDITNNC", "EDITNNCR", "AQUCON", "AQUNUM",
];

/// Starts of names of properties that are no labels, even if all their values are whole numbers.
const REAL_PREFIXES: [&str; 13] = [
    "PORO", "PERM", "NTG", "MULT", "SW", "SG", "SO", "PRESS", "DZ", "TRAN", "PORV", "RS", "DEPTH",
];

/// Largest number of characters of a word.
const MAX_WORD: usize = 1024;

/// Largest number of files within one another.
const MAX_INCLUDES: usize = 16;

/// Largest number of files that are included in all, so that files that include one another end.
const MAX_FILES: usize = 10_000;

/// Number of numbers from which data that end in text are a damaged array, and not a record of another kind.
const MIN_ARRAY: usize = 12;

/// Returns `true` if a text begins as a grid does: the first line that is no comment is a keyword, and a
/// keyword of grids follows.
pub(super) fn looks_like(head: &[u8]) -> bool {
    if head.contains(&0) {
        return false;
    }
    let text = String::from_utf8_lossy(head);
    let lines = text
        .lines()
        .map(|line| line.split("--").next().unwrap_or_default());
    let mut lines = lines
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .peekable();
    let begins_with_keyword = lines
        .peek()
        .is_some_and(|line| line.split_whitespace().next().is_some_and(is_keyword));
    begins_with_keyword && lines.any(|line| MARKS.contains(&line))
}

/// Returns `true` if a word can be a keyword.
fn is_keyword(word: &str) -> bool {
    word.starts_with(|c: char| c.is_ascii_alphabetic())
        && word.len() <= 32
        && word
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "_+-".contains(c))
}

/// A part of the text.
#[derive(Debug, Clone, PartialEq)]
enum Token {
    /// A word; `true` if it is the first of its line.
    Word(String, bool),
    /// A text between quotes.
    Quoted(String),
    /// The end of data.
    Slash,
    /// The end of the file.
    End,
}

/// A text file that is read token by token.
struct TokenReader {
    path: PathBuf,
    file: BufReader<File>,
    line: usize,
    /// `true` if nothing but blanks was read of the current line.
    is_line_start: bool,
}

impl TokenReader {
    fn open(path: &Path) -> Result<Self> {
        Ok(Self {
            path: path.to_path_buf(),
            file: BufReader::with_capacity(
                1 << 16,
                crate::files::open(path, "give a GRDECL file")?,
            ),
            line: 1,
            is_line_start: true,
        })
    }

    fn peek(&mut self) -> Result<Option<u8>> {
        let buffer = self.file.fill_buf();
        let buffer = buffer.map_err(|e| io_error(&self.path, "read", e))?;
        Ok(buffer.first().copied())
    }

    /// Moves on by a byte, which is `byte`.
    fn advance(&mut self, byte: u8) {
        self.file.consume(1);
        self.is_line_start = byte == b'\n' || self.is_line_start && byte.is_ascii_whitespace();
        self.line += usize::from(byte == b'\n');
    }

    fn skip_line(&mut self) -> Result<()> {
        while let Some(byte) = self.peek()? {
            if byte == b'\n' {
                break;
            }
            self.advance(byte);
        }
        Ok(())
    }

    /// Reads the next token. Words end at a slash unless `is_path`.
    fn next(&mut self, is_path: bool) -> Result<Token> {
        loop {
            let begins_line = self.is_line_start;
            let Some(byte) = self.peek()? else {
                return Ok(Token::End);
            };
            match byte {
                b'/' if !is_path => {
                    self.skip_line()?;
                    return Ok(Token::Slash);
                }
                b'\'' | b'"' => {
                    self.advance(byte);
                    let text = self.take_while(|b| b != byte && b != b'\n')?;
                    if self.peek()? == Some(byte) {
                        self.advance(byte);
                    }
                    return Ok(Token::Quoted(text));
                }
                _ if byte.is_ascii_whitespace() => self.advance(byte),
                _ => {
                    let is_end =
                        |b: u8| b.is_ascii_whitespace() || b == b'\'' || b == b'/' && !is_path;
                    let word = self.take_while(|b| !is_end(b))?;
                    if word.starts_with("--") {
                        self.skip_line()?;
                        continue;
                    }
                    return Ok(Token::Word(word, begins_line));
                }
            }
        }
    }

    fn take_while(&mut self, is_inside: impl Fn(u8) -> bool) -> Result<String> {
        let mut bytes = Vec::new();
        while let Some(byte) = self.peek()?.filter(|byte| is_inside(*byte)) {
            // What follows of an overlong word in a comment does not matter.
            if bytes.len() >= MAX_WORD && !bytes.starts_with(b"--") {
                let problem = format!("has a word of more than {MAX_WORD} characters");
                return Err(self.error(problem, "give a text file with a corner-point grid"));
            }
            if bytes.len() < MAX_WORD {
                bytes.push(byte);
            }
            self.advance(byte);
        }
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    fn error(&self, problem: impl std::fmt::Display, remedy: &str) -> Error {
        let place = format!("{}:{}", self.path.display(), self.line);
        Error::Io(cause(place, problem, remedy))
    }
}

/// A number of an array, with its repeat count.
struct Repeated {
    count: usize,
    /// `None` for a default.
    value: Option<f64>,
    is_whole: bool,
}

/// Parses `1.5`, `3*1.5` or `3*`.
fn parse_repeated(word: &str) -> Option<Repeated> {
    let (count, number) = match word.split_once('*') {
        Some((count, number)) => (count.parse().ok().filter(|n| *n > 0)?, number),
        None => (1, word),
    };
    if number.is_empty() {
        return word.ends_with('*').then_some(Repeated {
            count,
            value: None,
            is_whole: true,
        });
    }
    let value = match number.parse::<f64>() {
        Ok(value) => value,
        // Fortran writes 1.5D3.
        Err(_) => number.replace(['D', 'd'], "E").parse().ok()?,
    };
    let is_number = number.bytes().any(|b| b.is_ascii_digit());
    (is_number && value.is_finite()).then_some(Repeated {
        count,
        value: Some(value),
        is_whole: number.parse::<i64>().is_ok(),
    })
}

/// Reader of a grid.
struct GridReader<'a> {
    files: Vec<TokenReader>,
    folder: PathBuf,
    file_count: usize,
    /// A token that was read and belongs to what comes next.
    pending: Option<Token>,
    filter: PropertyFilter<'a>,
    /// The property that the user named.
    named: Option<&'a str>,
    dims: Option<([usize; 3], [usize; 2])>,
    coord: Vec<f64>,
    zcorn: Vec<f64>,
    active: Vec<bool>,
    frame: MapFrame,
    properties: Vec<GridProperty>,
    names: Vec<String>,
    faults: Vec<FaultFaces>,
    notes: Vec<String>,
    /// Keywords whose values later keywords change.
    changed: Vec<String>,
    has_block_centres: bool,
    is_in_box: bool,
}

/// Reads a grid, and the properties that `filter` accepts.
pub(super) fn read(
    path: &Path,
    filter: PropertyFilter<'_>,
    named: Option<&str>,
) -> Result<GridFile> {
    let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
    let mut reader = GridReader {
        files: vec![TokenReader::open(path)?],
        folder,
        file_count: 1,
        pending: None,
        filter,
        named,
        dims: None,
        coord: Vec::new(),
        zcorn: Vec::new(),
        active: Vec::new(),
        frame: MapFrame::default(),
        properties: Vec::new(),
        names: Vec::new(),
        faults: Vec::new(),
        notes: Vec::new(),
        changed: Vec::new(),
        has_block_centres: false,
        is_in_box: false,
    };
    while let Some(keyword) = reader.next_keyword()? {
        if matches!(keyword.as_str(), "SUMMARY" | "SCHEDULE") {
            break;
        }
        reader.read_keyword(&keyword)?;
    }
    reader.into_grid(path)
}

impl GridReader<'_> {
    /// Returns the next token; at the end of an included file, that of the file around it.
    fn next(&mut self) -> Result<Token> {
        if let Some(token) = self.pending.take() {
            return Ok(token);
        }
        while let Some(file) = self.files.last_mut() {
            match file.next(false)? {
                Token::End if self.files.len() > 1 => {
                    self.files.pop();
                }
                token => return Ok(token),
            }
        }
        Ok(Token::End)
    }

    fn error(&self, problem: impl std::fmt::Display, remedy: &str) -> Error {
        match self.files.last() {
            Some(file) => file.error(problem, remedy),
            None => Error::Io(cause("a grid", problem, remedy)),
        }
    }

    /// Returns the next keyword, and skips what is none.
    fn next_keyword(&mut self) -> Result<Option<String>> {
        loop {
            match self.next()? {
                Token::End => return Ok(None),
                Token::Word(word, true) if is_keyword(&word) => {
                    return Ok(Some(word.to_ascii_uppercase()));
                }
                _ => {}
            }
        }
    }

    /// Reads the words of a record, up to its slash. Repeated defaults are empty words.
    fn record(&mut self, keyword: &str) -> Result<Vec<String>> {
        let mut words = Vec::new();
        loop {
            match self.next()? {
                Token::Slash => return Ok(words),
                Token::End => {
                    let problem = format!("{keyword} has no slash at its end");
                    return Err(self.error(problem, crate::files::REWRITE_DAMAGED));
                }
                Token::Word(word, _) => match word.strip_suffix('*').map(str::parse::<usize>) {
                    Some(Ok(count)) if count <= MAX_WORD => {
                        words.extend(std::iter::repeat_n(String::new(), count));
                    }
                    _ => words.push(word),
                },
                Token::Quoted(text) => words.push(text),
            }
            if words.len() > MAX_WORD {
                let problem = format!("{keyword} has a record of more than {MAX_WORD} words");
                return Err(self.error(problem, "end the record with a slash"));
            }
        }
    }

    fn read_keyword(&mut self, keyword: &str) -> Result<()> {
        if let Some((_, targets)) = CHANGES.iter().find(|(name, _)| *name == keyword) {
            return self.read_changes(keyword, *targets);
        }
        match keyword {
            "SPECGRID" | "DIMENS" => self.read_dims(keyword)?,
            "COORD" => {
                let count = 6 * self.sizes(keyword)?.1[0];
                self.coord = self.array(keyword, count)?;
            }
            "ZCORN" => {
                let count = 8 * self.sizes(keyword)?.1[1];
                self.zcorn = self.array(keyword, count)?;
            }
            "ACTNUM" => {
                let count = self.sizes(keyword)?.1[1];
                if self.is_in_box {
                    self.numbers(keyword, 0, false)?;
                    self.changed.push(keyword.into());
                } else {
                    // A default (NaN) is an active cell.
                    let flags = self.cell_values(keyword, count)?.values;
                    self.active = flags.iter().map(|flag| *flag != 0.0).collect();
                }
            }
            "MAPAXES" | "MAPUNITS" | "GRIDUNIT" | "METRIC" | "FIELD" | "LAB" => {
                self.read_frame(keyword)?;
            }
            "INCLUDE" => self.include()?,
            "FAULTS" => self.read_faults()?,
            "TITLE" => {
                if let Some(file) = self.files.last_mut() {
                    file.skip_line()?;
                    file.next(false)?;
                    file.skip_line()?;
                }
            }
            "DUALPORO" | "DUALPERM" => {
                let problem = "is a model with dual porosity, which has two cells at each place";
                return Err(self.error(problem, "give the grid of a model with single porosity"));
            }
            "RADIAL" | "SPIDER" => {
                return Err(self.error("has cylindrical coordinates", NOSIM_REMEDY));
            }
            "GDFILE" => {
                let words = self.record(keyword)?;
                let file = words.first().map_or("", String::as_str);
                let problem = format!("takes its grid from the file {file}");
                return Err(self.error(problem, "give that file"));
            }
            "CARFIN" | "RADFIN" | "RADFIN4" | "REFINE" => {
                self.record(keyword)?;
                let note = "local refinements are left out: the cells in their places are those of the global grid";
                if !self.notes.iter().any(|known| known == note) {
                    self.notes.push(note.into());
                }
            }
            "BOX" => {
                self.record(keyword)?;
                self.is_in_box = true;
            }
            "ENDBOX" => self.is_in_box = false,
            "END" | "ENDINC" => {
                // The rest of the file does not count.
                if self.files.len() > 1 {
                    self.files.pop();
                } else {
                    self.files.clear();
                }
            }
            _ if BARE.contains(&keyword) => {}
            _ if RECORD_LISTS.contains(&keyword) => while !self.record(keyword)?.is_empty() {},
            _ => self.read_other(keyword)?,
        }
        Ok(())
    }

    /// Reads a keyword about units or the map.
    fn read_frame(&mut self, keyword: &str) -> Result<()> {
        match keyword {
            "MAPAXES" => {
                let axes = self.array(keyword, 6)?;
                let axes = std::array::from_fn(|n| axes[n]);
                self.notes.extend(self.frame.set_map_axes(axes));
            }
            "MAPUNITS" => {
                let words = self.record(keyword)?;
                self.frame.map_unit = self.unit(keyword, &words)?;
            }
            "GRIDUNIT" => {
                let words = self.record(keyword)?;
                self.frame.grid_unit = self.unit(keyword, &words)?;
                // The two words may stand in one quoted text.
                let last = words.iter().flat_map(|word| word.split_whitespace()).nth(1);
                self.frame.is_map_relative =
                    last.is_some_and(|word| word.eq_ignore_ascii_case("MAP"));
            }
            _ => {
                let name = match keyword {
                    "METRIC" => "METRES",
                    "FIELD" => "FEET",
                    _ => "CM",
                };
                self.frame.grid_unit = self.frame.grid_unit.or(length_unit(name).ok());
            }
        }
        Ok(())
    }

    /// Notes which keywords are changed by records such as `PORO .2 1 10 /`.
    fn read_changes(&mut self, keyword: &str, targets: usize) -> Result<()> {
        if targets == 0 {
            self.changed.push("ZCORN".into());
        }
        loop {
            let words = self.record(keyword)?;
            if words.is_empty() {
                return Ok(());
            }
            // ADDZCORN has one record, whose slash may be the only one.
            if targets == 0 {
                return Ok(());
            }
            if let Some(target) = words.get(targets - 1) {
                self.changed.push(target.to_ascii_uppercase());
            }
        }
    }

    fn read_dims(&mut self, keyword: &str) -> Result<()> {
        let words = self.record(keyword)?;
        let number = |at: usize| words.get(at).and_then(|word| word.parse::<i64>().ok());
        let (Some(nx), Some(ny), Some(nz)) = (number(0), number(1), number(2)) else {
            let problem = format!("{keyword} does not give three numbers of cells");
            return Err(self.error(problem, "write NX NY NZ 1 F /"));
        };
        if keyword == "SPECGRID" {
            if number(3).is_some_and(|sets| sets > 1) {
                return Err(self.error("has several sets of pillars (NUMRES)", NOSIM_REMEDY));
            }
            if words
                .get(4)
                .is_some_and(|word| word.eq_ignore_ascii_case("T"))
            {
                return Err(self.error("has cylindrical coordinates", NOSIM_REMEDY));
            }
        }
        let sizes = check_dims([nx, ny, nz]).map_err(|found| {
            let problem = format!("{keyword} {}", found.problem);
            self.error(problem, &found.remedy)
        })?;
        match self.dims {
            Some(known) if known != sizes => {
                let problem = format!("{keyword} differs from the numbers of cells before it");
                Err(self.error(problem, "correct SPECGRID or DIMENS"))
            }
            Some(_) => Ok(()),
            None => {
                let cells = sizes.1[1];
                self.dims = Some(sizes);
                memory::ensure_available(
                    self.files
                        .last()
                        .map_or(Path::new(""), |file| &file.path)
                        .display(),
                    BYTES_PER_CELL * cells as f64,
                    format!("a grid of {nx} x {ny} x {nz} cells"),
                    "give a part of the grid",
                )
            }
        }
    }

    fn sizes(&self, keyword: &str) -> Result<([usize; 3], [usize; 2])> {
        self.dims.ok_or_else(|| {
            let problem = format!("{keyword} comes before the numbers of cells");
            self.error(problem, "write SPECGRID in front of it: NX NY NZ 1 F /")
        })
    }

    /// Reads an array of `count` numbers, all of which must be given.
    fn array(&mut self, keyword: &str, count: usize) -> Result<Vec<f64>> {
        let values = self.cell_values(keyword, count)?.values;
        if values.iter().any(|value| value.is_nan()) {
            let problem = format!("{keyword} leaves numbers out (n*)");
            return Err(self.error(problem, "write all its numbers"));
        }
        Ok(values)
    }

    /// Reads `count` numbers, of which some may be defaults (NaN).
    fn cell_values(&mut self, keyword: &str, count: usize) -> Result<ReadNumbers> {
        let read = self.numbers(keyword, count, true)?;
        if let Some(word) = read.bad_word {
            let problem = format!("{keyword} holds '{word}', which is not a number");
            return Err(self.error(problem, "correct it, or end the numbers with a slash"));
        }
        if read.count != count {
            let needed = match self.dims {
                Some(([nx, ny, nz], _)) if keyword != "MAPAXES" => {
                    format!("{nx} x {ny} x {nz} cells need {count}")
                }
                _ => format!("it needs {count}"),
            };
            let problem = format!("{keyword} holds {} numbers, but {needed}", read.count);
            return Err(self.error(
                problem,
                "correct the numbers, or those of cells in SPECGRID",
            ));
        }
        Ok(read)
    }

    /// Reads numbers up to a slash, and keeps them if there are at most `max_count`. If `is_array`, the
    /// reading ends at the first word that is no number, or beyond `max_count` numbers.
    fn numbers(&mut self, keyword: &str, max_count: usize, is_array: bool) -> Result<ReadNumbers> {
        let mut read = ReadNumbers {
            is_whole: true,
            ..ReadNumbers::default()
        };
        loop {
            let word = match self.next()? {
                Token::Slash => return Ok(read),
                Token::End => {
                    let problem = format!("{keyword} has no slash at its end");
                    return Err(self.error(problem, "end its numbers with a slash"));
                }
                Token::Quoted(word) | Token::Word(word, _) => word,
            };
            let Some(number) = parse_repeated(&word).filter(|_| read.bad_word.is_none()) else {
                read.bad_word = read.bad_word.or(Some(word));
                read.values = Vec::new();
                if is_array {
                    return Ok(read);
                }
                continue;
            };
            read.count = read.count.saturating_add(number.count);
            read.is_whole &= number.is_whole;
            if read.count <= max_count {
                let value = number.value.unwrap_or(f64::NAN);
                read.values.extend(std::iter::repeat_n(value, number.count));
            } else if is_array {
                return Ok(read);
            }
        }
    }

    /// Returns the unit that the first word names; `None` without a word.
    fn unit(&self, keyword: &str, words: &[String]) -> Result<Option<crate::units::Unit>> {
        let name = words
            .first()
            .and_then(|text| text.split_whitespace().next());
        let unit = name.map(length_unit).transpose();
        unit.map_err(|found| {
            let problem = format!("{keyword} {}", found.problem);
            self.error(problem, &found.remedy)
        })
    }

    /// Continues with the file that INCLUDE names, relative to the first file's folder.
    fn include(&mut self) -> Result<()> {
        let Some(file) = self.files.last_mut() else {
            return Ok(());
        };
        let name = match file.next(true)? {
            Token::Word(name, _) | Token::Quoted(name) => name,
            Token::Slash | Token::End => String::new(),
        };
        if name.is_empty() {
            return Err(self.error(
                "INCLUDE names no file",
                "write INCLUDE, and 'FILE' / below it",
            ));
        }
        file.skip_line()?;
        if self.files.len() >= MAX_INCLUDES || self.file_count >= MAX_FILES {
            let problem = format!("includes {name} within too many other files");
            return Err(self.error(problem, "check whether files include one another"));
        }
        // Decks that are written on Windows have backslashes in names.
        let given = self.folder.join(&name);
        let path = if given.exists() {
            given
        } else {
            self.folder.join(name.replace('\\', "/"))
        };
        let included = TokenReader::open(&path).map_err(|error| {
            let problem = format!(
                "includes {name}, which cannot be read: {}",
                error.cause().problem
            );
            self.error(problem, "put the file there, or correct its name")
        })?;
        self.files.push(included);
        self.file_count += 1;
        Ok(())
    }

    fn read_faults(&mut self) -> Result<()> {
        let dims = self.sizes("FAULTS")?.0;
        loop {
            let words = self.record("FAULTS")?;
            if words.is_empty() {
                return Ok(());
            }
            let faces = fault_faces(&words, dims).ok_or_else(|| {
                let problem = format!("FAULTS has the record '{}'", words.join(" "));
                self.error(
                    problem,
                    "write NAME I1 I2 J1 J2 K1 K2 FACE / within the grid",
                )
            })?;
            self.faults.push(faces);
        }
    }

    /// Reads an array of cells, or skips a keyword of another kind.
    fn read_other(&mut self, keyword: &str) -> Result<()> {
        let token = self.next()?;
        let is_number = matches!(&token, Token::Word(word, _) if parse_repeated(word).is_some());
        if !is_number {
            // The next keyword may follow at once.
            self.pending = (token != Token::Slash).then_some(token);
            return Ok(());
        }
        self.pending = Some(token);
        self.has_block_centres |= matches!(keyword, "DX" | "DY" | "DXV" | "DYV" | "TOPS");
        if self.is_in_box {
            self.changed.push(keyword.into());
        }
        let is_named = self.named == Some(keyword) && !self.is_in_box;
        let is_wanted = is_named || (self.filter)(keyword);
        let cells = self.dims.map_or(0, |(_, [_, cells])| cells);
        let read = if is_named {
            self.cell_values(keyword, self.sizes(keyword)?.1[1])?
        } else {
            let kept = if is_wanted { cells } else { 0 };
            // Records of other keywords may hold words.
            let read = self.numbers(keyword, kept, false)?;
            let bad_word = read.bad_word.as_ref();
            if let Some(word) = bad_word.filter(|_| is_wanted && read.count >= MIN_ARRAY) {
                self.notes.push(format!(
                    "{keyword} is left out, as it holds '{word}', which is not a number"
                ));
            }
            if read.bad_word.is_some() || read.count != cells || self.is_in_box {
                return Ok(());
            }
            read
        };
        if !self.names.iter().any(|name| name == keyword) {
            self.names.push(keyword.into());
        }
        if is_wanted {
            let is_real = REAL_PREFIXES
                .iter()
                .any(|prefix| keyword.starts_with(prefix));
            self.properties.retain(|known| known.name != keyword);
            self.properties.push(GridProperty {
                name: keyword.into(),
                values: read.values,
                is_whole: read.is_whole && !is_real,
            });
        }
        Ok(())
    }

    fn into_grid(mut self, path: &Path) -> Result<GridFile> {
        let refuse =
            |problem: String, remedy: &str| Err(Error::Io(cause(path.display(), problem, remedy)));
        let Some(([nx, ny, nz], _)) = self.dims else {
            let problem = "does not say how many cells it has";
            return refuse(
                problem.into(),
                "write SPECGRID in front of COORD: NX NY NZ 1 F /",
            );
        };
        for (name, array) in [("COORD", &self.coord), ("ZCORN", &self.zcorn)] {
            if array.is_empty() {
                return if self.has_block_centres {
                    let problem = "is no corner-point grid, but one of blocks (DX, DY, DZ, TOPS)";
                    refuse(problem.into(), NOSIM_REMEDY)
                } else {
                    refuse(
                        format!("has no {name}"),
                        "give the file with it, or a deck that includes all",
                    )
                };
            }
        }
        for name in ["COORD", "ZCORN", "ACTNUM"] {
            if self.changed.iter().any(|changed| changed == name) {
                let problem = format!("changes {name} by other keywords, such as EQUALS");
                return refuse(problem, NOSIM_REMEDY);
            }
        }
        let is_changed = |name: &str| self.changed.iter().any(|changed| changed == name);
        if let Some(name) = self.named.filter(|name| is_changed(name)) {
            let problem = format!("changes {name} by other keywords, such as EQUALS or BOX");
            return refuse(problem, NOSIM_REMEDY);
        }
        let dropped: Vec<String> = (self.names.iter())
            .filter(|name| is_changed(name))
            .cloned()
            .collect();
        if !dropped.is_empty() {
            self.notes.push(format!(
                "{} are left out, as other keywords (such as EQUALS) change them: {NOSIM_REMEDY}",
                dropped.join(", ")
            ));
            self.names.retain(|name| !dropped.contains(name));
            self.properties
                .retain(|property| !dropped.contains(&property.name));
        }
        Ok(GridFile {
            path: path.to_path_buf(),
            kind: "GRDECL",
            dims: [nx, ny, nz],
            coord: self.coord,
            zcorn: self.zcorn,
            active: self.active,
            frame: self.frame,
            properties: self.properties,
            property_names: self.names,
            faults: self.faults,
            notes: self.notes,
        })
    }
}

/// Numbers up to a slash.
#[derive(Default)]
struct ReadNumbers {
    /// The numbers that are kept; NaN for defaults.
    values: Vec<f64>,
    /// Number of all numbers.
    count: usize,
    /// `true` if all are whole numbers.
    is_whole: bool,
    /// The first word that is no number.
    bad_word: Option<String>,
}

/// Parses a record of FAULTS. Returns `None` if it is incomplete or lies outside the grid.
fn fault_faces(words: &[String], dims: [usize; 3]) -> Option<FaultFaces> {
    let number = |at: usize| words.get(at)?.parse::<usize>().ok();
    let mut cells = [[0; 2]; 3];
    for (axis, range) in cells.iter_mut().enumerate() {
        let (first, last) = (number(1 + 2 * axis)?, number(2 + 2 * axis)?);
        if first < 1 || first > last || last > dims[axis] {
            return None;
        }
        *range = [first - 1, last - 1];
    }
    let face = words.get(7)?.to_ascii_uppercase();
    let axis = match face.trim_end_matches(['+', '-']) {
        "X" | "I" => 0,
        "Y" | "J" => 1,
        "Z" | "K" => 2,
        _ => return None,
    };
    Some(FaultFaces {
        name: words.first()?.clone(),
        cells,
        axis,
        is_upper: !face.ends_with('-'),
    })
}
