//! Values of options that are parsed from a text and displayed as one. TOML, JSON and other languages
//! may also hold them as numbers and lists.
//!
//! - `values`: types of values that several verbs share

mod values;

use std::collections::BTreeMap;
use std::fmt::Display;
use std::str::FromStr;

use serde::{Deserialize, Deserializer};

pub use values::{InvalidValue, Length, NumberOrFile, PointValue, SignedAxis, ThresholdValues};
pub(crate) use values::{finite_number, finite_numbers, joined, names_image, parse_number};

/// The value of an option as TOML, JSON and other languages may hold it.
#[derive(Deserialize)]
#[serde(untagged, expecting = "give a text, a number or a list")]
enum LooseValue {
    Text(String),
    Whole(i64),
    Number(f64),
    List(Vec<Self>),
    Table(BTreeMap<String, Self>),
}

impl LooseValue {
    /// Returns the value as a text. `separators` stand between numbers, and between other items.
    fn to_text(&self, separators: Separators) -> String {
        let joined = |items: Vec<String>, separator| items.join(separator);
        match self {
            Self::Text(text) => text.clone(),
            Self::Whole(number) => number.to_string(),
            Self::Number(number) => number.to_string(),
            Self::List(items) => {
                let are_numbers =
                    (items.iter()).all(|item| matches!(item, Self::Whole(_) | Self::Number(_)));
                let separator = separators[usize::from(!are_numbers)];
                let texts = items.iter().map(|item| item.to_text([",", ","]));
                joined(texts.collect(), separator)
            }
            Self::Table(items) => {
                let pair =
                    |(name, item): (&String, &Self)| format!("{name}={}", item.to_text([","; 2]));
                joined(items.iter().map(pair).collect(), ",")
            }
        }
    }
}

/// The separators between the numbers of a list, and between other items: `[",", ":"]` for
/// `X,Y,Z:VALUE`.
pub(crate) type Separators = [&'static str; 2];

/// Reads a value from a text, a number, or a list.
pub(crate) fn deserialize_text<'de, T, D>(
    deserializer: D,
    separators: Separators,
) -> Result<T, D::Error>
where
    T: FromStr<Err: Display>,
    D: Deserializer<'de>,
{
    let text = LooseValue::deserialize(deserializer)?.to_text(separators);
    text.parse()
        .map_err(|error| serde::de::Error::custom(format!("'{text}' {error}")))
}

/// Makes types that are parsed from a text and displayed as one serialisable as this text. They are
/// also read from lists, whose items have [`Separators`] between them.
macro_rules! serde_as_text {
    ($($name:ty: $separators:expr),+ $(,)?) => {$(
        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(
                &self,
                serializer: S,
            ) -> std::result::Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(
                deserializer: D,
            ) -> std::result::Result<Self, D::Error> {
                $crate::option_text::deserialize_text(deserializer, $separators)
            }
        }
    )+};
}
pub(crate) use serde_as_text;

/// Reads an optional text from a text, a number, or a list of them.
pub(crate) fn deserialize_optional<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<String>, D::Error> {
    let value = Option::<LooseValue>::deserialize(deserializer)?;
    Ok(value.map(|value| value.to_text([","; 2])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_become_texts() {
        for (json, expected) in [
            ("[1, 2.5]", "1,2.5"),
            ("[[1, 2, 3], 0.5]", "1,2,3:0.5"),
            ("[\"a\", 3]", "a:3"),
            (
                "[5, {\"distance\": 3, \"name\": \"core\"}]",
                "5:distance=3,name=core",
            ),
            ("-999.25", "-999.25"),
            ("\"x\"", "x"),
        ] {
            let value: LooseValue = serde_json::from_str(json).unwrap();
            assert_eq!(value.to_text([",", ":"]), expected);
        }
        assert!(serde_json::from_str::<LooseValue>("true").is_err());
    }
}
