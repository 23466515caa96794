//! Reads the elements of an array cell by cell. A cell is a chunk, or an inner chunk of a shard.

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

/// Remedy for a damaged chunk.
const DAMAGED_REMEDY: &str = "copy or write the array again";

/// Number of cells per thread that are decoded at once.
const CELLS_PER_THREAD: usize = 2;

/// Index entry of a cell that is not in the shard.
const ABSENT: u64 = u64::MAX;

impl ArrayMetadata {
    /// Returns the number of elements along the last three axes, the slowest first, or `None` if an
    /// earlier axis has more than one element or there is only one axis.
    pub fn volume_shape(&self) -> Option<[usize; 3]> {
        let axes = self.shape.len();
        let leading = axes.saturating_sub(3);
        (self.shape[..leading].iter().all(|&n| n == 1) && axes >= 2)
            .then(|| last_three(&self.shape))
    }

    /// Returns the bytes of the elements of a cell, or `None` if no chunk holds it. `cell` is the
    /// index of the cell along each axis.
    fn read_cell(&self, cell: &[usize]) -> Result<Option<Vec<u8>>> {
        let codecs = &self.codecs;
        let Some(shard) = &codecs.shard else {
            let path = self.chunk_file(cell);
            let Some((file, length)) = open_chunk(&path)? else {
                return Ok(None);
            };
            let packed = read_range(&path, &file, 0, length, length)?;
            let decoded = codecs.cell_codecs.decode_cell(packed, &codecs.cell_shape);
            return decoded
                .map(Some)
                .map_err(|problem| chunk_error(&path, &problem));
        };
        let for_each_axis = |op: fn(usize, usize) -> usize| -> Vec<usize> {
            cell.iter()
                .zip(&shard.cell_counts)
                .map(|(&c, &n)| op(c, n))
                .collect()
        };
        let path = self.chunk_file(&for_each_axis(|c, n| c / n));
        let Some((file, length)) = open_chunk(&path)? else {
            return Ok(None);
        };
        let cell_in_shard = for_each_axis(|c, n| c % n);
        let index = cell_in_shard
            .iter()
            .zip(&shard.cell_counts)
            .fold(0, |number, (c, n)| number * n + c);
        let Some((start, count)) = shard_entry(shard, &path, &file, length, index)? else {
            return Ok(None);
        };
        let packed = read_range(&path, &file, start, count, length)?;
        let decoded = codecs.cell_codecs.decode_cell(packed, &codecs.cell_shape);
        let to_error =
            |problem: CodecError| chunk_error(&path, &format!("chunk {cell_in_shard:?} {problem}"));
        decoded.map(Some).map_err(to_error)
    }

    /// Reads all elements of a small array.
    ///
    /// # Errors
    /// Returns an [`Error::Io`] if chunks cannot be read, and an [`Error::Job`] if there is not
    /// enough memory.
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

