//! Separators, quotes and decimal marks of a table.

use std::borrow::Cow;

/// The separator between the fields of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separator {
    /// A semicolon, a tab or a comma. Two of them have an empty field between them.
    Mark(char),
    /// Any number of blanks and tabs.
    Blanks,
}

/// The mark before the decimals of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DecimalMark {
    /// A point.
    Point,
    /// A comma.
    Comma,
    /// Commas of the table may separate decimals or thousands.
    Unclear,
}

impl Separator {
    /// All separators, in the order in which they are tried.
    pub(super) const ALL: [Self; 4] = [
        Self::Mark(';'),
        Self::Mark('\t'),
        Self::Mark(','),
        Self::Blanks,
    ];

    /// Returns the separator that most of the lines have.
    pub(super) fn of_lines<'a>(lines: impl Iterator<Item = &'a str>) -> Self {
        let (mut count, mut marked) = (0, [0; 3]);
        let (mut tabs_between_blanks, mut has_decimal_commas) = (false, false);
        for line in lines {
            count += 1;
            for (marked, separator) in marked.iter_mut().zip(Self::ALL) {
                *marked += usize::from(separator.split(line).len() > 1);
            }
            let holds_blanks =
                |mark| (Self::Mark(mark).split(line).iter()).any(|field| is_blank_list(field));
            tabs_between_blanks |= holds_blanks('\t');
            has_decimal_commas |= holds_blanks(',');
        }
        let is_usual = |marked: usize| 2 * marked > count;
        if is_usual(marked[0]) {
            Self::Mark(';')
        } else if is_usual(marked[1]) && !tabs_between_blanks {
            Self::Mark('\t')
        } else if is_usual(marked[2]) && !has_decimal_commas {
            Self::Mark(',')
        } else {
            Self::Blanks
        }
    }

    /// Returns the fields of a line without the blanks and quotes around them.
    pub(super) fn split(self, line: &str) -> Vec<Cow<'_, str>> {
        let is_end = |c: char| match self {
            Self::Mark(mark) => c == mark,
            Self::Blanks => c.is_whitespace(),
        };
        let mut fields = Vec::new();
        let mut rest = line.trim_start_matches([' ', '\u{a0}']);
        if self == Self::Blanks {
            rest = rest.trim();
        }
        loop {
            let (field, after) = quoted_field(rest).unwrap_or_else(|| {
                let end = rest.find(is_end).unwrap_or(rest.len());
                (Cow::Borrowed(rest[..end].trim()), &rest[end..])
            });
            fields.push(field);
            // Behind a closing quote, text up to the separator is dropped.
            let Some(end) = after.find(is_end) else {
                return fields;
            };
            let width = after[end..].chars().next().map_or(0, char::len_utf8);
            rest = after[end + width..].trim_start_matches([' ', '\u{a0}']);
            if self == Self::Blanks {
                rest = rest.trim_start();
            }
        }
    }
}

/// Returns the field in quotes at the start of a text, and the text after it.
fn quoted_field(text: &str) -> Option<(Cow<'_, str>, &str)> {
    let inner = text.strip_prefix('"')?;
    let mut from = 0;
    loop {
        let end = from + inner[from..].find('"')?;
        if inner[end + 1..].starts_with('"') {
            from = end + 2;
            continue;
        }
        let field = inner[..end].trim();
        let field = if field.contains('"') {
            Cow::Owned(field.replace("\"\"", "\""))
        } else {
            Cow::Borrowed(field)
        };
        return Some((field, &inner[end + 1..]));
    }
}

/// Returns `true` if a field has several words, of which all are numbers.
fn is_blank_list(field: &str) -> bool {
    field.contains(char::is_whitespace) && field.split_whitespace().all(is_number)
}

/// Returns `true` if a field has the form of a number, with either decimal mark.
pub(super) fn is_number(field: &str) -> bool {
    parse_number(field, DecimalMark::Comma).is_some()
}

/// Returns the finite number that a field holds.
pub(super) fn parse_number(field: &str, mark: DecimalMark) -> Option<f64> {
    let is_part = |c: char| c.is_ascii_digit() || "+-.,eEdD\u{2212}".contains(c);
    if !field.contains(|c: char| c.is_ascii_digit()) || !field.chars().all(is_part) {
        return None;
    }
    let mut text = Cow::Borrowed(field);
    if field.contains(',') {
        if mark != DecimalMark::Comma || field.contains('.') {
            return None;
        }
        text = Cow::Owned(text.replace(',', "."));
    }
    if text.contains(['d', 'D', '\u{2212}']) {
        text = Cow::Owned(text.replace(['d', 'D'], "e").replace('\u{2212}', "-"));
    }
    text.parse().ok().filter(|value: &f64| value.is_finite())
}

/// Returns `true` if a field says that there is no value.
pub(super) fn is_missing(field: &str) -> bool {
    let names = ["nan", "null", "none", "n/a", "na", "#n/a", "inf", "-inf"];
    field.chars().all(|c| "-*?".contains(c)) || names.iter().any(|n| field.eq_ignore_ascii_case(n))
}

