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
use crate::image::formats::samples;
use crate::image::formats::stream::PlaneReader;
use crate::image::labels::{ExactSample, LabelCollector};
use crate::memory;

/// Remedy for a damaged chunk.
const DAMAGED_REMEDY: &str = "copy or write the array again";

/// Number of cells per thread that are decoded at once.
const CELLS_PER_THREAD: usize = 2;

/// Memory for indices of shards, in bytes; one index may take more.
const MAX_INDEX_BYTES: usize = 1 << 25;

/// Index entry of a cell that is not in the shard.
const ABSENT: u64 = u64::MAX;

impl ArrayMetadata {
    /// Returns the number of elements along the three axes of an image, the slowest first, or `None`
    /// if another axis has more than one element or there is only one axis.
    pub fn volume_shape(&self) -> Option<[usize; 3]> {
        let others = (0..self.shape.len()).filter(|axis| !self.image_axes.contains(axis));
        let is_image = (2..=3).contains(&self.image_axes.len())
            && others.into_iter().all(|axis| self.shape[axis] == 1);
        is_image.then(|| self.along_image(&self.shape, 1))
    }

    /// Returns the values that belong to the three axes of an image, the slowest first, with `missing`
    /// in place of those of missing axes.
    fn along_image(&self, values: &[usize], missing: usize) -> [usize; 3] {
        let mut axes = self.image_axes.iter().rev();
        let mut out = [missing; 3];
        for value in out.iter_mut().rev() {
            *value = axes.next().map_or(missing, |&axis| values[axis]);
        }
        out
    }

    /// Returns the index of a cell along all axes from that along the axes of the image.
    fn cell_index(&self, along_image: [usize; 3]) -> Vec<usize> {
        let mut cell = vec![0; self.shape.len()];
        let numbers = along_image.into_iter().rev();
        for (&axis, number) in self.image_axes.iter().rev().zip(numbers) {
            cell[axis] = number;
        }
        cell
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
        let Some((start, count)) = shard.entry(&path, &file, length, index)? else {
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
        let encoding = self.codecs.cell_codecs.encoding;
        let rows = 0..self.along_image(&self.shape, 1)[1];
        self.gather(0, rows, &mut out, self.fill_value, |bytes| {
            encoding.numbers(bytes).collect()
        })?;
        Ok(out)
    }

    /// Fills `out` with a range of rows of consecutive planes of the image, beginning with plane
    /// `first`.
    fn gather<T: Copy + Send>(
        &self,
        first: usize,
        row_range: Range<usize>,
        out: &mut [T],
        fill: T,
        decode: impl Fn(&[u8]) -> Vec<T> + Sync,
    ) -> Result<()> {
        let [nz, _, nx] = self.along_image(&self.shape, 1);
        let [cz, cy, cx] = self.along_image(&self.codecs.cell_shape, 1);
        let [stride_z, stride_y, stride_x] = self.along_image(&strides(&self.codecs.cell_shape), 0);
        let (first_row_cell, row_count) = (row_range.start / cy, row_range.len());
        let end_plane = (first + out.len() / (row_count * nx).max(1)).min(nz);
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
                    let cell = self.cell_index(cell_at(number));
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
                                let source = (z - z0) * stride_z + (y - y0) * stride_y;
                                let row_values = values[source..].iter().step_by(stride_x.max(1));
                                row.iter_mut().zip(row_values).for_each(|(out, v)| *out = *v);
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
        self.along_image(&self.codecs.cell_shape, 1)[0]
    }

    fn read_exact_labels(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        let encoding = self.codecs.cell_codecs.encoding;
        let [nx, ny, nz] = dims;
        let mut collector = LabelCollector::default();
        let batch = self.batch_planes();
        let fill = ExactSample::from(self.fill_value);
        for first in (0..nz).step_by(batch.max(1)) {
            let planes = batch.min(nz - first);
            let mut out = vec![fill; planes * nx * ny];
            self.gather(first, 0..ny, &mut out, fill, |bytes| {
                encoding.exact_samples(bytes).collect()
            })?;
            if !collector.extend_exact(out) {
                return Ok(None);
            }
        }
        Ok(collector.finish_exact())
    }
}

/// Returns the distance in memory between neighbours along each axis of a cell.
fn strides(shape: &[usize]) -> Vec<usize> {
    let mut strides = vec![1; shape.len()];
    for axis in (1..shape.len()).rev() {
        strides[axis - 1] = strides[axis] * shape[axis];
    }
    strides
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

impl Shard {
    /// Returns the offset and the number of bytes of a cell in a shard file of `length` bytes, or
    /// `None` if the cell is not in the shard.
    fn entry(
        &self,
        path: &Path,
        file: &File,
        length: u64,
        cell: usize,
    ) -> Result<Option<(u64, u64)>> {
        let index = self.index(path, file, length)?;
        let value = |k: usize| {
            let raw = index[8 * (2 * cell + k)..].first_chunk::<8>();
            raw.map_or(ABSENT, |raw| match self.index_codecs.encoding.endian {
                samples::Endian::Little => u64::from_le_bytes(*raw),
                samples::Endian::Big => u64::from_be_bytes(*raw),
            })
        };
        let (start, count) = (value(0), value(1));
        Ok(((start, count) != (ABSENT, ABSENT)).then_some((start, count)))
    }

    /// Returns the decoded index of a shard file of `length` bytes. The indices of the shards that
    /// were read last stay in memory.
    fn index(&self, path: &Path, file: &File, length: u64) -> Result<Arc<Vec<u8>>> {
        let lock = || self.recent_indices.lock().unwrap_or_else(|e| e.into_inner());
        if let Some((_, index)) = lock().iter().find(|(of, _)| of == path) {
            return Ok(index.clone());
        }
        let size = self.index_bytes() as u64;
        let offset = if self.is_index_at_end {
            length.saturating_sub(size)
        } else {
            0
        };
        let mut shape = self.cell_counts.clone();
        shape.push(2);
        let packed = read_range(path, file, offset, size, length)?;
        let index = self.index_codecs.decode_cell(packed, &shape);
        let index = index.map_err(|problem| chunk_error(path, &format!("its index {problem}")))?;
        let index = Arc::new(index);
        let mut recent = lock();
        let max_count = (MAX_INDEX_BYTES / index.len().max(1)).max(1);
        recent.truncate(max_count.saturating_sub(1));
        recent.insert(0, (path.to_path_buf(), index.clone()));
        Ok(index)
    }
}

fn chunk_error(path: &Path, problem: &str) -> Error {
    Error::Io(cause(path.display(), problem, DAMAGED_REMEDY))
}
