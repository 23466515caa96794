//! Textual headers, in EBCDIC or ASCII.

use crate::units::{self, Quantity};

/// Length of a textual header in bytes: 40 lines of 80.
pub const TEXT_HEADER_BYTES: usize = 3200;

/// Converts a character of EBCDIC (code page 037) to ASCII. Characters that ASCII lacks become
/// blanks.
fn ebcdic_to_char(byte: u8) -> char {
    let letter_at = |first: u8, letters: &[u8]| char::from(letters[usize::from(byte - first)]);
    match byte {
        0x4b..=0x50 => letter_at(0x4b, b".<(+|&"),
        0x5a..=0x61 => letter_at(0x5a, b"!$*);\x20-/"),
        0x6b..=0x6f => letter_at(0x6b, b",%_>?"),
        0x79..=0x7f => letter_at(0x79, b"`:#@'=\""),
        0x81..=0x89 => letter_at(0x81, b"abcdefghi"),
        0x91..=0x99 => letter_at(0x91, b"jklmnopqr"),
        0xa1..=0xa9 => letter_at(0xa1, b"~stuvwxyz"),
        0xb0 => '^',
        0xba => '[',
        0xbb => ']',
        0xc0..=0xc9 => letter_at(0xc0, b"{ABCDEFGHI"),
        0xd0..=0xd9 => letter_at(0xd0, b"}JKLMNOPQR"),
        0xe0 => '\\',
        0xe2..=0xe9 => letter_at(0xe2, b"STUVWXYZ"),
        0xf0..=0xf9 => letter_at(0xf0, b"0123456789"),
        _ => ' ',
    }
}

/// Returns the number of bytes that are letters, digits or blanks in EBCDIC and in ASCII.
fn text_byte_counts(bytes: &[u8]) -> (usize, usize) {
    let ebcdic = |b: &&u8| matches!(**b, 0x40 | 0x81..=0xa9 | 0xc1..=0xf9);
    let ascii = |b: &&u8| b.is_ascii_alphanumeric() || **b == b' ';
    (
        bytes.iter().filter(ebcdic).count(),
        bytes.iter().filter(ascii).count(),
    )
}

/// Returns `true` if the bytes are text in one of the two encodings rather than numbers.
pub fn is_text(bytes: &[u8]) -> bool {
    let (ebcdic, ascii) = text_byte_counts(bytes);
    let blank = bytes.iter().filter(|&&b| b == 0).count();
    2 * ebcdic.max(ascii) > bytes.len() && 10 * (ebcdic.max(ascii) + blank) > 6 * bytes.len()
}

/// Decodes text in the more likely of the two encodings.
pub fn decode(bytes: &[u8]) -> String {
    let (likely_ebcdic, likely_ascii) = text_byte_counts(bytes);
    let character = |&b: &u8| {
        if likely_ebcdic > likely_ascii {
            ebcdic_to_char(b)
        } else if b.is_ascii_graphic() {
            char::from(b)
        } else {
            ' '
        }
    };
    bytes.iter().map(character).collect()
}

/// Encodes a textual header in EBCDIC: at most 40 lines of at most 80 characters of ASCII.
pub fn encode(lines: &[&str]) -> [u8; TEXT_HEADER_BYTES] {
    let mut header = [b'\x40'; TEXT_HEADER_BYTES];
    for (row, line) in header.chunks_mut(80).zip(lines) {
        for (byte, character) in row.iter_mut().zip(line.chars()) {
            let encoded = (0x41..=u8::MAX).find(|&byte| ebcdic_to_char(byte) == character);
            *byte = encoded.unwrap_or(b'\x40');
        }
    }
    header
}

/// Returns the lines of a textual header that are not empty, without trailing blanks.
pub fn lines(header: &[u8]) -> Vec<String> {
    header
        .chunks(80)
        .map(|line| decode(line).trim_end().to_string())
        .filter(|line| !line.is_empty())
        .collect()
}

/// Returns the words of a line in upper case.
fn words(line: &str) -> Vec<String> {
    let upper = line.to_uppercase();
    let words = upper.split(|c: char| !c.is_ascii_alphanumeric() && c != '.');
    let words = words.filter(|word| !word.is_empty());
    words.map(String::from).collect()
}

