//! Meanings of columns, and the names by which files call them.

use super::plain_name;

/// A meaning of a column, with the names by which files call it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Term {
    /// The name of the meaning, which is a name of columns, too.
    pub name: &'static str,
    /// Other names, in lower case without marks between words.
    pub aliases: &'static [&'static str],
    /// The quantity that its values measure.
    pub measure: Measure,
}

/// The quantity that a column measures, as far as its unit matters to all tables.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Measure {
    /// A length or a time of a place: a unit that is not known is an error.
    Place,
    /// An angle in degrees.
    Angle,
    /// Anything else.
    #[default]
    Other,
}

impl Term {
    /// Returns a term with these names.
    pub const fn new(name: &'static str, aliases: &'static [&'static str]) -> Self {
        Self {
            name,
            aliases,
            measure: Measure::Other,
        }
    }

    /// Returns the term as one whose values measure this quantity.
    pub const fn measuring(self, measure: Measure) -> Self {
        Self {
            name: self.name,
            aliases: self.aliases,
            measure,
        }
    }

    /// Returns `true` if a column of this name, in plain form, has this meaning.
    pub(super) fn is_called(&self, name: &str) -> bool {
        plain_name(self.name) == name || self.aliases.contains(&name)
    }
}

/// The term of x, and the names by which it is known.
pub const X_TERM: Term = Term::new(
    "x",
    &[
        "easting",
        "eastings",
        "east",
        "e",
        "utmx",
        "utme",
        "xutm",
        "xutme",
        "xcoord",
        "xcoordinate",
        "coordx",
        "xc",
        "xpos",
        "xposition",
        "cdpx",
        "xcdp",
        "mapx",
        "xmap",
        "worldx",
        "xworld",
        "realx",
        "xlocation",
        "xloc",
        "utmeasting",
        "eastingutm",
        "mapeasting",
        "xeast",
        "xeasting",
        "eastingx",
        "rechtswert",
        "surfacex",
        "pointx",
        "points0",
        "xmidpoint",
    ],
)
.measuring(Measure::Place);

/// The term of y, and the names by which it is known.
pub const Y_TERM: Term = Term::new(
    "y",
    &[
        "northing",
        "northings",
        "north",
        "n",
        "utmy",
        "utmn",
        "yutm",
        "yutmn",
        "ycoord",
        "ycoordinate",
        "coordy",
        "yc",
        "ypos",
        "yposition",
        "cdpy",
        "ycdp",
        "mapy",
        "ymap",
        "worldy",
        "yworld",
        "realy",
        "ylocation",
        "yloc",
        "utmnorthing",
        "northingutm",
        "mapnorthing",
        "ynorth",
        "ynorthing",
        "northingy",
        "hochwert",
        "surfacey",
        "pointy",
        "points1",
        "ymidpoint",
    ],
)
.measuring(Measure::Place);
