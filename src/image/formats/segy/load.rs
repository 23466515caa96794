//! The samples of a survey, put into an image.

use std::io;

use rayon::prelude::*;

use super::grid::MISSING;
use super::survey::Survey;
use crate::files::read_exact_at;
use crate::image::Image;
use crate::image::formats::samples::{Endian, SampleType};

impl Survey {
    /// How many samples the volume has.
    pub fn count(&self) -> usize {
        let cells = self.grid.as_ref().map_or(0, |grid| grid.trace.len());
        cells.saturating_mul(self.layout.samples)
    }

    /// How many samples there are along each axis, and which rows of them have no trace.
    pub fn extent(&self) -> ([usize; 3], Vec<bool>) {
        let Some(grid) = &self.grid else {
            return ([0; 3], Vec::new());
        };
        let lines = [grid.crossline.count, grid.inline.count].map(|count| count as usize);
        let missing = grid.trace.iter().map(|&trace| trace == MISSING).collect();
        ([self.layout.samples, lines[0], lines[1]], missing)
    }

    /// Reads the samples. Cells without a trace are zero. Adds a note if the samples look wrong.
    ///
    /// # Errors
    /// What the operating system reports.
    pub fn load(&mut self) -> io::Result<Image<3>> {
        let Some(grid) = &self.grid else {
            return Err(io::Error::other("no grid of traces"));
        };
        let layout = &self.layout;
        let samples = layout.samples;
        let crosslines = grid.crossline.count as usize;
        let trace_bytes = layout.trace_bytes() as usize;
        // Neighbouring cells whose traces follow one another in the file are read together.
        let longest = (1 << 18) / trace_bytes + 1;

        let mut out = vec![0.0; grid.trace.len() * samples];
        out.par_chunks_mut(crosslines * samples)
            .zip(grid.trace.par_chunks(crosslines))
            .try_for_each_init(Vec::new, |buffer, (mut out, mut traces)| {
                while let Some(&first) = traces.first() {
                    let follows = |(i, &trace): (usize, &usize)| {
                        first != MISSING && i < longest && trace == first + i
                    };
                    let run = traces
                        .iter()
                        .enumerate()
                        .take_while(|&t| follows(t))
                        .count();
                    if run > 0 {
                        buffer.resize(run * trace_bytes, 0);
                        let offset = layout.start + (first * trace_bytes) as u64;
                        read_exact_at(&layout.file, buffer, offset)?;
                        for (trace, out) in buffer.chunks(trace_bytes).zip(out.chunks_mut(samples))
                        {
                            layout.encoding.decode(&trace[layout.trace_header..], out);
                        }
                    }
                    let done = run.max(1);
                    traces = &traces[done..];
                    out = &mut out[done * samples..];
                }
                Ok::<_, io::Error>(())
            })?;
        let doubts = layout
            .encoding
            .rounding_note(&out)
            .or(self.doubtful_floats()?);
        self.notes.extend(doubts);
        let (dims, missing) = self.extent();
        Ok(Image::new(dims, out, self.geometry.clone()).with_missing(missing))
    }

    /// A warning if a file that claims IBM floats seems to hold IEEE ones, a frequent mistake. An
    /// IBM fraction starts with a digit other than zero, an IEEE float has a zero in that place once
    /// in 16 times.
    fn doubtful_floats(&self) -> io::Result<Option<String>> {
        const TRACES: usize = 200;
        let layout = &self.layout;
        if layout.encoding.sample != SampleType::Ibm32 {
            return Ok(None);
        }
        let top_byte = match layout.encoding.endian {
            Endian::Big => 1,
            Endian::Little => 2,
        };
        let (mut unnormal, mut nonzero) = (0, 0);
        let mut trace = vec![0; layout.trace_bytes() as usize];
        for i in (0..layout.traces).step_by(layout.traces / TRACES + 1) {
            let offset = layout.start + i as u64 * layout.trace_bytes();
            read_exact_at(&layout.file, &mut trace, offset)?;
            for sample in trace[layout.trace_header..].as_chunks::<4>().0 {
                let is_zero = *sample == [0; 4];
                nonzero += usize::from(!is_zero);
                unnormal += usize::from(!is_zero && sample[top_byte] < 0x10);
            }
        }
        Ok((nonzero > 1000 && 50 * unnormal > nonzero).then(|| {
            format!(
                "{:.0} % of the samples are odd for IBM floats: if the values make no sense, they are IEEE floats and the sample format (bytes 3225-3226) should be 5",
                100.0 * unnormal as f64 / nonzero as f64
            )
        }))
    }
}
