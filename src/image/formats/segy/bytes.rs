//! Bytes of SEG-Y trace headers that hold the fields of a trace.

use std::str::FromStr;

use crate::error::{Error, Result, cause};

/// Length of a standard trace header in bytes.
pub const TRACE_HEADER_BYTES: usize = 240;

/// First bytes, counted from 1 as in the standard, of the trace header fields that place a trace.
/// An optional field set to 0 is not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SegyBytes {
    /// Inline number, 4 bytes.
    pub inline: usize,
    /// Crossline number, 4 bytes.
    pub crossline: usize,
    /// X coordinate, 4 bytes; optional.
    pub x: usize,
    /// Y coordinate, 4 bytes; optional.
    pub y: usize,
    /// Coordinate scalar, 2 bytes: divides if negative, multiplies if positive; optional.
    pub scalar: usize,
    /// Delay recording time: time of the first sample in ms, 2 bytes; optional.
    pub delay: usize,
    /// Sample interval in microseconds, 2 bytes; used where the file header has none; optional.
    pub dt: usize,
    /// `true` if the samples are in depth: intervals are then in thousandths of a metre or foot. If
    /// `None`, they are in two-way time unless the textual header says otherwise.
    pub is_depth: Option<bool>,
}

impl Default for SegyBytes {
    /// Returns the bytes of the SEG-Y standard since revision 1.
    fn default() -> Self {
        Self {
            inline: 189,
            crossline: 193,
            x: 181,
            y: 185,
            scalar: 71,
            delay: 109,
            dt: 117,
            is_depth: None,
        }
    }
}

impl FromStr for SegyBytes {
    type Err = Error;

    /// Parses `inline=9,crossline=21,x=73,y=77,scalar=71,delay=109,dt=117`. Each entry is optional;
    /// missing fields keep the bytes of the standard.
    fn from_str(text: &str) -> Result<Self> {
        let mut bytes = Self::default();
        for entry in text.split(',').filter(|entry| !entry.trim().is_empty()) {
            let (name, byte) = entry.split_once('=').unwrap_or((entry, ""));
            let field = match name.trim() {
                "inline" => &mut bytes.inline,
                "crossline" => &mut bytes.crossline,
                "x" => &mut bytes.x,
                "y" => &mut bytes.y,
                "scalar" => &mut bytes.scalar,
                "delay" => &mut bytes.delay,
                "dt" => &mut bytes.dt,
                other => {
                    return Err(option_error(
                        format!("'{other}' is not a field of the trace header"),
                        "use inline, crossline, x, y, scalar, delay or dt, e.g. inline=9,crossline=21",
                    ));
                }
            };
            *field = byte.trim().parse().map_err(|e| {
                let problem = format!("'{entry}' does not say a byte");
                option_error(problem, "write e.g. inline=9").with_source(e)
            })?;
        }
        bytes.check()?;
        Ok(bytes)
    }
}

fn option_error(problem: String, remedy: &str) -> Error {
    Error::Io(cause("SEG-Y header bytes", problem, remedy))
}

impl SegyBytes {
    /// Checks that every field lies within the 240 bytes of a trace header, that the line numbers
    /// are given, and that both or neither of the coordinates are given.
    ///
    /// # Errors
    /// Returns an [`Error::Io`] that names the wrong field.
    pub fn check(&self) -> Result<()> {
        let fields = [
            ("inline", self.inline, 4, false),
            ("crossline", self.crossline, 4, false),
            ("x", self.x, 4, true),
            ("y", self.y, 4, true),
            ("scalar", self.scalar, 2, true),
            ("delay", self.delay, 2, true),
            ("dt", self.dt, 2, true),
        ];
        for (name, byte, width, optional) in fields {
            let last = TRACE_HEADER_BYTES + 1 - width;
            if byte > last || (byte == 0 && !optional) {
                return Err(option_error(
                    format!("{name}={byte} lies outside the trace header"),
                    &format!("use a byte from 1 to {last}"),
                ));
            }
        }
        if (self.x == 0) != (self.y == 0) {
            return Err(option_error(
                "only one of x and y is 0".into(),
                "give both bytes or set both to 0",
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_overridden_one_by_one() {
        let bytes: SegyBytes = "inline=9, crossline=21,delay=0".parse().unwrap();
        let default = SegyBytes::default();
        let expected = SegyBytes {
            inline: 9,
            crossline: 21,
            delay: 0,
            ..default
        };
        assert_eq!(bytes, expected);
        assert_eq!("".parse::<SegyBytes>().unwrap(), default);
        for bad in [
            "inline",
            "inline=x",
            "line=3",
            "inline=238",
            "crossline=0",
            "x=0",
            "dt=240",
        ] {
            assert!(bad.parse::<SegyBytes>().is_err(), "{bad}");
        }
    }
}
