//! Finds what was assumed about the input in the notes of a report.
//!
//! A note on something that neither the files nor the options say begins with [`ASSUMED`], or has one of
//! the phrases in [`PHRASES`]. The verdict repeats these notes, so that a wrong guess is seen first.

use crate::progress::ASSUMED;

/// Phrases in other notes that tell of a guess about units, signs and null values.
const PHRASES: [&str; 6] = [
    "taken as",
    "sign of z turned",
    "sign of z kept",
    "common null value",
    "with a null value",
    "count as missing",
];

/// Returns what was assumed, from the notes of a report.
pub(super) fn assumptions(notes: &[String]) -> Vec<String> {
    let assumption = |note: &String| {
        let stated = note.strip_prefix(ASSUMED);
        let has_phrase = PHRASES.iter().any(|phrase| note.contains(phrase));
        stated
            .or_else(|| has_phrase.then_some(note))
            .map(str::to_owned)
    };
    notes.iter().filter_map(assumption).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_on_guesses_are_told_from_others() {
        let notes = [
            "assumed: depths of F1 are in m",
            "the image has 3 lines",
            "surface F1: a fault, with the sign of z turned",
            "12 samples (0.10 %) hold -999.25, a common null value, and count as missing",
        ];
        let found = assumptions(&notes.map(str::to_owned));
        assert_eq!(found, [&notes[0][ASSUMED.len()..], notes[2], notes[3]]);
    }
}
