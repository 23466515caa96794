//! NIfTI-1 and NIfTI-2 (`.nii`, `.nii.gz`, and `.hdr` with `.img`), the image formats of
//! neuroscience, and their ancestor Analyze 7.5 (`.hdr` with `.img`).
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
use crate::geometry::{norm, sub};
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

/// Returns `true` if these are the first bytes of a header of Analyze 7.5: a length, a number of axes,
/// and a type of samples with its size in bits.
pub fn looks_like_analyze(head: &[u8]) -> bool {
    if head.len() < 348 || looks_like(head) {
        return false;
    }
    let has_fields = |number: fn([u8; 2]) -> u16| {
        let field = |at: usize| number([head[at], head[at + 1]]);
        let (rank, kind, bits) = (field(40), field(70), field(72));
        let sizes = [
            (2, 8),
            (4, 16),
            (8, 32),
            (16, 32),
            (32, 64),
            (64, 64),
            (128, 24),
            (256, 8),
            (512, 16),
        ];
        (1..=7).contains(&rank) && sizes.contains(&(kind, bits))
    };
    let length = 348u32;
    head.starts_with(&length.to_le_bytes()) && has_fields(u16::from_le_bytes)
        || head.starts_with(&length.to_be_bytes()) && has_fields(u16::from_be_bytes)
}

/// Returns the header of a file of samples: `a.hdr` of `a.img` or `a.img.gz`, if it is one of NIfTI or
/// Analyze.
pub fn header_of(path: &Path) -> Option<PathBuf> {
    let base = match path.extension()? {
        e if e.eq_ignore_ascii_case("gz") => path.with_extension(""),
        _ => path.to_path_buf(),
    };
    if !base.extension()?.eq_ignore_ascii_case("img") {
        return None;
    }
    let headers = ["hdr", "HDR", "hdr.gz"].map(|ending| base.with_extension(ending));
    headers.into_iter().find(|header| {
        let head = packed::read_head(header, MAX_HEADER_BYTES);
        head.is_ok_and(|(head, _)| looks_like(&head) || looks_like_analyze(&head))
    })
}

/// Access to the fields of either header by their byte offsets.
struct NiftiHeader<'a> {
    bytes: &'a [u8],
    endian: Endian,
    is_nifti2: bool,
    /// `true` for Analyze 7.5, which has other fields after the sizes of voxels.
    is_analyze: bool,
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
    let header = header_of(path);
    let path = header.as_deref().unwrap_or(path);
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
    let is_analyze = looks_like_analyze(&head);
    let is_detached = is_analyze || head[if is_nifti2 { 5 } else { 345 }] == b'i';
    let fields = NiftiHeader {
        bytes: &head,
        endian,
        is_nifti2,
        is_analyze,
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
    let size = fields.voxel_size();
    let unit = fields.unit();
    let with_units = |geometry: Geometry<3>| Geometry {
        units: [(); 3].map(|()| unit.to_string()),
        ..geometry
    };
    let (qform, sform) = match () {
        () if fields.is_analyze => (0, 0),
        () if fields.is_nifti2 => (fields.integer(344, 4), fields.integer(348, 4)),
        () => (fields.integer(252, 2), fields.integer(254, 2)),
    };
    let by_sform = (sform > 0).then(|| fields.sform());
    let by_qform = (qform > 0).then(|| fields.qform(size)).filter(spans_space);
    if by_sform.as_ref().is_some_and(|form| !spans_space(form)) {
        notes.push("the sform of the header spans no space, and is not used".into());
    }
    let by_sform = by_sform.filter(spans_space);
    if let (Some(used), Some(other)) = (&by_sform, &by_qform) {
        notes.extend(note_on_forms(fields, used, sform, other, qform, unit));
    }
    match by_sform.or(by_qform) {
        Some(geometry) => {
            notes.push(
                "x points to the patient's left, y to the back, z up (LPS, as in ITK)".into(),
            );
            swap_ras_lps(with_units(geometry))
        }
        None => {
            notes.push(if fields.is_analyze {
                "a header of Analyze 7.5 says neither where the volume lies nor which side is left: its first sample is at 0, and its axes are x, y and z".into()
            } else {
                "the header does not say where the volume lies: its first sample is at 0".into()
            });
            with_units(Geometry::with_spacing([0.0; 3], size))
        }
    }
}

