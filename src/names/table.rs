//! The table of names: what became of each name in a file.

use super::csv_field;

/// Largest number of names in a note.
const MAX_LISTED_NAMES: usize = 4;

/// An object and its name in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NameEntry {
    /// The kind of object: `region`, `face`, `surface`, `well`, `group` or `property`.
    pub kind: &'static str,
    /// The number of the object among those of its kind.
    pub number: i64,
    /// The name that it has in the mesh.
    pub name: String,
    /// The name, or the number, that it has in the file.
    pub written: String,
    /// `true` if the file has numbers in place of names for this kind of object.
    pub is_numbered: bool,
    /// `true` if the user or a file gave the name.
    pub is_given: bool,
}

impl NameEntry {
    /// Returns `true` if the name in the file is not the same, apart from case, as that in the mesh.
    fn is_changed(&self) -> bool {
        !self.is_numbered && !self.name.eq_ignore_ascii_case(&self.written)
    }
}

/// The objects of an export with their names in the mesh and in the file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct NameTable {
    /// The objects, by kind and number.
    pub entries: Vec<NameEntry>,
}

impl NameTable {
    /// Returns `true` if a reader of the file needs the table: if names changed (other than in case), or
    /// are numbers in the file.
    pub fn is_needed(&self) -> bool {
        (self.entries.iter()).any(|entry| entry.is_numbered || entry.is_changed())
    }

    /// Returns the table as lines that begin with `prefix`; empty if no reader needs it.
    pub fn comments(&self, prefix: &str) -> String {
        if !self.is_needed() {
            return String::new();
        }
        let line = |e: &NameEntry| {
            let name = e.name.replace(char::is_control, " ");
            format!(
                "{prefix}{} {} '{name}' is {}\n",
                e.kind, e.number, e.written
            )
        };
        let head = format!("{prefix}names in the mesh and in this file:\n");
        head + &self.entries.iter().map(line).collect::<String>()
    }

    /// Returns the table as a CSV file.
    pub fn csv(&self) -> String {
        let line = |e: &NameEntry| {
            let [name, written] = [&e.name, &e.written].map(|text| csv_field(text));
            format!("{},{},{name},{written}\n", e.kind, e.number)
        };
        let rows: String = self.entries.iter().map(line).collect();
        format!("kind,number,name,written\n{rows}")
    }

    /// Returns a sentence about the given names that changed, if any did. `place` says where the table is.
    pub fn note(&self, place: &str) -> Option<String> {
        let changed: Vec<String> = (self.entries.iter())
            .filter(|entry| entry.is_changed() && entry.is_given)
            .map(|e| format!("{} '{}' is {}", e.kind, e.name, e.written))
            .collect();
        if changed.is_empty() {
            return None;
        }
        let listed = changed[..changed.len().min(MAX_LISTED_NAMES)].join(", ");
        let more = if changed.len() > MAX_LISTED_NAMES {
            ", ..."
        } else {
            ""
        };
        Some(format!(
            "{} of {} names are changed, because the format does not hold them or others have them: \
             {listed}{more} (all: {place})",
            changed.len(),
            self.entries.len(),
        ))
    }
}
