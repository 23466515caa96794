//! Log ASCII Standard, version 2.0 (Canadian Well Logging Society): curves of a well.

use super::dialect::{DecimalMark, Separator, parse_number};
use super::{Line, Table, Term, header};
use crate::Result;

/// Text and value of a line `MNEMONIC.UNIT VALUE : DESCRIPTION`.
struct Entry<'a> {
    mnemonic: &'a str,
    unit: &'a str,
    value: &'a str,
}

impl<'a> Entry<'a> {
    fn parse(line: &'a str) -> Option<Self> {
        let (mnemonic, rest) = line.split_once('.')?;
        let rest = rest.rsplit_once(':').map_or(rest, |(rest, _)| rest);
        let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
        Some(Self {
            mnemonic: mnemonic.trim(),
            unit: &rest[..end],
            value: rest[end..].trim(),
        })
    }
}

impl Table {
    /// Returns `true` if the text is a LAS file.
    pub(super) fn is_las(&self, lines: &[Line]) -> bool {
        let is_comment = |line: &&Line| line.text(&self.text).starts_with('#');
        let first = lines.iter().find(|line| !is_comment(line));
        first.is_some_and(|line| {
            line.text(&self.text)
                .get(..2)
                .is_some_and(|mark| mark.eq_ignore_ascii_case("~v"))
        })
    }

    /// Reads the sections of a LAS file.
    pub(super) fn parse_las(&mut self, lines: &[Line], terms: &'static [Term]) -> Result<()> {
        let text = std::mem::take(&mut self.text);
        let mut section = ' ';
        for line in lines {
            let words = line.text(&text).trim();
            if let Some(name) = words.strip_prefix('~') {
                section = name.chars().next().unwrap_or(' ').to_ascii_uppercase();
                continue;
            }
            if words.starts_with('#') {
                continue;
            }
            if section == 'A' {
                self.lines.push(*line);
                continue;
            }
            let Some(entry) = Entry::parse(words) else {
                continue;
            };
            match (section, entry.mnemonic.to_ascii_uppercase().as_str()) {
                ('V', "WRAP") if entry.value.eq_ignore_ascii_case("yes") => {
                    let remedy = "write the file again without wrapped lines (WRAP. NO)";
                    return Err(self.error("has wrapped lines", remedy));
                }
                ('C', _) => {
                    self.header_line = self.header_line.or(Some(line.number));
                    let name = format!("{} ({})", entry.mnemonic, entry.unit);
                    self.columns.push(header::column(&name, terms));
                }
                (_, mnemonic) => {
                    if mnemonic == "NULL" {
                        self.nulls
                            .extend(parse_number(entry.value, DecimalMark::Point));
                    }
                    self.remarks.push(format!(
                        "{}: {} ({})",
                        entry.mnemonic, entry.value, entry.unit
                    ));
                }
            }
        }
        self.separator = Separator::Blanks;
        self.text = text;
        Ok(())
    }
}
