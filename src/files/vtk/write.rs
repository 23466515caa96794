//! Writes VTK XML files: first the XML with empty space for the offsets; then one array after the
//! other, compressed in parallel, a few megabytes at a time; then the offsets.

use std::io::{Result, Seek, SeekFrom, Write};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::parallel::prelude::*;
use flate2::{Compress, Compression, FlushCompress, Status};

use super::VtkScalar;
use super::xml::escape;

/// Size of a block in bytes before compression. Readers decompress block by block; larger blocks
/// compress no better.
const BLOCK_BYTES: usize = 1 << 17;
/// Count of blocks that are compressed, and in memory, at once.
const BATCH_BLOCKS: usize = 64;
/// One part in this many of a block is compressed to find out whether the block can be compressed.
const PROBE_DIVISOR: usize = 32;
/// Width in characters of the space for an offset in the XML.
const OFFSET_WIDTH: usize = 20;

/// An array to be written: its description, and a function that gives any part of its bytes.
pub struct ArraySource<'a> {
    name: String,
    /// Unit of the numbers; empty if they have none or it is unknown.
    unit: String,
    components: usize,
    kind: &'static str,
    element: ElementKind,
    scalar_bytes: usize,
    len: usize,
    fill: FillBytes<'a>,
}

/// A function that appends the bytes of a range of the array's numbers.
type FillBytes<'a> = Box<dyn Fn(Range<usize>, &mut Vec<u8>) + Sync + 'a>;

/// The two XML elements that hold arrays.
#[derive(Clone, Copy, PartialEq)]
enum ElementKind {
    Numbers,
    Text,
}

impl<'a> ArraySource<'a> {
    /// Creates an array of numbers that are in memory.
    pub fn slice<T: VtkScalar>(name: &str, components: usize, values: &'a [T]) -> Self {
        Self {
            name: name.to_string(),
            unit: String::new(),
            components,
            kind: T::TYPE_NAME,
            element: ElementKind::Numbers,
            scalar_bytes: T::SIZE,
            len: values.len(),
            fill: Box::new(move |range, bytes| {
                values[range].iter().for_each(|v| v.append_bytes(bytes))
            }),
        }
    }

    /// Creates an array of `len` numbers that are computed while it is written, number `i` by
    /// `value(i)`.
    pub fn computed<T: VtkScalar>(
        name: &str,
        components: usize,
        len: usize,
        value: impl Fn(usize) -> T + Sync + 'a,
    ) -> Self {
        Self {
            name: name.to_string(),
            unit: String::new(),
            components,
            kind: T::TYPE_NAME,
            element: ElementKind::Numbers,
            scalar_bytes: T::SIZE,
            len,
            fill: Box::new(move |range, bytes| range.for_each(|i| value(i).append_bytes(bytes))),
        }
    }

    /// Creates an array that holds one string.
    pub fn text(name: &str, text: &'a str) -> Self {
        Self {
            name: name.to_string(),
            unit: String::new(),
            components: 1,
            kind: "String",
            element: ElementKind::Text,
            scalar_bytes: 1,
            len: text.len() + 1,
            fill: Box::new(move |range, bytes| {
                let end = range.end.min(text.len());
                bytes.extend_from_slice(&text.as_bytes()[range.start.min(end)..end]);
                if range.end > text.len() {
                    bytes.push(0);
                }
            }),
        }
    }

    /// Sets the unit of the numbers, which is written as VTK's `UNITS_LABEL`.
    pub fn with_unit(mut self, unit: String) -> Self {
        self.unit = unit;
        self
    }

    /// Returns the number of tuples; 1 for a text.
    pub(super) fn tuple_count(&self) -> usize {
        match self.element {
            ElementKind::Numbers => self.len / self.components.max(1),
            ElementKind::Text => 1,
        }
    }
}

/// How arrays are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArrayPacking {
    /// In blocks compressed by zlib, where that makes them smaller.
    Zlib,
    /// Uncompressed: half as large again for a mesh of polyhedra, but written in a third of the
    /// time.
    None,
}

