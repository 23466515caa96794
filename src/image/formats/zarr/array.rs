//! Elements of an array, cell by cell: a cell is a chunk, or one of those within a shard.

use std::fs::File;
use std::io::ErrorKind;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use crate::parallel::prelude::*;

use super::codecs::{CodecError, Shard};
use super::metadata::ArrayMetadata;
use crate::error::{Error, Result, cause, io_error};
use crate::files::read_exact_at;
use crate::image::ExactLabels;
use crate::image::formats::samples::{self, SampleType};
use crate::image::formats::stream::PlaneReader;
use crate::image::labels::LabelCollector;
use crate::memory;

/// What to do about a damaged chunk.
const DAMAGED_REMEDY: &str = "copy or write the array again";

/// Cells decoded at once for each thread.
const CELLS_PER_THREAD: usize = 2;

/// An index entry of a cell that no shard holds.
const ABSENT: u64 = u64::MAX;

impl ArrayMetadata {
    /// Elements along the last three axes, the slowest first; all before these have one.
    pub fn volume_shape(&self) -> Option<[usize; 3]> {
        let axes = self.shape.len();
        let before = axes.saturating_sub(3);
        (self.shape[..before].iter().all(|&n| n == 1) && axes >= 2).then(|| last_three(&self.shape))
    }

    /// The bytes of the elements of a cell, given by its number along each axis; `None` where no chunk
    /// holds it.
    fn read_cell(&self, cell: &[usize]) -> Result<Option<Vec<u8>>> {
        let codecs = &self.codecs;
        let Some(shard) = &codecs.shard else {
            let path = self.chunk_file(cell);
            let Some((file, length)) = open_chunk(&path)? else {
                return Ok(None);
            };
            let packed = read_range(&path, &file, 0, length, length)?;
            let done = codecs.cell_codecs.decode_cell(packed, &codecs.cell_shape);
            return done
                .map(Some)
                .map_err(|problem| chunk_error(&path, &problem));
        };
        let along = |of: fn(usize, usize) -> usize| -> Vec<usize> {
            cell.iter()
                .zip(&shard.cell_counts)
                .map(|(&c, &n)| of(c, n))
                .collect()
        };
        let path = self.chunk_file(&along(|c, n| c / n));
        let Some((file, length)) = open_chunk(&path)? else {
            return Ok(None);
        };
        let within = along(|c, n| c % n);
        let number = within
            .iter()
            .zip(&shard.cell_counts)
            .fold(0, |number, (c, n)| number * n + c);
        let Some((start, count)) = shard_entry(shard, &path, &file, length, number)? else {
            return Ok(None);
        };
        let packed = read_range(&path, &file, start, count, length)?;
        let done = codecs.cell_codecs.decode_cell(packed, &codecs.cell_shape);
        let told = |problem: CodecError| chunk_error(&path, &format!("chunk {within:?} {problem}"));
        done.map(Some).map_err(told)
    }

    /// All elements, of a small array.
    ///
    /// # Errors
    /// [`Error::Io`] for chunks that cannot be read, [`Error::Job`] if there is no memory for them.
    pub fn read_all(&self) -> Result<Vec<f64>> {
        let count: usize = self.shape.iter().product();
        let (place, remedy) = (self.folder.display(), "give a part of the image");
        memory::ensure_available(
            place,
            8.0 * count as f64,
            format!("{count} elements"),
            remedy,
        )?;
        let mut out = vec![self.fill_value; count];
        let size = self.codecs.cell_codecs.encoding.size();
        let rows = 0..last_three(&self.shape)[1];
        self.gather(0, rows, &mut out, self.fill_value, |bytes| {
            bytes
                .chunks_exact(size)
                .map(|raw| self.decode_element(raw))
                .collect()
        })?;
        Ok(out)
    }

    /// One element.
    fn decode_element(&self, raw: &[u8]) -> f64 {
        use SampleType::*;
        let encoding = self.codecs.cell_codecs.encoding;
        // In the order of this machine's numbers as they are written: most significant byte first.
        let mut bits = [0; 8];
        let bytes = &mut bits[8 - raw.len()..];
        bytes.copy_from_slice(raw);
        if encoding.endian == samples::Endian::Little {
            bytes.reverse();
        }
        let bits = u64::from_be_bytes(bits);
        match encoding.sample_type {
            F64 => f64::from_bits(bits),
            I64 => bits as i64 as f64,
            U64 | U32 => bits as f64,
            I32 => f64::from(bits as u32 as i32),
            _ => {
                let mut out = [0.0];
                encoding.decode(raw, &mut out);
                out[0].into()
            }
        }
    }