/// Returns `true` if a field may be a number whose thousands are separated.
pub(super) fn may_have_thousands(field: &str) -> bool {
    let field = field.trim_start_matches(['+', '-', '\u{2212}']);
    let are_digits = |group: &str| !group.is_empty() && group.chars().all(|c| c.is_ascii_digit());
    let has_groups_of = |mark: char| {
        let is_decimal_mark = |c: char| ",.".contains(c) && c != mark;
        let whole = field.split(is_decimal_mark).next().unwrap_or(field);
        let mut groups = whole.split(mark);
        let has_first = groups.next().is_some_and(|g| are_digits(g) && g.len() <= 3);
        let rest: Vec<&str> = groups.collect();
        has_first && !rest.is_empty() && rest.iter().all(|g| are_digits(g) && g.len() == 3)
    };
    [',', '.', ' ', '\'', '\u{a0}', '\u{202f}']
        .into_iter()
        .any(has_groups_of)
}

/// Collects evidence on the decimal mark of a table.
#[derive(Debug, Default)]
pub(super) struct DecimalEvidence {
    has_commas: bool,
    has_points: bool,
    /// A comma that cannot separate thousands.
    is_certain: bool,
}

impl DecimalEvidence {
    /// Looks at a field.
    pub(super) fn add(&mut self, field: &str) {
        if field.contains('.') && parse_number(field, DecimalMark::Point).is_some() {
            self.has_points = true;
        } else if let Some((whole, decimals)) = field.split_once(',')
            && is_number(field)
        {
            self.has_commas = true;
            let whole = whole.trim_start_matches(['+', '-', '\u{2212}']);
            self.is_certain |= decimals.len() != 3
                || decimals.contains(|c: char| !c.is_ascii_digit())
                || whole.len() > 3
                || whole.is_empty()
                || whole.starts_with('0');
        }
    }

    /// Returns the decimal mark.
    pub(super) fn mark(&self) -> DecimalMark {
        match (self.has_commas, self.has_points, self.is_certain) {
            (false, ..) => DecimalMark::Point,
            (true, false, true) => DecimalMark::Comma,
            _ => DecimalMark::Unclear,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_split_at_the_separator_outside_quotes() {
        let comma = Separator::Mark(',');
        assert_eq!(
            comma.split("a b, \"c, \"\"d\"\"\" ,,5"),
            ["a b", "c, \"d\"", "", "5"]
        );
        assert_eq!(
            Separator::Blanks.split(" 1\t\"a b\"  3 "),
            ["1", "a b", "3"]
        );
        assert_eq!(Separator::Mark('\t').split("\t1\t2"), ["", "1", "2"]);
        assert_eq!(comma.split(""), [""]);
    }

    #[test]
    fn separators_are_those_of_most_lines() {
        for (text, separator) in [
            ("x,y\n1,2", Separator::Mark(',')),
            ("x;y\n1,5;2", Separator::Mark(';')),
            ("1,5 2,5 3", Separator::Blanks),
            ("1, 2, 3", Separator::Mark(',')),
            ("1.0 , 2.0 , 3.0", Separator::Mark(',')),
            ("Main fault 3,12", Separator::Mark(',')),
            ("1 \t 2 3", Separator::Blanks),
            ("a b\t2", Separator::Mark('\t')),
        ] {
            assert_eq!(Separator::of_lines(text.lines()), separator, "{text}");
        }
    }

    #[test]
    fn thousands_are_recognised_and_never_numbers() {
        for field in [
            "1,234.5",
            "1.234,5",
            "1,234,567",
            "6 780 000",
            "1'234.5",
            "450,334",
        ] {
            assert!(may_have_thousands(field), "{field}");
            assert_eq!(parse_number(field, DecimalMark::Point), None, "{field}");
        }
        for field in ["1234.5", "0.5", "12", "a,bcd", "", "2000-01-01"] {
            assert!(!may_have_thousands(field), "{field}");
        }
        assert_eq!(parse_number("1.5D+03", DecimalMark::Point), Some(1500.0));
        assert_eq!(parse_number("\u{2212}1,5", DecimalMark::Comma), Some(-1.5));
        for field in ["nan", "inf", "1e999", "e", "-", "1-2"] {
            assert_eq!(parse_number(field, DecimalMark::Comma), None, "{field}");
        }
    }

    #[test]
    fn the_decimal_mark_is_a_comma_only_where_it_cannot_separate_thousands() {
        let mark = |fields: &[&str]| {
            let mut evidence = DecimalEvidence::default();
            fields.iter().for_each(|field| evidence.add(field));
            evidence.mark()
        };
        assert_eq!(mark(&["1", "2.5"]), DecimalMark::Point);
        assert_eq!(mark(&["450334,500", "2"]), DecimalMark::Comma);
        assert_eq!(mark(&["450,334", "0,500"]), DecimalMark::Comma);
        assert_eq!(mark(&["450,334", "780"]), DecimalMark::Unclear);
        assert_eq!(mark(&["450,334", "2.5"]), DecimalMark::Unclear);
    }
}
