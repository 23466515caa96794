//! Names and units of columns.

use super::dialect::{Separator, is_number};
use super::unit_text::UnitText;
use super::{Column, Line, Measure, Term, has_number, plain_name};
use crate::geometry::statistics::upper_median;
use crate::units;

/// The names of a table's columns, and where its rows begin.
pub(super) struct Header {
    /// The line that has the names.
    pub line: Option<usize>,
    /// The columns; none if no line names them.
    pub columns: Vec<Column>,
    /// Index of the first line that is a row.
    pub first_row: usize,
}

/// Largest number of lines, besides comments, before the names of columns.
const MAX_LINES_BEFORE_NAMES: usize = 100;

/// Largest number of words of a unit without brackets, with the level that it is measured from.
const MAX_UNIT_WORDS: usize = 5;

/// First words of lines that a program writes before its table, together with numbers.
const PREAMBLES: [&str; 4] = ["version", "ffasci", "fsasci", "ffattr"];

/// Returns the names of the columns of the table in these lines of a text.
pub(super) fn find(
    text: &str,
    lines: &[Line],
    separator: Separator,
    terms: &'static [Term],
) -> Header {
    let is_word = |line: &Line, word: &str| plain_name(line.text(text)) == word;
    let begin = lines.iter().position(|line| is_word(line, "beginheader"));
    let end = lines.iter().position(|line| is_word(line, "endheader"));
    if let (Some(begin), Some(end)) = (begin, end.filter(|&end| begin < Some(end))) {
        let block = &lines[begin + 1..end];
        let columns = block
            .iter()
            .map(|line| typed_column(line.text(text), terms));
        return Header {
            line: Some(lines[begin].number),
            columns: columns.collect(),
            first_row: end + 1,
        };
    }
    let (first, width) = first_row(text, lines, separator);
    let mut named: Option<(usize, Vec<Column>, usize)> = None;
    for (at, line) in lines.iter().enumerate().take(MAX_LINES_BEFORE_NAMES) {
        let Some((columns, known)) = names(line.text(text), separator, width, terms) else {
            continue;
        };
        // Names in another number than fields are of another line's.
        let rank = known + columns.len() * usize::from(columns.len() == width);
        let is_header = known >= 2 || known == columns.len();
        if is_header && named.as_ref().is_none_or(|named| named.2 < rank) {
            named = Some((at, columns, rank));
        }
    }
    let named = named.map(|(at, columns, _)| (at, columns)).or_else(|| {
        let at = first.checked_sub(1)?;
        let (columns, _) = names(lines[at].text(text), separator, width, terms)?;
        (columns.len() > 1 && columns.len() == width).then_some((at, columns))
    });
    let Some((at, mut columns)) = named else {
        return Header {
            line: None,
            columns: Vec::new(),
            first_row: first,
        };
    };
    let mut first_row = at + 1;
    if let Some(line) = lines.get(first_row)
        && add_units(&mut columns, line.text(text), separator)
    {
        first_row += 1;
    }
    Header {
        line: Some(lines[at].number),
        columns,
        first_row,
    }
}

/// Returns the index of the first line that is a row of a table without names: one with numbers that
/// has as many fields as most of such lines, or begins with a number. Also returns this number of
/// fields.
fn first_row(text: &str, lines: &[Line], separator: Separator) -> (usize, usize) {
    let is_row = |line: &&Line| {
        let first = line.text(text).split(|c: char| !c.is_alphanumeric()).next();
        has_number(line.text(text)) && !PREAMBLES.contains(&&*plain_name(first.unwrap_or("")))
    };
    let rows = lines.iter().filter(is_row);
    let mut widths: Vec<usize> = rows
        .map(|line| separator.split(line.text(text)).len())
        .collect();
    let usual = upper_median(&mut widths).unwrap_or(0);
    let position = lines.iter().position(|line| {
        let fields = separator.split(line.text(text));
        is_row(&line) && (fields.len() == usual || is_number(&fields[0]))
    });
    (position.unwrap_or(0), usual)
}