/// Returns a note if the two forms of a header put the volume at different places. Each form has its
/// code.
fn note_on_forms(
    fields: &NiftiHeader<'_>,
    used: &Geometry<3>,
    sform: i64,
    other: &Geometry<3>,
    qform: i64,
    unit: &str,
) -> Option<String> {
    let last = dims(fields).ok()?.map(|n| n.saturating_sub(1) as f64);
    let corners = (0..8).map(|c| [0, 1, 2].map(|k| if c >> k & 1 == 1 { last[k] } else { 0.0 }));
    let distance = corners
        .map(|at| norm(sub(used.to_physical(at), other.to_physical(at))))
        .fold(0.0, f64::max);
    let smallest = used.spacing().into_iter().fold(f64::INFINITY, f64::min);
    if distance <= MAX_FORM_ROUNDING * smallest {
        return None;
    }
    let space = if unit.is_empty() { "" } else { " " };
    let place = |form: &Geometry<3>| {
        let [x, y, z] = swap_ras_lps(form.clone()).origin;
        format!("({x:.3}, {y:.3}, {z:.3})")
    };
    Some(format!(
        "sform (code {sform}) and qform (code {qform}) of the header differ by up to {distance:.3}{space}{unit}: sform is used, with the first sample at {}; qform, which some programs use, has it at {}",
        place(used),
        place(other)
    ))
}

/// Largest distance between the places by sform and by qform, in voxels, that is rounding.
const MAX_FORM_ROUNDING: f64 = 0.01;