/// A VTK XML file that is being composed: elements are opened and closed, and arrays are added to
/// the open element.
pub struct Document<'a> {
    text: String,
    packing: ArrayPacking,
    open_elements: Vec<&'static str>,
    arrays: Vec<(usize, ArraySource<'a>)>,
}

impl<'a> Document<'a> {
    /// Creates a file of VTK's data set `kind`, for example `UnstructuredGrid`, whose element is
    /// open.
    pub fn new(kind: &'static str, attributes: &[(&str, String)]) -> Self {
        Self::with_packing(kind, attributes, ArrayPacking::Zlib)
    }

    /// Creates a file whose arrays are stored as `packing` says; see [`Document::new`].
    pub fn with_packing(
        kind: &'static str,
        attributes: &[(&str, String)],
        packing: ArrayPacking,
    ) -> Self {
        let compressor = match packing {
            ArrayPacking::Zlib => " compressor=\"vtkZLibDataCompressor\"",
            ArrayPacking::None => "",
        };
        let text = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"{kind}\" version=\"1.0\" \
             byte_order=\"LittleEndian\" header_type=\"UInt64\"{compressor}>\n"
        );
        let mut document = Self {
            text,
            packing,
            open_elements: vec!["VTKFile"],
            arrays: Vec::new(),
        };
        document.open(kind, attributes);
        document
    }

    /// Opens an element.
    pub fn open(&mut self, element: &'static str, attributes: &[(&str, String)]) {
        self.indent();
        self.text.push('<');
        self.text.push_str(element);
        for (name, value) in attributes {
            self.text
                .push_str(&format!(" {name}=\"{}\"", escape(value)));
        }
        self.text.push_str(">\n");
        self.open_elements.push(element);
    }

    /// Closes the element that was opened last.
    pub fn close(&mut self) {
        if let Some(element) = self.open_elements.pop() {
            self.indent();
            self.text.push_str(&format!("</{element}>\n"));
        }
    }

    /// Adds an array to the open element.
    pub fn add_array(&mut self, source: ArraySource<'a>) {
        self.indent();
        let element = match source.element {
            ElementKind::Numbers => "DataArray",
            ElementKind::Text => "Array",
        };
        // VTK leaves the attribute out for one component; meshio reads an array of one component as
        // a matrix.
        let components = match source.components {
            1 => String::new(),
            count => format!("NumberOfComponents=\"{count}\" "),
        };
        self.text.push_str(&format!(
            "<{element} type=\"{}\" Name=\"{}\" {components}NumberOfTuples=\"{}\" \
             format=\"appended\" offset=",
            source.kind,
            escape(&source.name),
            source.tuple_count(),
        ));
        let offset = self.text.len();
        self.text.push_str(&" ".repeat(OFFSET_WIDTH + 2));
        if source.unit.is_empty() {
            self.text.push_str("/>\n");
        } else {
            self.text.push_str(&format!(
                "><InformationKey name=\"UNITS_LABEL\" location=\"vtkDataArray\">{}\
                 </InformationKey></{element}>\n",
                escape(&source.unit)
            ));
        }
        self.arrays.push((offset, source));
    }

    /// Adds an element with arrays, and closes it.
    pub fn add_element(
        &mut self,
        element: &'static str,
        attributes: &[(&str, String)],
        arrays: Vec<ArraySource<'a>>,
    ) {
        self.open(element, attributes);
        arrays.into_iter().for_each(|array| self.add_array(array));
        self.close();
    }

    fn indent(&mut self) {
        self.text.push_str(&"  ".repeat(self.open_elements.len()));
    }

    /// Closes all open elements and writes the file.
    ///
    /// # Errors
    /// Returns the error of `out` if writing fails.
    pub fn write(mut self, out: &mut (impl Write + Seek + Send)) -> Result<()> {
        while self.open_elements.len() > 1 {
            self.close();
        }
        self.text
            .push_str("  <AppendedData encoding=\"raw\">\n   _");
        let begin = out.stream_position()?;
        out.write_all(self.text.as_bytes())?;

        let data_start = begin + self.text.len() as u64;
        let mut offsets = Vec::with_capacity(self.arrays.len());
        let mut meshio_offsets = MeshioOffsets::default();
        for (_, source) in &self.arrays {
            let begin = out.stream_position()?;
            offsets.push(begin - data_start);
            meshio_offsets.add(source);
            match self.packing {
                ArrayPacking::Zlib => {
                    for padding in 0..=MAX_PADDING_BLOCKS {
                        out.seek(SeekFrom::Start(begin))?;
                        write_array(out, source, padding)?;
                        if !meshio_offsets.contains(out.stream_position()? - data_start) {
                            break;
                        }
                    }
                }
                ArrayPacking::None => write_plain(out, source)?,
            }
        }
        out.write_all(b"\n  </AppendedData>\n</VTKFile>\n")?;

        let end = out.stream_position()?;
        for ((position, _), offset) in self.arrays.iter().zip(offsets) {
            out.seek(SeekFrom::Start(begin + *position as u64))?;
            write!(out, "\"{offset}\"")?;
        }
        out.seek(SeekFrom::Start(end))?;
        Ok(())
    }
}