/// Returns the columns that a line names, and the number of names that are known; `None` if the line
/// has numbers between any separators. Of all others, the one counts by which the line has `width` names, or else most
/// that are known.
fn names(
    line: &str,
    separator: Separator,
    width: usize,
    terms: &'static [Term],
) -> Option<(Vec<Column>, usize)> {
    let mut splits: Vec<Vec<String>> = Vec::new();
    for separator in [separator].into_iter().chain(Separator::ALL) {
        splits.push(
            separator
                .split(line)
                .iter()
                .map(ToString::to_string)
                .collect(),
        );
    }
    // Names of several words are separated by two blanks or more.
    let by_two_blanks = line.split("  ").map(|name| name.trim().to_string());
    splits.push(by_two_blanks.filter(|name| !name.is_empty()).collect());
    splits.push(known_pairs(line, width, terms));
    let mut best: Option<(Vec<Column>, [usize; 2])> = None;
    for split in splits {
        if split.iter().any(|name| is_number(name)) {
            continue;
        }
        let columns: Vec<Column> = split.iter().map(|name| column(name, terms)).collect();
        let known = columns
            .iter()
            .filter(|column| column.term.is_some())
            .count();
        let rank = [usize::from(columns.len() == width), known];
        if best.as_ref().is_none_or(|best| best.1 < rank) {
            best = Some((columns, rank));
        }
    }
    best.map(|(columns, [_, known])| (columns, known))
}

/// Returns the words of a line, of which neighbours are joined that together are a known name, until
/// there are `width`.
fn known_pairs(line: &str, width: usize, terms: &'static [Term]) -> Vec<String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let mut extra = words.len().saturating_sub(width);
    let mut names: Vec<String> = Vec::new();
    for word in words {
        match names.last_mut() {
            Some(last)
                if extra > 0
                    && !last.ends_with([')', ']', '}', '>'])
                    && column(&format!("{last} {word}"), terms).term.is_some() =>
            {
                *last = format!("{last} {word}");
                extra -= 1;
            }
            _ => names.push(word.to_string()),
        }
    }
    names
}

/// Returns a column of a line in Petrel's header: its name, or its type and its name.
fn typed_column(line: &str, terms: &'static [Term]) -> Column {
    let line = line.trim();
    let typed = line
        .split_once(',')
        .filter(|(kind, _)| kind.chars().all(|c| c.is_ascii_uppercase()));
    column(typed.map_or(line, |(_, name)| name), terms)
}

/// Returns the column of a name, which may have a unit: in brackets, or as its last words.
pub(super) fn column(name: &str, terms: &'static [Term]) -> Column {
    let name = name.trim().trim_matches('"').trim();
    let bracket = name.find(['(', '[', '{', '<']);
    if let Some((name, text)) = bracket.map(|at| name.split_at(at)) {
        let text = text.trim_matches(|c: char| c.is_whitespace() || "()[]{}<>".contains(c));
        return bracketed_column(name.trim(), text, terms);
    }
    if let Some(term) = find_term(name, terms) {
        return Column::named(name, Some(term));
    }
    let is_separator = |c: char| c.is_whitespace() || "_-./,".contains(c);
    let last = name.rmatch_indices(is_separator).take(MAX_UNIT_WORDS);
    let last: Vec<(usize, &str)> = last.collect();
    for (at, separator) in last.into_iter().rev() {
        let (name, text) = (&name[..at], &name[at + separator.len()..]);
        if let Some(term) = find_term(name, terms)
            && let Some(parsed) = UnitText::parse(text)
            && parsed.unit.is_some()
        {
            let mut column = Column::named(name, measured_term(Some(term), &parsed, terms));
            column.unit = parsed.unit;
            return column;
        }
    }
    Column::named(name, None)
}

