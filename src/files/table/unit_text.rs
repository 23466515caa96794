//! Units beside the names of columns, with what the values are measured from: `ft KB`, `mTVDSS`.

use std::ops::Range;

use crate::units;

/// The text beside the name of a column, such as `ft KB`.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct UnitText {
    /// The unit; `None` if the text has only other words that are known.
    pub unit: Option<String>,
    /// The other words, in lower case.
    pub references: Vec<String>,
}

/// Abbreviations of levels, which may follow a unit without a blank.
const REFERENCES: [&str; 31] = [
    "kb",
    "rkb",
    "bkb",
    "brkb",
    "rt",
    "brt",
    "df",
    "bdf",
    "gl",
    "bgl",
    "agl",
    "msl",
    "bmsl",
    "amsl",
    "ss",
    "sstvd",
    "tvd",
    "tvdss",
    "tvdkb",
    "tvdrkb",
    "tvdrt",
    "tvdmsl",
    "tvdsubsea",
    "md",
    "mdkb",
    "mdrkb",
    "mdrt",
    "subsea",
    "bsl",
    "asl",
    "twt",
];

/// Other words that say nothing about the unit.
const FILLERS: [&str; 66] = [
    "sea",
    "level",
    "below",
    "above",
    "kelly",
    "bushing",
    "rotary",
    "table",
    "drill",
    "floor",
    "ground",
    "datum",
    "seabed",
    "mudline",
    "depth",
    "elevation",
    "height",
    "time",
    "vertical",
    "measured",
    "up",
    "down",
    "positive",
    "from",
    "to",
    "the",
    "of",
    "is",
    "mean",
    "true",
    "two",
    "way",
    "travel",
    "negative",
    "upwards",
    "downwards",
    "upward",
    "downward",
    "sub",
    "unitless",
    "none",
    "px",
    "pixel",
    "pixels",
    "voxels",
    "samples",
    "x",
    "y",
    "z",
    "e",
    "n",
    "east",
    "north",
    "easting",
    "northing",
    "coordinate",
    "coordinates",
    "srd",
    "lat",
    "ahd",
    "nap",
    "kbe",
    "dfe",
    "rte",
    "bml",
    "bgs",
];

/// First letters of words that name a system of coordinates in the plane.
const SYSTEMS: [&str; 24] = [
    "utm", "wgs", "nad", "epsg", "etrs", "gda", "crs", "lambert", "zone", "gauss", "bng", "osgb",
    "amg", "mga", "sirgas", "psad", "navd", "egm", "grid", "local", "map", "project", "mercator",
    "state",
];

/// Largest length of a text that is looked at.
const MAX_LENGTH: usize = 100;

/// Words for levels of the sea.
const SEA_LEVELS: [&str; 8] = ["ss", "msl", "bmsl", "amsl", "subsea", "bsl", "asl", "sea"];

/// Words for the levels of a rig from which depths in wells are measured.
const RIG_LEVELS: [&str; 10] = [
    "kb", "rkb", "bkb", "brkb", "rt", "brt", "df", "bdf", "kelly", "rotary",
];

impl UnitText {
    /// Returns the unit and the other words of a text; `None` if the text is not understood.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let is_mark = |c: char| c.is_whitespace() || "()[]{}<>".contains(c);
        let text = text.trim_matches(is_mark);
        let of_mark = match text {
            "'" | "\u{2019}" | "\u{2032}" => Some("ft"),
            "\"" | "''" | "\u{2033}" => Some("in"),
            _ => None,
        };
        if let Some(unit) = of_mark.or_else(|| units::find(text).map(|_| text)) {
            return Some(Self {
                unit: Some(unit.to_string()),
                references: Vec::new(),
            });
        }
        if text.len() > MAX_LENGTH || text.contains(['\u{b0}', '%']) {
            return None;
        }
        let mut words = words(text);
        if words.len() > 1 {
            // In `depth in ft`, the first unit is no inch.
            words.retain(|word| word != "in");
        }
        let range = unit_range(&words).unwrap_or(0..0);
        let unit = (!range.is_empty()).then(|| words[range.clone()].join(" "));
        let mut references = words[..range.start].to_vec();
        references.extend_from_slice(&words[range.end..]);
        let has_system = references.iter().any(|word| is_system(word));
        let is_understood = |word: &String| {
            let is_known = has_system || is_reference(word) || FILLERS.contains(&&**word);
            is_known && units::find(word).is_none()
        };
        let all_are_understood = references.iter().all(is_understood);
        all_are_understood.then_some(Self { unit, references })
    }

    /// Returns `true` if values are measured from the level of the sea.
    pub(super) fn is_from_sea_level(&self) -> bool {
        self.has_any(&SEA_LEVELS)
    }

    /// Returns `true` if values are measured from a rig, such as from its kelly bushing.
    pub(super) fn is_from_rig(&self) -> bool {
        self.has_any(&RIG_LEVELS)
    }

    fn has_any(&self, words: &[&str]) -> bool {
        self.references.iter().any(|word| words.contains(&&**word))
    }
}

