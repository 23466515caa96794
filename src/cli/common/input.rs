//! How to read an image whose file does not say it all.

use clap::Args;
use serde::{Deserialize, Serialize};

use crate::image::formats::{ReadOptions, SegyBytes};
use crate::{Error, Result};

/// How to read an image whose file does not say it all.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct InputOptions {
    /// The file is bare samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g. 100x400x208:f32be
    #[arg(long, value_name = "DIMS:TYPE")]
    pub raw: Option<String>,
    /// SEG-Y: trace header byte of the inline number [default: 189]
    #[arg(long, value_name = "BYTE")]
    pub inline_byte: Option<usize>,
    /// SEG-Y: trace header byte of the crossline number [default: 193]
    #[arg(long, value_name = "BYTE")]
    pub crossline_byte: Option<usize>,
    /// SEG-Y: trace header byte of the x coordinate [default: 181]
    #[arg(long, value_name = "BYTE")]
    pub x_byte: Option<usize>,
    /// SEG-Y: trace header byte of the y coordinate [default: 185]
    #[arg(long, value_name = "BYTE")]
    pub y_byte: Option<usize>,
    /// SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    #[arg(long, value_name = "BYTE")]
    pub scalar_byte: Option<usize>,
    /// SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    #[arg(long, value_name = "BYTE")]
    pub delay_byte: Option<usize>,
    /// SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    #[arg(long, value_name = "BYTE")]
    pub interval_byte: Option<usize>,
}

impl InputOptions {
    /// What the reader is told.
    ///
    /// # Errors
    /// [`Error::Job`] if `--raw` cannot be understood or a byte lies outside a trace header.
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
                .map_err(|error: Error| error.at(format!("--raw {text}")))
        };
        let raw = self.raw.as_ref().map(raw).transpose()?;
        Ok(ReadOptions { raw, segy })
    }
}