/// Returns the term of a name.
fn find_term(name: &str, terms: &'static [Term]) -> Option<&'static Term> {
    let plain = plain_name(name);
    terms.iter().find(|term| term.is_called(&plain))
}

/// Returns the column of a name with a text in brackets after it: a unit, a term, or both.
fn bracketed_column(name: &str, text: &str, terms: &'static [Term]) -> Column {
    let own = find_term(name, terms);
    if units::find(text).is_none()
        && let Some(term) = find_term(text, terms)
    {
        // Z (TWT) is a time.
        return Column::named(name, Some(term));
    }
    let Some(parsed) = UnitText::parse(text) else {
        let mut column = Column::named(name, own);
        column.unknown_unit = Some(text.to_string());
        return column;
    };
    let mut column = Column::named(name, measured_term(own, &parsed, terms));
    column.unit = parsed.unit;
    column
}

/// Returns the term of a column whose name has the term `own`, and whose unit says what the values are
/// measured from: `Z (ft TVDSS)` and `TVD (ft MSL)` are depths below the sea, `Depth (ft KB)` is one in
/// a well.
fn measured_term(
    own: Option<&'static Term>,
    text: &UnitText,
    terms: &'static [Term],
) -> Option<&'static Term> {
    let mut term = own;
    if own.is_some_and(|own| matches!(own.name, "z" | "depth")) {
        let all = find_term(&text.references.concat(), terms);
        let mut words = text.references.iter();
        let other = all.or_else(|| words.find_map(|word| find_term(word, terms)));
        let other = other.filter(|other| !matches!(other.name, "x" | "y"));
        term = other.or(own);
    }
    let name = match term?.name {
        "tvd" if text.is_from_sea_level() => "tvdss",
        "depth" if text.is_from_rig() => "tvd",
        name => name,
    };
    terms.iter().find(|term| term.name == name).or(term)
}

/// Takes units from a line of units, and returns `true` if the line is one.
fn add_units(columns: &mut [Column], line: &str, separator: Separator) -> bool {
    let fields = separator.split(line);
    if fields.iter().any(|field| is_number(field)) {
        return false;
    }
    let parsed: Vec<Option<UnitText>> = fields.iter().map(|field| UnitText::parse(field)).collect();
    let unit = |k: usize| parsed[k].as_ref().and_then(|text| text.unit.clone());
    let count = (0..fields.len()).filter(|&k| unit(k).is_some()).count();
    let is_other = |&k: &usize| !fields[k].is_empty() && unit(k).is_none();
    let others = (0..fields.len()).filter(is_other).count();
    if count == 0 || count < others {
        return false;
    }
    for (k, column) in columns.iter_mut().enumerate().take(fields.len()) {
        if let Some(unit) = unit(k) {
            column.unit = Some(unit);
            column.unknown_unit = None;
        } else if parsed[k].is_none() {
            let is_mark = |c: char| "()[]{}<>".contains(c);
            column.unknown_unit = Some(fields[k].trim_matches(is_mark).to_string());
        }
    }
    true
}

impl Column {
    /// Returns a column of a name without a unit.
    fn named(name: &str, term: Option<&'static Term>) -> Self {
        Self {
            name: name.to_string(),
            unit: None,
            term: term.map(|term| term.name),
            measure: term.map_or(Measure::Other, |term| term.measure),
            unknown_unit: None,
        }
    }
}

/// Returns the line and the names of `width` columns in the comments before a table: all in one
/// comment, or a numbered comment for each.
pub(super) fn from_comments(
    comments: &[&(usize, String)],
    width: usize,
    terms: &'static [Term],
) -> Option<(usize, Vec<Column>)> {
    for (number, comment) in comments.iter().rev().copied() {
        let after_colon = comment.split_once(':').map(|(_, names)| names.trim());
        for text in [Some(comment.as_str()), after_colon].into_iter().flatten() {
            if let Some((columns, known)) = names(text, Separator::Blanks, width, terms)
                && columns.len() == width
                && known >= width.min(2)
            {
                return Some((*number, columns));
            }
        }
    }
    let mut columns = vec![Column::default(); width];
    let mut first = None;
    for (number, comment) in comments.iter().copied() {
        let text = comment.trim_start_matches(|c: char| c.is_alphabetic() || c == ' ' || c == ':');
        let digits = text
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(text.len());
        let index = text[..digits].parse::<usize>().ok();
        let name = text[digits..].trim_start_matches([':', '.', ' ', '=']);
        // EarthVision says so of a column of texts.
        let name = name.trim_end().trim_end_matches("non-numeric").trim_end();
        if let Some(column_of) = index.and_then(|k| columns.get_mut(k.checked_sub(1)?))
            && !name.is_empty()
        {
            *column_of = column(name, terms);
            first = first.or(Some(*number));
        }
    }
    let are_named = columns.iter().all(|column| !column.name.is_empty());
    let known = columns
        .iter()
        .filter(|column| column.term.is_some())
        .count();
    (are_named && known >= 2).then_some((first?, columns))
}