/// Returns the words of a text in lower case, a unit and the level that follows it without a blank as two.
fn words(text: &str) -> Vec<String> {
    // Points are those of abbreviations: ft., a.s.l.
    let text = text.to_lowercase().replace('.', "");
    let mut words: Vec<String> = Vec::new();
    for word in text.split(|c: char| !c.is_alphanumeric()) {
        if word.is_empty() {
            continue;
        }
        let follows_number = words
            .last()
            .is_some_and(|last| last.chars().all(|c| c.is_ascii_digit()));
        if let Some(last) = words.last_mut()
            && follows_number
            && matches!(word, "n" | "s")
        {
            // The hemisphere of a zone, as in UTM 31 N.
            last.push_str(word);
        } else if let Some((unit, reference)) = unit_and_reference(word) {
            words.extend([unit, reference].map(String::from));
        } else {
            words.push(word.to_string());
        }
    }
    words
}

/// Returns the parts of a word that is a unit and a level, such as `ftkb`.
fn unit_and_reference(word: &str) -> Option<(&str, &str)> {
    if is_reference(word) || units::find(word).is_some() {
        return None;
    }
    let ends = word.char_indices().skip(1);
    ends.map(|(end, _)| word.split_at(end))
        .find(|(unit, reference)| {
            let is_axis = matches!(*unit, "m" | "ft") && matches!(*reference, "e" | "n");
            is_axis || units::find(unit).is_some() && is_reference(reference)
        })
}

/// Returns the first words that together are a unit: as many as possible.
fn unit_range(words: &[String]) -> Option<Range<usize>> {
    (0..words.len()).find_map(|start| {
        let last = words.len().min(start + 3);
        let mut ranges = (start + 1..=last).rev().map(|end| start..end);
        let is_unit = |range: &Range<usize>| units::find(&words[range.clone()].join(" ")).is_some();
        ranges.find(is_unit)
    })
}

fn is_reference(word: &str) -> bool {
    REFERENCES.contains(&word)
}

/// Returns `true` for a word that names a system of coordinates: a known one, or letters and a number,
/// such as `ed50`.
fn is_system(word: &str) -> bool {
    let end = word.find(|c: char| !c.is_alphabetic());
    let letters = &word[..end.unwrap_or(word.len())];
    let has_number = word.chars().any(|c| c.is_ascii_digit());
    SYSTEMS.iter().any(|system| word.starts_with(system))
        || has_number && letters.chars().count() >= 2 && units::find(letters).is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_found_with_the_levels_that_values_are_measured_from() {
        for (text, unit) in [
            ("m", "m"),
            ("US survey feet", "US survey feet"),
            ("ftKB", "ft"),
            ("ft KB", "ft"),
            ("ft RKB", "ft"),
            ("ft MD", "ft"),
            ("'", "ft"),
            ("ftSS", "ft"),
            ("ft MSL", "ft"),
            ("ft TVDSS", "ft"),
            ("ft-msl", "ft"),
            ("ft, MSL", "ft"),
            ("m MSL", "m"),
            ("mTVDSS", "m"),
            ("mMSL", "m"),
            ("m a.s.l.", "m"),
            ("in ft", "ft"),
            ("depth in ft", "ft"),
            ("feet below mean sea level", "feet"),
            ("TVDSS, ft", "ft"),
            ("ftUS KB", "ftus"),
            ("US ft, MSL", "us ft"),
            ("ms TWT", "ms"),
            ("mE", "m"),
            ("m N", "m"),
            ("m, SRD", "m"),
            ("ED50 / UTM zone 31 S, m", "m"),
        ] {
            let parsed = UnitText::parse(text).and_then(|parsed| parsed.unit);
            assert_eq!(parsed.as_deref(), Some(unit), "{text}");
        }
        for text in ["UTM 31N", "below KB", "TVDSS", "-", "ED50"] {
            let parsed = UnitText::parse(text).map(|parsed| parsed.unit);
            assert_eq!(parsed, Some(None), "{text}");
        }
        for text in [
            "fathoms", "m/s", "stable", "ft2", "m3/d", "1000 ft", "ft x1000", "deg", "\u{b0}",
            "kft", "ms OWT",
        ] {
            assert_eq!(UnitText::parse(text), None, "{text}");
        }
    }
}