    /// Decodes one element.
    fn decode_element(&self, raw: &[u8]) -> f64 {
        use SampleType::*;
        let encoding = self.codecs.cell_codecs.encoding;
        // Bytes with the most significant byte first.
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

    /// Fills `out` with a range of rows of consecutive planes along the last two axes, beginning
    /// with plane `first` of the third last axis.
    fn gather<T: Copy + Send>(
        &self,
        first: usize,
        row_range: Range<usize>,
        out: &mut [T],
        fill: T,
        decode: impl Fn(&[u8]) -> Vec<T> + Sync,
    ) -> Result<()> {
        let [nz, _, nx] = last_three(&self.shape);
        let [cz, cy, cx] = last_three(&self.codecs.cell_shape);
        let (first_row_cell, row_count) = (row_range.start / cy, row_range.len());
        let end_plane = (first + out.len() / (row_count * nx).max(1)).min(nz);
        let axes = self.shape.len();
        let cells = [
            end_plane.div_ceil(cz).saturating_sub(first / cz),
            row_range.end.div_ceil(cy).saturating_sub(first_row_cell),
            nx.div_ceil(cx),
        ];
        let count: usize = cells.iter().product();
        let cell_at = |number: usize| {
            let [_, rows, columns] = cells;
            let (plane, rest) = (number / (rows * columns), number % (rows * columns));
            [
                first / cz + plane,
                first_row_cell + rest / columns,
                rest % columns,
            ]
        };
        let batch = CELLS_PER_THREAD * rayon::current_num_threads();
        for start in (0..count).step_by(batch) {
            let numbers = start..(start + batch).min(count);
            let decoded: Vec<Option<Vec<T>>> = (numbers.clone().into_par_iter())
                .map(|number| {
                    // All axes before the last three have one element.
                    let mut cell = vec![0; axes.saturating_sub(3)];
                    cell.extend(&cell_at(number)[3 - axes.min(3)..]);
                    Ok(self.read_cell(&cell)?.map(|bytes| decode(&bytes)))
                })
                .collect::<Result<_>>()?;
            for (number, values) in numbers.zip(decoded) {
                let [k, j, i] = cell_at(number);
                let [z0, y0, x0] = [k * cz, j * cy, i * cx];
                let width = cx.min(nx - x0);
                for z in z0.max(first)..(z0 + cz).min(end_plane) {
                    for y in y0.max(row_range.start)..(y0 + cy).min(row_range.end) {
                        let target = ((z - first) * row_count + y - row_range.start) * nx + x0;
                        let row = &mut out[target..target + width];
                        match &values {
                            None => row.fill(fill),
                            Some(values) => {
                                let source = ((z - z0) * cy + y - y0) * cx;
                                row.copy_from_slice(&values[source..source + width]);
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
        let batch = self.batch_planes();
        for first in (0..nz).step_by(batch.max(1)) {
            let planes = batch.min(nz - first);
            let mut out = vec![0i128; planes * nx * ny];
            self.gather(first, 0..ny, &mut out, self.fill_value as i128, |bytes| {
                encoding.integers(bytes).collect()
            })?;
            collector.extend(out);
        }
        Ok(Some(collector.finish()))
    }
}

/// Returns the last three of these numbers, with 1 in place of missing ones at the front.
fn last_three(counts: &[usize]) -> [usize; 3] {
    let axes = counts.len();
    std::array::from_fn(|k| (axes + k).checked_sub(3).map_or(1, |index| counts[index]))
}

/// Opens the file of a chunk and returns it with its length, or `None` if it does not exist.
fn open_chunk(path: &Path) -> Result<Option<(File, u64)>> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(io_error(path, "open", error)),
    };
    let metadata = file.metadata().map_err(|e| io_error(path, "read", e))?;
    if metadata.is_file() {
        Ok(Some((file, metadata.len())))
    } else {
        Err(chunk_error(path, "is not a file"))
    }
}

/// Reads a part of the file of a chunk, which is `length` bytes long.
fn read_range(path: &Path, file: &File, start: u64, count: u64, length: u64) -> Result<Vec<u8>> {
    if start.checked_add(count).is_none_or(|end| end > length) {
        let problem = format!(
            "is cut off: it has {length} bytes, but its index names {count} bytes at {start}"
        );
        return Err(chunk_error(path, &problem));
    }
    memory::ensure_available(path.display(), count as f64, "a chunk", DAMAGED_REMEDY)?;
    let mut bytes = vec![0; count as usize];
    read_exact_at(file, &mut bytes, start).map_err(|e| io_error(path, "read", e))?;
    Ok(bytes)
}

/// Returns the offset and the number of bytes of a cell in a shard file of `length` bytes, or
/// `None` if the cell is not in the shard.
fn shard_entry(
    shard: &Shard,
    path: &Path,
    file: &File,
    length: u64,
    number: usize,
) -> Result<Option<(u64, u64)>> {
    let size = shard.index_bytes() as u64;
    let offset = if shard.is_index_at_end {
        length.saturating_sub(size)
    } else {
        0
    };
    let mut shape = shard.cell_counts.clone();
    shape.push(2);
    let index = read_range(path, file, offset, size, length)?;
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
