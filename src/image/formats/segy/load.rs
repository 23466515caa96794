//! Reads the samples of a survey as those of an image.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::parallel::prelude::*;

use super::file_header::SegyFile;
use super::grid::{NO_TRACE, TraceGrid};
use super::survey::SegySurvey;
use crate::error::{Error, Result, cause, io_error};
use crate::files::read_exact_at;
use crate::image::formats::ImageFormat;
use crate::image::formats::samples::{Endian, SampleType};
use crate::image::formats::stream::{ImageHeader, ImageStream, PlaneReader};

impl SegySurvey {
    /// Returns the number of samples along each axis, and a flag per row: `true` if the row has no
    /// trace.
    fn dims_and_missing(&self) -> ([usize; 3], Vec<bool>) {
        let Some(grid) = &self.grid else {
            return ([0; 3], Vec::new());
        };
        let lines = [grid.crossline.count, grid.inline.count].map(|count| count as usize);
        let missing = grid.traces.iter().map(|&trace| trace == NO_TRACE).collect();
        ([self.file.samples_per_trace, lines[0], lines[1]], missing)
    }

    /// Returns the image with its samples still in the file. Cells without a trace are zero.
    ///
    /// # Errors
    /// Returns an [`Error::Io`] if the traces do not form a grid, or if some of them cannot be
    /// read.
    pub(in crate::image::formats) fn into_stream(mut self, path: &Path) -> Result<ImageStream> {
        let (dims, missing) = self.dims_and_missing();
        let no_grid_error = || {
            Error::Io(cause(
                path.display(),
                "is not a survey with inlines and crosslines",
                "give the SEG-Y file of a volume",
            ))
        };
        let grid = self.grid.take().ok_or_else(no_grid_error)?;
        let warning = self.float_format_warning();
        self.notes
            .extend(warning.map_err(|e| io_error(path, "read", e))?);
        let lines = self.info.inlines.zip(self.info.crosslines);
        Ok(ImageStream {
            header: ImageHeader {
                dims,
                geometry: self.geometry,
                missing,
                label_names: Vec::new(),
                format: ImageFormat::Segy,
                encoding: self.info.encoding.clone(),
                notes: self.notes,
                line_numbers: lines.map(|(inlines, crosslines)| [inlines, crosslines]),
                survey: Some(self.info),
            },
            encoding: self.file.encoding,
            reader: Box::new(TracePlanes {
                path: path.to_path_buf(),
                file: self.file,
                grid,
            }),
            max_magnitude_bits: Default::default(),
        })
    }

    /// Returns a warning if a file that claims IBM floats seems to hold IEEE floats, which is a
    /// frequent mistake. The fraction of an IBM float starts with a hexadecimal digit other than
    /// zero; an IEEE float has a zero there once in 16 times.
    fn float_format_warning(&self) -> io::Result<Option<String>> {
        const TRACES_CHECKED: usize = 200;
        let layout = &self.file;
        if layout.encoding.sample_type != SampleType::Ibm32 {
            return Ok(None);
        }
        let top_byte = match layout.encoding.endian {
            Endian::Big => 1,
            Endian::Little => 2,
        };
        let (mut unnormal, mut nonzero) = (0, 0);
        let mut trace = vec![0; layout.trace_bytes() as usize];
        for i in (0..layout.trace_count).step_by(layout.trace_count / TRACES_CHECKED + 1) {
            let offset = layout.traces_offset + i as u64 * layout.trace_bytes();
            read_exact_at(&layout.file, &mut trace, offset)?;
            for sample in trace[layout.trace_header_bytes..].as_chunks::<4>().0 {
                let is_zero = *sample == [0; 4];
                nonzero += usize::from(!is_zero);
                unnormal += usize::from(!is_zero && sample[top_byte] < 0x10);
            }
        }
        Ok((nonzero > 1000 && 50 * unnormal > nonzero).then(|| {
            format!(
                "{:.0} % of the samples are unusual for IBM floats: if the values make no sense, they are IEEE floats and the sample format (bytes 3225-3226) should be 5",
                100.0 * unnormal as f64 / nonzero as f64
            )
        }))
    }
}

/// Reader of the traces of a survey, as planes of an image.
struct TracePlanes {
    path: PathBuf,
    file: SegyFile,
    grid: TraceGrid,
}

impl PlaneReader for TracePlanes {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let layout = &self.file;
        let samples = layout.samples_per_trace;
        let crosslines = self.grid.crossline.count as usize;
        let trace_bytes = layout.trace_bytes() as usize;
        // Neighbouring cells whose traces are consecutive in the file are read together.
        let max_run = (1 << 18) / trace_bytes + 1;
        out.par_chunks_mut(rows.len() * samples)
            .zip(self.grid.traces[first * crosslines..].par_chunks(crosslines))
            .try_for_each_init(Vec::new, |buffer, (mut out, traces)| {
                let mut traces = &traces[rows.clone()];
                while let Some(&first) = traces.first() {
                    let continues_run = |(i, &trace): (usize, &usize)| {
                        first != NO_TRACE && i < max_run && trace == first + i
                    };
                    let run = traces
                        .iter()
                        .enumerate()
                        .take_while(|&t| continues_run(t))
                        .count();
                    let cells = run.max(1);
                    let (head, tail) = out.split_at_mut(cells * samples);
                    if run == 0 {
                        head.fill(0.0);
                    } else {
                        buffer.resize(run * trace_bytes, 0);
                        let offset = layout.traces_offset + (first * trace_bytes) as u64;
                        read_exact_at(&layout.file, buffer, offset)?;
                        let traces = buffer.chunks(trace_bytes);
                        for (trace, out) in traces.zip(head.chunks_mut(samples)) {
                            layout
                                .encoding
                                .decode(&trace[layout.trace_header_bytes..], out);
                        }
                    }
                    traces = &traces[cells..];
                    out = tail;
                }
                Ok::<_, io::Error>(())
            })
            .map_err(|e| io_error(&self.path, "read", e))
    }
}
