//! NIfTI-1 and NIfTI-2 (`.nii`, `.nii.gz`, and `.hdr` with `.img`), the image formats of
//! neuroscience.
//!
//! Samples are scaled by `scl_slope` and `scl_inter`. Positions come from the sform, else from the
//! qform, else from the voxel sizes alone. The NIfTI world is right-anterior-superior (RAS). As in
//! ITK, x and y change sign on reading and writing, so that positions here are
//! left-posterior-superior (LPS), as they are in MetaImage and NRRD files.

use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::packed::{
    self, DAMAGED_REMEDY, PackedSamples, SamplePacking, SampleStart, dims_from_sizes, file_error,
};
use super::samples::{self, Encoding, Endian, SampleType};
use super::stream::SlabSource;
use super::{ImageFormat, LoadedImage};
use crate::error::Result;
use crate::files::atomic_write;
use crate::image::Geometry;

/// Bytes of the longer of the two headers, that of NIfTI-2.
const MAX_HEADER_BYTES: u64 = 540;

/// Returns `true` if these are the first bytes of a NIfTI file.
pub fn looks_like(head: &[u8]) -> bool {
    let has = |at: usize, magic: &[u8]| head.get(at..).is_some_and(|h| h.starts_with(magic));
    [
        (344, b"n+1\0"),
        (344, b"ni1\0"),
        (4, b"n+2\0"),
        (4, b"ni2\0"),
    ]
    .iter()
    .any(|(at, magic)| has(*at, *magic))
}

/// Access to the fields of either header by their byte offsets.
struct NiftiHeader<'a> {
    bytes: &'a [u8],
    endian: Endian,
    is_nifti2: bool,
}

impl NiftiHeader<'_> {
    /// Returns an integer of `n` bytes.
    fn integer(&self, at: usize, n: usize) -> i64 {
        let bytes = &self.bytes[at..at + n];
        let byte = |k: usize| match self.endian {
            Endian::Little => bytes[n - 1 - k],
            Endian::Big => bytes[k],
        };
        let unsigned = (0..n).fold(0u64, |v, k| v << 8 | u64::from(byte(k)));
        // The shift to the top and the arithmetic shift back extend the sign bit.
        let unused = 64 - 8 * n as u32;
        (unsigned << unused) as i64 >> unused
    }

    /// Returns a float: 4 bytes in NIfTI-1, 8 in NIfTI-2.
    fn float(&self, at: usize) -> f64 {
        if self.is_nifti2 {
            f64::from_bits(self.integer(at, 8) as u64)
        } else {
            f64::from(f32::from_bits(self.integer(at, 4) as u32))
        }
    }

    /// Returns `first` for NIfTI-1 and `second` for NIfTI-2.
    fn select_by_version(&self, first: usize, second: usize) -> usize {
        if self.is_nifti2 { second } else { first }
    }

    /// Returns the type of the samples; the error is a code that is not that of a real number.
    fn sample_type(&self) -> std::result::Result<SampleType, i64> {
        Ok(match self.integer(self.select_by_version(70, 12), 2) {
            2 => SampleType::U8,
            4 => SampleType::I16,
            8 => SampleType::I32,
            16 => SampleType::F32,
            64 => SampleType::F64,
            256 => SampleType::I8,
            512 => SampleType::U16,
            768 => SampleType::U32,
            1024 => SampleType::I64,
            1280 => SampleType::U64,
            code => return Err(code),
        })
    }

    /// Returns the offset of the first sample.
    fn sample_offset(&self) -> f64 {
        if self.is_nifti2 {
            self.integer(168, 8) as f64
        } else {
            self.float(108)
        }
    }

    /// Returns slope and intercept of the samples, unless they are to be used as they are.
    fn scale(&self) -> Option<[f64; 2]> {
        let offsets = [
            self.select_by_version(112, 176),
            self.select_by_version(116, 184),
        ];
        let scale = offsets.map(|at| self.float(at));
        let is_valid = scale[0] != 0.0 && scale.iter().all(|v| v.is_finite());
        (is_valid && scale != [1.0, 0.0]).then_some(scale)
    }

    /// Returns `N` consecutive floats.
    fn floats<const N: usize>(&self, at: usize) -> [f64; N] {
        let size = self.select_by_version(4, 8);
        std::array::from_fn(|k| self.float(at + k * size))
    }
}