/// An empty block of a deflate stream that is not the last block: it unpacks to nothing.
const EMPTY_BLOCK: [u8; 5] = [0, 0, 0, 0xff, 0xff];

/// Most empty blocks that are added to an array.
const MAX_PADDING_BLOCKS: usize = 8;

/// Offsets that meshio 5 gives to arrays when it reads them. It replaces offsets one after the
/// other and looks arrays up by their offsets in the file; so it confuses an array that already has
/// its new offset with another whose old offset is the same.
#[derive(Default)]
struct MeshioOffsets {
    offsets: Vec<u64>,
    next_offset: u64,
}

impl MeshioOffsets {
    /// Adds an array. meshio encodes it as base64 with eight bytes in front.
    fn add(&mut self, source: &ArraySource) {
        self.offsets.push(self.next_offset);
        self.next_offset += 4 * (8 + (source.len * source.scalar_bytes) as u64).div_ceil(3);
    }

    /// Returns `true` if meshio has given an array this offset.
    fn contains(&self, offset: u64) -> bool {
        self.offsets.binary_search(&offset).is_ok()
    }
}

/// Writes an array uncompressed: the count of bytes, then the bytes.
fn write_plain(out: &mut impl Write, source: &ArraySource) -> Result<()> {
    out.write_all(&((source.len * source.scalar_bytes) as u64).to_le_bytes())?;
    let per_block = BLOCK_BYTES / source.scalar_bytes;
    let mut blocks = vec![Vec::new(); BATCH_BLOCKS.min(source.len.div_ceil(per_block))];
    for start in (0..source.len).step_by(BATCH_BLOCKS * per_block) {
        blocks.par_iter_mut().enumerate().for_each(|(i, bytes)| {
            bytes.clear();
            let first = source.len.min(start + i * per_block);
            (source.fill)(first..source.len.min(first + per_block), bytes);
        });
        blocks.iter().try_for_each(|bytes| out.write_all(bytes))?;
    }
    Ok(())
}

/// Writes the header (count of blocks, size of a block, size of a shorter last block, compressed
/// sizes), then the compressed blocks. The last block gets `padding` empty deflate blocks.
fn write_array(
    out: &mut (impl Write + Seek + Send),
    source: &ArraySource,
    padding: usize,
) -> Result<()> {
    let per_block = BLOCK_BYTES / source.scalar_bytes;
    let block_count = source.len.div_ceil(per_block);
    let last = source.len % per_block * source.scalar_bytes;
    let begin = out.stream_position()?;
    let mut header = vec![
        block_count as u64,
        (per_block * source.scalar_bytes) as u64,
        last as u64,
    ];
    write_header(out, &header, block_count)?;

    // One batch is written while the next is compressed.
    let idle = Mutex::new(Vec::new());
    let mut batch: Vec<Vec<u8>> = Vec::new();
    for first in (0..block_count + BATCH_BLOCKS).step_by(BATCH_BLOCKS) {
        let (written, next) = rayon::join(
            || batch.iter().try_for_each(|block| out.write_all(block)),
            || {
                compress_blocks(
                    source,
                    first.min(block_count)..block_count.min(first + BATCH_BLOCKS),
                    &idle,
                )
            },
        );
        written?;
        let mut next = next;
        if let Some(block) = next
            .last_mut()
            .filter(|_| first + BATCH_BLOCKS >= block_count)
        {
            // The empty blocks go after the two bytes with which a zlib stream begins.
            let position = 2.min(block.len());
            block.splice(position..position, EMPTY_BLOCK.repeat(padding));
        }
        header.extend(next.iter().map(|block| block.len() as u64));
        batch = next;
    }

    let end = out.stream_position()?;
    out.seek(SeekFrom::Start(begin))?;
    write_header(out, &header, block_count)?;
    out.seek(SeekFrom::Start(end))?;
    Ok(())
}