impl NiftiHeader<'_> {
    /// Returns the size of a voxel along each axis.
    fn voxel_size(&self) -> [f64; 3] {
        let pixdim: [f64; 4] = self.floats(self.select_by_version(76, 104));
        [1, 2, 3].map(|k: usize| match pixdim[k].abs() {
            s if s.is_finite() && s > 0.0 => s,
            _ => 1.0,
        })
    }

    /// Returns the unit of positions. In headers of Analyze it is a text.
    fn unit(&self) -> &'static str {
        if self.is_analyze {
            return match self.bytes[56..60].trim_ascii_end() {
                [b'm', b'm', ..] => "mm",
                [b'u', b'm', ..] => "um",
                [b'c', b'm', ..] => "cm",
                _ => "",
            };
        }
        let (at, size) = (
            self.select_by_version(123, 500),
            self.select_by_version(1, 4),
        );
        match self.integer(at, size) & 7 {
            1 => "m",
            2 => "mm",
            3 => "um",
            _ => "",
        }
    }

    /// Returns the geometry of the sform, which is an affine matrix.
    fn sform(&self) -> Geometry<3> {
        let rows: [f64; 12] = self.floats(self.select_by_version(280, 400));
        let row = |c: usize, k: usize| rows[4 * c + k];
        Geometry {
            origin: std::array::from_fn(|c| row(c, 3)),
            axes: std::array::from_fn(|k| std::array::from_fn(|c| row(c, k))),
            ..Geometry::default()
        }
    }

    /// Returns the geometry of the qform, which is a rotation by a quaternion and a translation.
    fn qform(&self, size: [f64; 3]) -> Geometry<3> {
        let pixdim: [f64; 4] = self.floats(self.select_by_version(76, 104));
        let [b, c, d]: [f64; 3] = self.floats(self.select_by_version(256, 352));
        let origin: [f64; 3] = self.floats(self.select_by_version(268, 376));
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
        Geometry {
            origin,
            axes: std::array::from_fn(|k| columns[k].map(|x| x * steps[k])),
            ..Geometry::default()
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
    let lower = base.with_extension("img");
    let upper = base.with_extension("IMG");
    let image = if upper.exists() && !lower.exists() {
        upper
    } else {
        lower
    };
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

#[cfg(test)]
mod tests {
    use super::super::{AnyImage, ReadOptions, read_any};
    use super::*;

    /// Returns a header of 348 bytes of a volume of 3 x 2 x 2 bytes with voxels of 2 x 3 x 4 mm.
    fn header(fields: &[(usize, &[u8])]) -> Vec<u8> {
        let mut head = vec![0; 348];
        let mut set = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
        set(0, &348i32.to_le_bytes());
        for (k, n) in [3i16, 3, 2, 2, 1].into_iter().enumerate() {
            set(40 + 2 * k, &n.to_le_bytes());
        }
        set(70, &2i16.to_le_bytes());
        set(72, &8i16.to_le_bytes());
        for (k, size) in [1f32, 2.0, 3.0, 4.0].into_iter().enumerate() {
            set(76 + 4 * k, &size.to_le_bytes());
        }
        for (at, bytes) in fields {
            set(*at, bytes);
        }
        head
    }

    /// Returns the fields of an sform of the voxel sizes with this origin, and a qform without rotation
    /// at (1, 2, 3).
    fn forms(codes: [i16; 2], origin: [f32; 3]) -> Vec<u8> {
        let mut rows = [0f32; 12];
        for c in 0..3 {
            rows[4 * c + c] = [2.0, 3.0, 4.0][c];
            rows[4 * c + 3] = origin[c];
        }
        let floats = [0f32; 3].into_iter().chain([1.0, 2.0, 3.0]).chain(rows);
        let codes = codes.map(i16::to_le_bytes).concat();
        [codes, floats.flat_map(f32::to_le_bytes).collect()].concat()
    }

    #[test]
    fn forms_that_differ_are_noted_and_codes_of_zero_are_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nii");
        let differ = "sform (code 2) and qform (code 1) of the header differ by up to 5.000 mm: sform is used, with the \
                      first sample at (-1.000, -2.000, 8.000); qform, which some programs use, has it at (-1.000, -2.000, 3.000)";
        for (codes, z, origin, note) in [
            ([1i16, 2i16], 8.0, [-1.0, -2.0, 8.0], Some(differ)),
            ([1, 2], 3.0001, [-1.0, -2.0, f64::from(3.0001f32)], None),
            ([1, 0], 8.0, [-1.0, -2.0, 3.0], None),
            ([0, 1], 8.0, [-1.0, -2.0, 8.0], None),
            (
                [0, 0],
                8.0,
                [0.0; 3],
                Some("does not say where the volume lies"),
            ),
        ] {
            let forms = forms(codes, [1.0, 2.0, z]);
            let fields: [(usize, &[u8]); 4] = [
                (108, &352f32.to_le_bytes()),
                (123, &[2]),
                (252, &forms),
                (344, b"n+1\0"),
            ];
            let mut bytes = header(&fields);
            bytes.extend([0; 4 + 12]);
            std::fs::write(&path, bytes).unwrap();
            let loaded = read(&path).unwrap();
            assert_eq!(loaded.image.geometry.origin, origin, "{codes:?}");
            let text = loaded.notes.join("\n");
            match note {
                Some(note) => assert!(text.contains(note), "{codes:?}: {text}"),
                None => assert!(!text.contains("differ"), "{codes:?}: {text}"),
            }
        }
    }

    #[test]
    fn the_samples_of_a_pair_are_read_through_their_header() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let samples: Vec<u8> = (0..12).collect();
        let nifti: [(usize, &[u8]); 2] = [(123, &[2]), (344, b"ni1\0")];
        let analyze: [(usize, &[u8]); 2] = [(38, b"r"), (56, b"mm\0\0")];
        for (name, fields, note) in [
            ("nifti", nifti, "does not say where the volume lies"),
            ("analyze", analyze, "nor which side is left"),
        ] {
            std::fs::write(path(&format!("{name}.hdr")), header(&fields)).unwrap();
            std::fs::write(path(&format!("{name}.img")), &samples).unwrap();
            for ending in ["hdr", "img"] {
                let file = path(&format!("{name}.{ending}"));
                let AnyImage::Space(loaded) = read_any(&file, &ReadOptions::default()).unwrap()
                else {
                    panic!("{name} is no plane");
                };
                assert_eq!(loaded.image.dims(), [3, 2, 2]);
                assert_eq!(loaded.image.as_slice()[11], 11.0);
                assert_eq!(loaded.image.geometry.spacing(), [2.0, 3.0, 4.0]);
                assert_eq!(loaded.image.geometry.units, ["mm", "mm", "mm"]);
                assert!(loaded.notes.join("\n").contains(note), "{:?}", loaded.notes);
            }
        }
        // Samples whose header is of another kind are not guessed.
        std::fs::write(path("other.hdr"), "ENVI\nsamples = 3\n").unwrap();
        std::fs::write(path("other.img"), &samples).unwrap();
        assert!(read_any(&path("other.img"), &ReadOptions::default()).is_err());
    }
}