/// Reads a volume. A plane is read as a volume with a single sample along z.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file cannot be read, is truncated or damaged,
/// or holds a series of volumes, colours or complex numbers.
pub fn read(path: &Path) -> Result<LoadedImage> {
    let (mut head, packing) = packed::read_head(path, MAX_HEADER_BYTES)?;
    let is_nifti2 = head.get(4..7).is_some_and(|m| m == b"n+2" || m == b"ni2");
    let length = if is_nifti2 { 540 } else { 348 };
    if head.len() < length {
        return Err(file_error(
            path,
            "its NIfTI header is cut off",
            DAMAGED_REMEDY,
        ));
    }
    head.truncate(length);
    let little = u32::from_le_bytes([head[0], head[1], head[2], head[3]]);
    let endian = match little as usize {
        n if n == length => Endian::Little,
        n if n == (length as u32).swap_bytes() as usize => Endian::Big,
        n => {
            let problem = format!("its header claims to be {n} bytes long, not {length}");
            return Err(file_error(path, problem, DAMAGED_REMEDY));
        }
    };
    let is_detached = head[if is_nifti2 { 5 } else { 345 }] == b'i';
    let fields = NiftiHeader {
        bytes: &head,
        endian,
        is_nifti2,
    };
    let dims = dims(&fields).map_err(|problem| {
        let remedy = "give one volume, e.g. in Python with nibabel: image.slicer[..., 0]";
        file_error(path, problem, remedy)
    })?;
    let sample_type = fields.sample_type().map_err(|code| {
        let problem = format!("its samples are of NIfTI type {code}, not real numbers");
        file_error(path, problem, "give one real number per sample")
    })?;
    let offset = fields.sample_offset();
    let min_offset = if is_detached { 0.0 } else { length as f64 };
    if !(min_offset..1e15).contains(&offset) {
        let problem = format!("its samples are said to begin at byte {offset}");
        return Err(file_error(path, problem, DAMAGED_REMEDY));
    }
    let scale = fields.scale();
    let mut notes = Vec::new();
    if let Some([slope, intercept]) = scale {
        notes.push(format!(
            "values are scaled as the header says: {slope} times the stored value + {intercept}"
        ));
    }
    let geometry = geometry(&fields, &mut notes);
    let (path, packing) = if is_detached {
        sample_file(path)?
    } else {
        (path.to_path_buf(), packing)
    };
    let packed = PackedSamples {
        path,
        offset: 0,
        packing,
        sample_start: SampleStart::Offset(offset as u64),
        encoding: Encoding {
            sample_type,
            endian,
        },
        dims,
    };
    packed.load(ImageFormat::Nifti, geometry, scale, notes)
}

/// Returns the number of samples along each axis.
fn dims(fields: &NiftiHeader<'_>) -> std::result::Result<[usize; 3], String> {
    let (start, size) = (
        fields.select_by_version(40, 16),
        fields.select_by_version(2, 8),
    );
    let dim = |k: usize| fields.integer(start + k * size, size);
    let rank = dim(0);
    if !(1..=7).contains(&rank) {
        return Err(format!("has {rank} axes in its header, not 1 to 7"));
    }
    let sizes: Vec<usize> = (1..=rank as usize)
        .map(|k| {
            usize::try_from(dim(k))
                .map_err(|_| format!("has {} samples along an axis in its header", dim(k)))
        })
        .collect::<std::result::Result<_, _>>()?;
    dims_from_sizes(&sizes)
}

/// Returns the geometry in the frame of ITK (LPS).
fn geometry(fields: &NiftiHeader<'_>, notes: &mut Vec<String>) -> Geometry<3> {
    let pixdim: [f64; 4] = fields.floats(fields.select_by_version(76, 104));
    let size = [1, 2, 3].map(|k: usize| match pixdim[k].abs() {
        s if s.is_finite() && s > 0.0 => s,
        _ => 1.0,
    });
    let unit = match fields.integer(
        fields.select_by_version(123, 500),
        fields.select_by_version(1, 4),
    ) & 7
    {
        1 => "m",
        2 => "mm",
        3 => "um",
        _ => "",
    };
    let with_units = |origin: [f64; 3], axes: [[f64; 3]; 3]| Geometry {
        origin,
        axes,
        units: [(); 3].map(|()| unit.to_string()),
        ..Geometry::default()
    };
    let (qform, sform) = if fields.is_nifti2 {
        (fields.integer(344, 4), fields.integer(348, 4))
    } else {
        (fields.integer(252, 2), fields.integer(254, 2))
    };
    let mut placement = None;
    if sform > 0 {
        let rows: [f64; 12] = fields.floats(fields.select_by_version(280, 400));
        let row = |c: usize, k: usize| rows[4 * c + k];
        placement = Some(with_units(
            std::array::from_fn(|c| row(c, 3)),
            std::array::from_fn(|k| std::array::from_fn(|c| row(c, k))),
        ))
        .filter(spans_space);
    }
    if qform > 0 && placement.is_none() {
        let [b, c, d]: [f64; 3] = fields.floats(fields.select_by_version(256, 352));
        let origin: [f64; 3] = fields.floats(fields.select_by_version(268, 376));
        let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
        // Columns of the rotation matrix of the quaternion; a negative first pixdim reverses the
        // third.
        let columns = [
            [
                a * a + b * b - c * c - d * d,
                2.0 * (b * c + a * d),
                2.0 * (b * d - a * c),
            ],
            [
                2.0 * (b * c - a * d),
                a * a + c * c - b * b - d * d,
                2.0 * (c * d + a * b),
            ],
            [
                2.0 * (b * d + a * c),
                2.0 * (c * d - a * b),
                a * a + d * d - c * c - b * b,
            ],
        ];
        let qfac = if pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let steps = [size[0], size[1], size[2] * qfac];
        let axes = std::array::from_fn(|k| columns[k].map(|x| x * steps[k]));
        placement = Some(with_units(origin, axes)).filter(spans_space);
    }
    match placement {
        Some(geometry) => {
            notes.push(
                "x points to the patient's left, y to the back, z up (LPS, as in ITK)".into(),
            );
            swap_ras_lps(geometry)
        }
        None => {
            notes.push(
                "the header does not say where the volume lies: its first sample is at 0".into(),
            );
            let straight = Geometry::with_spacing([0.0; 3], size);
            with_units(straight.origin, straight.axes)
        }
    }
}