/// Working memory of a thread for compression: a stream that compresses, a stream that only stores,
/// and a buffer for the bytes of a block.
struct BlockCompressor {
    stream: Compress,
    stored_stream: Compress,
    bytes: Vec<u8>,
}

impl BlockCompressor {
    fn new() -> Self {
        Self {
            stream: Compress::new(Compression::fast(), true),
            stored_stream: Compress::new(Compression::none(), true),
            bytes: Vec::new(),
        }
    }
}

/// Compresses some blocks of an array. Compressors are taken from `idle` and put back, because
/// creating one costs as much as compressing a block.
fn compress_blocks(
    source: &ArraySource,
    blocks: Range<usize>,
    idle: &Mutex<Vec<BlockCompressor>>,
) -> Vec<Vec<u8>> {
    let per_block = BLOCK_BYTES / source.scalar_bytes;
    let lock_idle = || idle.lock().unwrap_or_else(PoisonError::into_inner);
    let compress_block = |block: usize| {
        let compressor = lock_idle().pop();
        let mut compressor = compressor.unwrap_or_else(BlockCompressor::new);
        compressor.bytes.clear();
        let range = block * per_block..source.len.min((block + 1) * per_block);
        (source.fill)(range, &mut compressor.bytes);
        let packed = deflate(
            &mut compressor.stream,
            &mut compressor.stored_stream,
            &compressor.bytes,
        );
        lock_idle().push(compressor);
        packed
    };
    blocks.into_par_iter().map(compress_block).collect()
}

/// Writes the header, with space for the compressed sizes of all blocks.
fn write_header(out: &mut impl Write, header: &[u64], block_count: usize) -> Result<()> {
    let mut bytes: Vec<u8> = header.iter().flat_map(|n| n.to_le_bytes()).collect();
    bytes.resize((3 + block_count) * 8, 0);
    out.write_all(&bytes)
}

/// Compresses bytes to a zlib stream of their own. Uses the fastest level: on mesh arrays higher
/// levels take several times as long and save a tenth of the size. Data that does not become
/// smaller, as most real numbers, is only stored.
fn deflate(stream: &mut Compress, stored_stream: &mut Compress, bytes: &[u8]) -> Vec<u8> {
    let probe = &bytes[..bytes.len() / PROBE_DIVISOR];
    if run_stream(stream, probe).len() > probe.len() / 20 * 19 {
        return run_stream(stored_stream, bytes);
    }
    run_stream(stream, bytes)
}