    /// Fills `out` with elements of these rows of planes along the last two axes, from plane `first` of the third
    /// last on.
    fn gather<T: Copy + Send>(
        &self,
        first: usize,
        within: Range<usize>,
        out: &mut [T],
        fill: T,
        decode: impl Fn(&[u8]) -> Vec<T> + Sync,
    ) -> Result<()> {
        let [nz, _, nx] = last_three(&self.shape);
        let [cz, cy, cx] = last_three(&self.codecs.cell_shape);
        let (begin, high) = (within.start / cy, within.len());
        let last = (first + out.len() / (high * nx).max(1)).min(nz);
        let axes = self.shape.len();
        let cells = [
            last.div_ceil(cz).saturating_sub(first / cz),
            within.end.div_ceil(cy).saturating_sub(begin),
            nx.div_ceil(cx),
        ];
        let count: usize = cells.iter().product();
        let place = |number: usize| {
            let [_, rows, columns] = cells;
            let (plane, rest) = (number / (rows * columns), number % (rows * columns));
            [first / cz + plane, begin + rest / columns, rest % columns]
        };
        let batch = CELLS_PER_THREAD * rayon::current_num_threads();
        for start in (0..count).step_by(batch) {
            let numbers = start..(start + batch).min(count);
            let decoded: Vec<Option<Vec<T>>> = (numbers.clone().into_par_iter())
                .map(|number| {
                    // All axes before the last three have one element.
                    let mut cell = vec![0; axes.saturating_sub(3)];
                    cell.extend(&place(number)[3 - axes.min(3)..]);
                    Ok(self.read_cell(&cell)?.map(|bytes| decode(&bytes)))
                })
                .collect::<Result<_>>()?;
            for (number, values) in numbers.zip(decoded) {
                let [k, j, i] = place(number);
                let [z0, y0, x0] = [k * cz, j * cy, i * cx];
                let wide = cx.min(nx - x0);
                for z in z0.max(first)..(z0 + cz).min(last) {
                    for y in y0.max(within.start)..(y0 + cy).min(within.end) {
                        let to = ((z - first) * high + y - within.start) * nx + x0;
                        let row = &mut out[to..to + wide];
                        match &values {
                            None => row.fill(fill),
                            Some(values) => {
                                let from = ((z - z0) * cy + y - y0) * cx;
                                row.copy_from_slice(&values[from..from + wide]);
                            }
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

impl PlaneReader for ArrayMetadata {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let encoding = self.codecs.cell_codecs.encoding;
        self.gather(first, rows, out, self.fill_value as f32, |bytes| {
            let mut values = vec![0.0; bytes.len() / encoding.size()];
            encoding.decode(bytes, &mut values);
            values
        })
    }

    fn batch_planes(&self) -> usize {
        last_three(&self.codecs.cell_shape)[0]
    }

    fn read_integers(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        let encoding = self.codecs.cell_codecs.encoding;
        if !encoding.is_wide_integer() {
            return Ok(None);
        }
        let [nx, ny, nz] = dims;
        let mut collector = LabelCollector::default();
        let together = self.batch_planes();
        for first in (0..nz).step_by(together.max(1)) {
            let planes = together.min(nz - first);
            let mut out = vec![0i128; planes * nx * ny];
            self.gather(first, 0..ny, &mut out, self.fill_value as i128, |bytes| {
                encoding.integers(bytes).collect()
            })?;
            collector.extend(out);
        }
        Ok(Some(collector.finish()))
    }
}

/// The last three of these numbers, with 1 for one that is missing before them.
fn last_three(counts: &[usize]) -> [usize; 3] {
    let axes = counts.len();
    std::array::from_fn(|k| (axes + k).checked_sub(3).map_or(1, |at| counts[at]))
}

/// A chunk's file and its length; `None` if it has none.
fn open_chunk(path: &Path) -> Result<Option<(File, u64)>> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(io_error(path, "open", error)),
    };
    let about = file.metadata().map_err(|e| io_error(path, "read", e))?;
    match about.is_file() {
        true => Ok(Some((file, about.len()))),
        false => Err(chunk_error(path, "is no file")),
    }
}

/// Part of a chunk's file, which has so many bytes.
fn read_range(path: &Path, file: &File, start: u64, count: u64, length: u64) -> Result<Vec<u8>> {
    if start.checked_add(count).is_none_or(|end| end > length) {
        let problem = format!("is cut off: bytes {start} + {count} of {length} are named");
        return Err(chunk_error(path, &problem));
    }
    memory::ensure_available(path.display(), count as f64, "a chunk", DAMAGED_REMEDY)?;
    let mut bytes = vec![0; count as usize];
    read_exact_at(file, &mut bytes, start).map_err(|e| io_error(path, "read", e))?;
    Ok(bytes)
}

/// Where a cell lies in a shard of so many bytes, and how many it has there.
fn shard_entry(
    shard: &Shard,
    path: &Path,
    file: &File,
    length: u64,
    number: usize,
) -> Result<Option<(u64, u64)>> {
    let size = shard.index_bytes() as u64;
    let at = match shard.is_index_at_end {
        true => length.saturating_sub(size),
        false => 0,
    };
    let mut shape = shard.cell_counts.clone();
    shape.push(2);
    let index = read_range(path, file, at, size, length)?;
    let index = shard.index_codecs.decode_cell(index, &shape);
    let index = index.map_err(|problem| chunk_error(path, &format!("its index {problem}")))?;
    let value = |k: usize| {
        let raw = index[8 * (2 * number + k)..].first_chunk::<8>();
        raw.map_or(ABSENT, |raw| match shard.index_codecs.encoding.endian {
            samples::Endian::Little => u64::from_le_bytes(*raw),
            samples::Endian::Big => u64::from_be_bytes(*raw),
        })
    };
    let (start, count) = (value(0), value(1));
    Ok(((start, count) != (ABSENT, ABSENT)).then_some((start, count)))
}

fn chunk_error(path: &Path, problem: &str) -> Error {
    Error::Io(cause(path.display(), problem, DAMAGED_REMEDY))
}
