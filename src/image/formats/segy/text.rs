//! Textual headers, in EBCDIC or ASCII.

/// Bytes of a textual header: 40 lines of 80.
pub const TEXT_HEADER_BYTES: usize = 3200;

/// The characters of EBCDIC (code page 037) that ASCII has too; the others become blanks.
fn ebcdic_to_char(byte: u8) -> char {
    let found = |first: u8, letters: &[u8]| char::from(letters[usize::from(byte - first)]);
    match byte {
        0x4b..=0x50 => found(0x4b, b".<(+|&"),
        0x5a..=0x61 => found(0x5a, b"!$*);\x20-/"),
        0x6b..=0x6f => found(0x6b, b",%_>?"),
        0x79..=0x7f => found(0x79, b"`:#@'=\""),
        0x81..=0x89 => found(0x81, b"abcdefghi"),
        0x91..=0x99 => found(0x91, b"jklmnopqr"),
        0xa1..=0xa9 => found(0xa1, b"~stuvwxyz"),
        0xb0 => '^',
        0xba => '[',
        0xbb => ']',
        0xc0..=0xc9 => found(0xc0, b"{ABCDEFGHI"),
        0xd0..=0xd9 => found(0xd0, b"}JKLMNOPQR"),
        0xe0 => '\\',
        0xe2..=0xe9 => found(0xe2, b"STUVWXYZ"),
        0xf0..=0xf9 => found(0xf0, b"0123456789"),
        _ => ' ',
    }
}

/// How many bytes are letters, digits or blanks in EBCDIC and in ASCII.
fn text_byte_counts(bytes: &[u8]) -> (usize, usize) {
    let ebcdic = |b: &&u8| matches!(**b, 0x40 | 0x81..=0xa9 | 0xc1..=0xf9);
    let ascii = |b: &&u8| b.is_ascii_alphanumeric() || **b == b' ';
    (
        bytes.iter().filter(ebcdic).count(),
        bytes.iter().filter(ascii).count(),
    )
}

/// Whether this is text in one of the two codes rather than numbers.
pub fn is_text(bytes: &[u8]) -> bool {
    let (ebcdic, ascii) = text_byte_counts(bytes);
    let blank = bytes.iter().filter(|&&b| b == 0).count();
    2 * ebcdic.max(ascii) > bytes.len() && 10 * (ebcdic.max(ascii) + blank) > 6 * bytes.len()
}

/// The text, in whichever code it is more likely to be.
pub fn decode(bytes: &[u8]) -> String {
    let (likely_ebcdic, likely_ascii) = text_byte_counts(bytes);
    let character = |&b: &u8| match likely_ebcdic > likely_ascii {
        true => ebcdic_to_char(b),
        false if b.is_ascii_graphic() => char::from(b),
        false => ' ',
    };
    bytes.iter().map(character).collect()
}

/// The lines of a textual header that say something, without blanks at their ends.
pub fn lines(header: &[u8]) -> Vec<String> {
    header
        .chunks(80)
        .map(|line| decode(line).trim_end().to_string())
        .filter(|line| !line.is_empty())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_codes() {
        let ebcdic = b"\xc3\x40\xf1\x40\xc9\x95\x93\x89\x95\x85\x7a\x40\xf1\xf8\xf9";
        assert_eq!(decode(ebcdic), "C 1 Inline: 189");
        assert_eq!(decode(b"C 1 Inline: 189\x00"), "C 1 Inline: 189 ");
        assert!(is_text(ebcdic) && is_text(b"C 1 Inline: 189"));
        let numbers: Vec<u8> = (0..400u32).flat_map(|i| (i as f32).to_le_bytes()).collect();
        assert!(!is_text(&numbers) && !is_text(&[0; 100]));
    }
}