fn run_stream(stream: &mut Compress, bytes: &[u8]) -> Vec<u8> {
    stream.reset();
    let mut packed = Vec::with_capacity(bytes.len() + bytes.len() / 1000 + 64);
    loop {
        let consumed = stream.total_in() as usize;
        // Compressing to memory fails only if the stream is misused.
        match stream.compress_vec(&bytes[consumed..], &mut packed, FlushCompress::Finish) {
            Ok(Status::StreamEnd) => return packed,
            _ => packed.reserve(bytes.len() / 2 + 64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::vtk::{Values, VtkFile};

    /// All number types, in lengths around the limits of blocks and batches, are read back as they
    /// were written.
    #[test]
    fn arrays_of_every_kind_and_length_come_back() {
        let long = BLOCK_BYTES / 8 * (BATCH_BLOCKS + 1) + 3;
        let arrays: Vec<Values> = vec![
            Vec::<f64>::new().into(),
            vec![f64::NAN.to_bits(), 1, u64::MAX].into(),
            vec![i8::MIN, -1, 0, i8::MAX].into(),
            vec![0u8; BLOCK_BYTES].into(),
            vec![i16::MIN, 7, i16::MAX].into(),
            (0..(BLOCK_BYTES / 2 + 1) as u32)
                .map(|i| i as u16)
                .collect::<Vec<_>>()
                .into(),
            vec![i32::MIN; BLOCK_BYTES / 4].into(),
            vec![u32::MAX, 3].into(),
            vec![i64::MIN, i64::MAX].into(),
            vec![f32::MIN_POSITIVE, f32::INFINITY, -0.0].into(),
            (0..long)
                .map(|i| (i as f64).sqrt())
                .collect::<Vec<_>>()
                .into(),
        ];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vtu");
        let write = |path: &std::path::Path, packing: ArrayPacking| {
            let attributes = [("Note", "<&\">".to_string())];
            let mut document = Document::with_packing("UnstructuredGrid", &attributes, packing);
            document.open("Piece", &[]);
            for (i, values) in arrays.iter().enumerate() {
                document.add_array(values.source(&format!("array {i}"), 1));
            }
            document.add_array(ArraySource::text("text", "grüße"));
            document.add_array(ArraySource::computed("squares", 1, 1000, |i| {
                (i * i) as u32
            }));
            crate::files::atomic_write(path, |out| document.write(out)).unwrap();
        };
        for packing in [ArrayPacking::None, ArrayPacking::Zlib] {
            write(&path, packing);
            let file = VtkFile::read(&path, "UnstructuredGrid").unwrap();
            assert_eq!(file.data_set().attribute("Note"), Some("<&\">"));
            let elements = &file.piece().unwrap().children;
            for (i, values) in arrays.iter().enumerate() {
                let read_back = file.array(&elements[i]).unwrap();
                assert_eq!(
                    (&read_back.values, read_back.name),
                    (values, format!("array {i}"))
                );
            }
            assert_eq!(file.text(&elements[arrays.len()]).unwrap(), "grüße");
            let squares: Vec<u32> = (0..1000).map(|i| i * i).collect();
            assert_eq!(
                file.array(&elements[arrays.len() + 1]).unwrap().values,
                squares.into()
            );
        }

        // The bytes are the same for any number of threads.
        let other = folder.path().join("b.vtu");
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        pool.install(|| write(&other, ArrayPacking::Zlib));
        assert!(std::fs::read(&path).unwrap() == std::fs::read(&other).unwrap());
    }

    /// meshio looks an array up by its offset after it has given new offsets to the arrays before
    /// it.
    #[test]
    fn no_offset_equals_one_that_meshio_assigned_earlier() {
        let mut padded = 0;
        for first in 0..400usize {
            // Some arrays repeat few values and compress to few bytes.
            let lengths = [first % 7, 40 + first, 3 * first, 11, 2 * first + 5, 90];
            let arrays = lengths.map(|n| (0..n).map(|i| (i % 5) as i32).collect::<Vec<_>>());
            let mut document = Document::new("ImageData", &[]);
            for (number, array) in arrays.iter().enumerate() {
                document.add_array(ArraySource::slice(&format!("a{number}"), 1, array));
            }
            let mut bytes = std::io::Cursor::new(Vec::new());
            document.write(&mut bytes).unwrap();
            let bytes = bytes.into_inner();
            padded += bytes
                .windows(7)
                .filter(|w| w[2..] == EMPTY_BLOCK && w[0] == 0x78)
                .count();
            let text = String::from_utf8_lossy(&bytes);
            let offsets = text.split("offset=\"").skip(1);
            let offsets: Vec<u64> = offsets
                .map(|rest| rest.split('"').next().unwrap().parse().unwrap())
                .collect();
            assert_eq!(offsets.len(), 6);
            let (mut assigned, mut next) = (Vec::new(), 0);
            for (offset, length) in offsets.iter().zip(lengths) {
                assert!(!assigned.contains(offset), "{first}: {offset}");
                assigned.push(next);
                next += 4 * (8 + 4 * length as u64).div_ceil(3);
            }
        }
        assert!(padded > 0, "no case was tried");
    }
}
