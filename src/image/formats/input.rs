//! How to read an image whose file does not say it all, as a user says it.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Format, ReadOptions, SegyBytes, detect};
use crate::error::cause;
use crate::{Error, Result};

/// How to read an image whose file does not say it all.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::Args))]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct InputOptions {
    /// The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g. 100x400x208:f32be
    #[cfg_attr(feature = "cli", arg(long, value_name = "DIMS:TYPE"))]
    pub raw: Option<String>,
    /// SEG-Y: trace header byte of the inline number [default: 189]
    #[cfg_attr(feature = "cli", arg(long, value_name = "BYTE"))]
    pub inline_byte: Option<usize>,
    /// SEG-Y: trace header byte of the crossline number [default: 193]
    #[cfg_attr(feature = "cli", arg(long, value_name = "BYTE"))]
    pub crossline_byte: Option<usize>,
    /// SEG-Y: trace header byte of the x coordinate [default: 181]
    #[cfg_attr(feature = "cli", arg(long, value_name = "BYTE"))]
    pub x_byte: Option<usize>,
    /// SEG-Y: trace header byte of the y coordinate [default: 185]
    #[cfg_attr(feature = "cli", arg(long, value_name = "BYTE"))]
    pub y_byte: Option<usize>,
    /// SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    #[cfg_attr(feature = "cli", arg(long, value_name = "BYTE"))]
    pub scalar_byte: Option<usize>,
    /// SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    #[cfg_attr(feature = "cli", arg(long, value_name = "BYTE"))]
    pub delay_byte: Option<usize>,
    /// SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    #[cfg_attr(feature = "cli", arg(long, value_name = "BYTE"))]
    pub interval_byte: Option<usize>,
}

impl InputOptions {
    /// Checks that nothing is said where no image is read; `why` says why none is.
    ///
    /// # Errors
    /// [`Error::Job`] if something is.
    pub fn refuse_unused(&self, why: &str) -> Result<()> {
        if *self == Self::default() {
            return Ok(());
        }
        Err(Error::Job(cause(
            "how to read the image",
            format!("is given, but {why}"),
            "omit it",
        )))
    }

    /// What the reader is told.
    ///
    /// # Errors
    /// [`Error::Job`] if the description of bare samples cannot be understood or a byte lies outside a
    /// trace header.
    pub fn read_options(&self) -> Result<ReadOptions> {
        let standard = SegyBytes::default();
        let segy = SegyBytes {
            inline: self.inline_byte.unwrap_or(standard.inline),
            crossline: self.crossline_byte.unwrap_or(standard.crossline),
            x: self.x_byte.unwrap_or(standard.x),
            y: self.y_byte.unwrap_or(standard.y),
            scalar: self.scalar_byte.unwrap_or(standard.scalar),
            delay: self.delay_byte.unwrap_or(standard.delay),
            dt: self.interval_byte.unwrap_or(standard.dt),
        };
        segy.check()?;
        let raw = |text: &String| -> Result<_> {
            text.parse()
                .map_err(|error: Error| error.at(format!("raw {text}")))
        };
        let raw = self.raw.as_ref().map(raw).transpose()?;
        Ok(ReadOptions { raw, segy })
    }

    /// These, and those of `below` where these are silent.
    pub fn over(&self, below: &Self) -> Self {
        Self {
            raw: self.raw.clone().or_else(|| below.raw.clone()),
            inline_byte: self.inline_byte.or(below.inline_byte),
            crossline_byte: self.crossline_byte.or(below.crossline_byte),
            x_byte: self.x_byte.or(below.x_byte),
            y_byte: self.y_byte.or(below.y_byte),
            scalar_byte: self.scalar_byte.or(below.scalar_byte),
            delay_byte: self.delay_byte.or(below.delay_byte),
            interval_byte: self.interval_byte.or(below.interval_byte),
        }
    }

    /// What the reader of this file is told.
    ///
    /// # Errors
    /// Those of [`InputOptions::read_options`] and [`detect`], and [`Error::Job`] if header bytes of
    /// SEG-Y files are given for a file that is none.
    pub fn for_file(&self, path: &Path) -> Result<ReadOptions> {
        let options = self.read_options()?;
        let bytes = [
            ("inline-byte", self.inline_byte),
            ("crossline-byte", self.crossline_byte),
            ("x-byte", self.x_byte),
            ("y-byte", self.y_byte),
            ("scalar-byte", self.scalar_byte),
            ("delay-byte", self.delay_byte),
            ("interval-byte", self.interval_byte),
        ];
        if let Some((name, byte)) = bytes.iter().find_map(|(name, byte)| Some((name, (*byte)?))) {
            let format = detect(path, &options)?;
            if format != Format::Segy {
                return Err(Error::Job(cause(
                    format!("{name} {byte}"),
                    format!(
                        "applies to SEG-Y, but {} is read as {format}",
                        path.display()
                    ),
                    "omit it",
                )));
            }
        }
        Ok(options)
    }
}