/// Returns the quantity of the sample interval that a line gives with a unit.
fn interval_quantity(words: &[String]) -> Option<Quantity> {
    if !words.iter().any(|word| word == "SAMPLE") {
        return None;
    }
    // The first number after the name of the interval, and the unit that follows it.
    let keyword = words
        .iter()
        .position(|word| matches!(&**word, "INTERVAL" | "RATE"))?;
    let mut rest = words[keyword + 1..].iter();
    let number = rest.find(|word| word.starts_with(|c: char| c.is_ascii_digit()));
    let suffix =
        number.map(|word| word.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.'));
    let unit = match suffix {
        Some("") => rest.next().map(String::as_str),
        suffix => suffix,
    };
    unit.and_then(units::find).map(|unit| unit.quantity)
}

/// Returns `true` if a line of a textual header says that samples are in depth: it names the domain,
/// or gives the sample interval in metres or feet. Words on depth migration do not count, because many
/// such volumes are converted back to time.
pub fn says_depth(line: &str) -> bool {
    let words = words(line);
    let has = |word: &str| words.iter().any(|w| w == word);
    if has("TIME") || has("BYTE") || has("BYTES") {
        return false;
    }
    has("DOMAIN") && has("DEPTH") || interval_quantity(&words) == Some(Quantity::Length)
}

/// Returns `true` if a line of a textual header says that samples are in time.
pub fn says_time(line: &str) -> bool {
    let words = words(line);
    let has = |word: &str| words.iter().any(|w| w == word);
    let is_range = ["MIN", "MAX", "RANGE"].iter().any(|word| has(word));
    has("TIME") && (has("DOMAIN") || is_range) && !has("DEPTH")
        || interval_quantity(&words) == Some(Quantity::Time)
}

/// Returns `true` if a line of a textual header suggests that samples are in depth without saying it:
/// a range of depths, as Petrel writes it, or a depth migration.
pub fn suggests_depth(line: &str) -> bool {
    let words = words(line);
    let has = |word: &str| words.iter().any(|w| w == word);
    if has("TIME") || has("TWT") || has("BYTE") || has("BYTES") {
        return false;
    }
    let has_depth = has("DEPTH") || has("DEPTHS") || has("TVDSS") || has("TVD");
    let is_range = ["MIN", "MAX", "MINIMUM", "MAXIMUM", "RANGE", "FIRST", "LAST", "START", "END", "STEP"]
        .iter()
        .any(|word| has(word));
    let is_migration = ["MIGRATION", "MIGRATED", "STACK", "SECTION", "VOLUME", "CUBE", "CONVERTED"]
        .iter()
        .any(|word| has(word));
    has("PSDM") || has("PRESDM") || has_depth && (is_range || is_migration)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoded_lines_are_read_back() {
        let text = ["C 1 Synthetic: 12.5 m x 4 ms", "C 2 bytes 189, 193"];
        assert_eq!(lines(&encode(&text)), text);
    }

    #[test]
    fn ebcdic_and_ascii_are_decoded() {
        let ebcdic = b"\xc3\x40\xf1\x40\xc9\x95\x93\x89\x95\x85\x7a\x40\xf1\xf8\xf9";
        assert_eq!(decode(ebcdic), "C 1 Inline: 189");
        assert_eq!(decode(b"C 1 Inline: 189\x00"), "C 1 Inline: 189 ");
        assert!(is_text(ebcdic) && is_text(b"C 1 Inline: 189"));
        let numbers: Vec<u8> = (0..400u32).flat_map(|i| (i as f32).to_le_bytes()).collect();
        assert!(!is_text(&numbers) && !is_text(&[0; 100]));
    }

    #[test]
    fn ranges_of_depths_and_depth_migrations_suggest_depth() {
        for line in [
            "C 5 Depth min: 0.000000 max: -3000.000000 delta: -5.000000",
            "C 6 Depth range 0 - 3000",
            "C 3 KIRCHHOFF PSDM STACK",
            "C 9 PRESTACK DEPTH MIGRATION",
        ] {
            assert!(suggests_depth(line) && !says_depth(line), "{line}");
        }
        for line in [
            "C 5 DEPTH MIGRATION, CONVERTED TO TIME DOMAIN",
            "C 4 DEPTH OF SOURCE 5 M, SAMPLE CODE 1",
            "C 5 Time min: 0 max: 2000 delta: 4",
        ] {
            assert!(!suggests_depth(line), "{line}");
        }
        assert!(says_time("C 5 Time min: 0 max: 2000 delta: 4"));
        assert!(says_time("C 7 SAMPLE INTERVAL 4 MS, TRACES 12.5 M APART"));
        assert!(!says_time("C27 Trace start time/depth      : bytes 109-110"));
    }

    #[test]
    fn lines_that_name_the_domain_or_a_length_say_depth() {
        for line in [
            "C 5 DOMAIN: DEPTH",
            "C 6 Z-Domain is depth, in metres",
            "C 7 SAMPLE INTERVAL 5 M",
            "C 7 Sample rate: 2.5m",
            "C 8 SAMPLE INTERVAL: 10 FEET  NUMBER OF SAMPLES 500",
        ] {
            assert!(says_depth(line), "{line}");
        }
        for line in [
            "C 5 DOMAIN: TIME",
            "C 5 DEPTH MIGRATION, CONVERTED TO TIME DOMAIN",
            "C 9 PRESTACK DEPTH MIGRATION",
            "C 7 SAMPLE INTERVAL 4 MS, TRACES 12.5 M APART",
            "C 7 SAMPLE INTERVAL 4  SAMPLES/TRACE 462  BITS/IN  BYTES/SAMPLE",
            "C17 Sample interval             : bytes 17-18",
            "C27 Trace start time/depth      : bytes 109-110",
            "C 4 DEPTH OF SOURCE 5 M, SAMPLE CODE 1",
        ] {
            assert!(!says_depth(line), "{line}");
        }
    }
}