/// Returns `true` if the origin is finite and the axes span space.
fn spans_space(geometry: &Geometry<3>) -> bool {
    let finite = geometry.origin.iter().all(|x| x.is_finite());
    finite && geometry.determinant() != 0.0
}

/// Converts from RAS to LPS, or back.
fn swap_ras_lps(mut geometry: Geometry<3>) -> Geometry<3> {
    for vector in geometry.axes.iter_mut().chain([&mut geometry.origin]) {
        for x in &mut vector[..2] {
            // The subtraction avoids -0.
            *x = 0.0 - *x;
        }
    }
    geometry
}

/// Returns the file of samples that belongs to a detached header, and its packing.
fn sample_file(header: &Path) -> Result<(PathBuf, SamplePacking)> {
    let base = if header.extension().is_some_and(|e| e == "gz") {
        header.with_extension("")
    } else {
        header.to_path_buf()
    };
    let image = base.with_extension("img");
    let packed = base.with_extension("img.gz");
    match (image.exists(), packed.exists()) {
        (false, true) => Ok((packed, SamplePacking::Deflated)),
        (true, _) => Ok((image, SamplePacking::Uncompressed)),
        _ => {
            let problem = format!(
                "its samples should be in {}, which does not exist",
                image.display()
            );
            let remedy = "put the header and its .img into one folder, under one name";
            Err(file_error(header, problem, remedy))
        }
    }
}

/// Writes NIfTI-1 with 32-bit floats, compressed if `path` ends in `.gz`. Positions are written as
/// sform in single precision, as the header requires.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file cannot be written or an axis is too long
/// for the format.
pub fn write<const D: usize>(
    path: &Path,
    dims: [usize; D],
    geometry: &Geometry<D>,
    slabs: &dyn SlabSource,
) -> Result<()> {
    if dims.iter().any(|&n| n > i16::MAX as usize) {
        let problem = format!("NIfTI-1 holds at most {} samples along an axis", i16::MAX);
        return Err(file_error(path, problem, "write .nrrd or .mha"));
    }
    let ras_geometry = swap_ras_lps(geometry.to_3d());
    let spacing = ras_geometry.spacing();
    let mut head = [0u8; 352];
    let mut set_bytes = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
    set_bytes(0, &348i32.to_le_bytes());
    set_bytes(40, &(D as i16).to_le_bytes());
    set_bytes(76, &1f32.to_le_bytes());
    for k in 0..7 {
        let n = dims.get(k).map_or(1, |&n| n as i16);
        set_bytes(42 + 2 * k, &n.to_le_bytes());
        let step = spacing.get(k).map_or(1.0, |&s| s as f32);
        set_bytes(80 + 4 * k, &step.to_le_bytes());
    }
    set_bytes(70, &16i16.to_le_bytes());
    set_bytes(72, &32i16.to_le_bytes());
    set_bytes(108, &352f32.to_le_bytes());
    set_bytes(112, &1f32.to_le_bytes());
    let unit = match ras_geometry.units[0].as_str() {
        "m" => 1,
        "mm" => 2,
        "um" => 3,
        _ => 0,
    };
    set_bytes(123, &[unit]);
    set_bytes(254, &2i16.to_le_bytes());
    for c in 0..3 {
        for k in 0..4 {
            let value = if k < 3 {
                ras_geometry.axes[k][c]
            } else {
                ras_geometry.origin[c]
            };
            set_bytes(280 + 16 * c + 4 * k, &(value as f32).to_le_bytes());
        }
    }
    set_bytes(344, b"n+1\0");
    let is_compressed = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("gz"));
    atomic_write(path, |out| {
        if is_compressed {
            let mut out = GzEncoder::new(out, Compression::fast());
            out.write_all(&head)?;
            samples::write_slabs(&mut out, slabs)?;
            return out.finish().map(|_| ());
        }
        out.write_all(&head)?;
        samples::write_slabs(out, slabs)
    })
}
