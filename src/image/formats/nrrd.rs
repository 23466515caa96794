//! NRRD (`.nrrd`, or `.nhdr` with a separate file of samples), versions 1 to 5: lines `field:
//! value`, an empty line, and the samples as raw bytes, gzip or text.
//!
//! Positions in the spaces right-anterior-superior and left-anterior-superior are converted to
//! left-posterior-superior, as ITK does. Positions in all other spaces are used as they are.

use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::metaimage::sibling;
use super::packed::{
    self, DAMAGED_REMEDY, PackedSamples, SamplePacking, SampleStart, dims_from_sizes, file_error,
};
use super::samples::{self, Encoding, Endian, SampleType};
use super::stream::SlabSource;
use super::{ImageFormat, LoadedImage};
use crate::error::Result;
use crate::files::atomic_write;
use crate::geometry::{cross, unit};
use crate::image::Geometry;

/// First bytes of every NRRD file.
pub const MAGIC: &[u8] = b"NRRD000";

/// Longest header that is read, in bytes.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// The fields of a header, and the offset of the data after its empty line (or its end).
struct Header<'a> {
    path: &'a Path,
    fields: Vec<(String, &'a str)>,
    end: u64,
}

impl<'a> Header<'a> {
    fn parse(path: &'a Path, text: &'a str) -> Self {
        let mut fields = Vec::new();
        let mut end = 0;
        for line in text.split_inclusive('\n') {
            end += line.len() as u64;
            let line = line.trim_end();
            if line.is_empty() {
                break;
            }
            // Lines `key:=value` have a meaning for the author of the file only.
            let field = line.split_once(": ").or_else(|| line.split_once(':'));
            if let Some((name, value)) = field.filter(|(_, value)| !value.starts_with('=')) {
                // Names occur with and without spaces: `byte skip`, `byteskip`.
                fields.push((name.to_lowercase().replace(' ', ""), value.trim()));
            }
        }
        Self { path, fields, end }
    }

    fn value(&self, name: &str) -> Option<&'a str> {
        let entry = self.fields.iter().find(|(field, _)| field == name);
        entry.map(|(_, value)| *value)
    }

    fn required_value(&self, name: &str) -> Result<&'a str> {
        self.value(name).ok_or_else(|| {
            file_error(
                self.path,
                format!("its header has no '{name}'"),
                DAMAGED_REMEDY,
            )
        })
    }

    fn value_error(&self, name: &str, text: &str) -> crate::Error {
        let shown: String = text.chars().take(60).collect();
        file_error(
            self.path,
            format!("its header says {name}: {shown}"),
            DAMAGED_REMEDY,
        )
    }

    /// Returns an integer, `default` if the field is missing.
    fn integer(&self, name: &str, default: i64) -> Result<i64> {
        match self.value(name) {
            None => Ok(default),
            Some(text) => text.parse().map_err(|_| self.value_error(name, text)),
        }
    }

    /// Returns how the samples are stored.
    fn packing_and_encoding(&self) -> Result<(SamplePacking, Encoding)> {
        let kind = self.required_value("type")?;
        let sample_type = sample_type(kind).ok_or_else(|| self.value_error("type", kind))?;
        let packing = match self.required_value("encoding")?.to_lowercase().as_str() {
            "raw" => SamplePacking::Uncompressed,
            "gz" | "gzip" => SamplePacking::Deflated,
            "txt" | "text" | "ascii" => SamplePacking::Text,
            other => {
                let problem = format!("its samples are encoded as {other}, which is not read");
                let remedy = "write it with the encoding raw or gzip, e.g. in Python with pynrrd";
                return Err(file_error(self.path, problem, remedy));
            }
        };
        let order = self.value("endian");
        let endian = match order {
            Some("big") => Endian::Big,
            Some("little") | None => Endian::Little,
            Some(other) => return Err(self.value_error("endian", other)),
        };
        let encoding = Encoding {
            sample_type,
            endian,
        };
        if encoding.size() > 1 && packing != SamplePacking::Text && order.is_none() {
            let problem = "its header does not say the byte order";
            let remedy = "add a line 'endian: little' or 'endian: big'";
            return Err(file_error(self.path, problem, remedy));
        }
        Ok((packing, encoding))
    }

    /// Returns the file of the samples, the offset of their data in it, and where they begin in
    /// this data.
    fn sample_location(&self, packing: SamplePacking) -> Result<(PathBuf, u64, SampleStart)> {
        let (file, start) = match self.value("datafile") {
            None => (self.path.to_path_buf(), self.end),
            Some(list) if list.starts_with("LIST") || list.contains('%') => {
                let problem = "its samples lie in several files";
                let remedy = "write it as one file, e.g. in Python with pynrrd";
                return Err(file_error(self.path, problem, remedy));
            }
            Some(name) => (sibling(self.path, name), 0),
        };
        let lines = self.integer("lineskip", 0)?;
        let start = skip_lines(&file, start, lines)
            .ok_or_else(|| self.value_error("line skip", &lines.to_string()))?;
        // For compressed data the skipped bytes are counted after decompression.
        match self.integer("byteskip", 0)? {
            -1 => Ok((file, start, SampleStart::FromEnd)),
            n @ 0.. if packing == SamplePacking::Text => {
                Ok((file, start.saturating_add(n as u64), SampleStart::Offset(0)))
            }
            n @ 0.. => Ok((file, start, SampleStart::Offset(n as u64))),
            n => Err(self.value_error("byte skip", &n.to_string())),
        }
    }
}

/// Reads a volume. A plane is read as a volume with a single sample along z.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file, or the file of its samples, cannot be
/// read, is truncated or damaged, has more than one value per sample, or has an unsupported
/// encoding.
pub fn read(path: &Path) -> Result<LoadedImage> {
    let text = packed::read_head_text(path, MAX_HEADER_BYTES)?;
    let header = Header::parse(path, &text);
    let rank = header.integer("dimension", 0)?;
    let sizes = header.required_value("sizes")?;
    let counts: Vec<usize> = sizes
        .split_whitespace()
        .filter_map(|w| w.parse().ok())
        .collect();
    if !(1..=16).contains(&rank) || counts.len() as i64 != rank {
        let problem = format!("its header says dimension: {rank}, sizes: {sizes}");
        return Err(file_error(path, problem, DAMAGED_REMEDY));
    }
    let directions = directions(&header, counts.len())?;
    let axes = axes(&header, &counts, &directions)?;
    let image_sizes: Vec<usize> = axes.iter().map(|&axis| counts[axis]).collect();
    let remedy = "give one value per sample, in two or three dimensions";
    let dims =
        dims_from_sizes(&image_sizes).map_err(|problem| file_error(path, problem, remedy))?;

    let (packing, encoding) = header.packing_and_encoding()?;
    let (file, data_start, skip) = header.sample_location(packing)?;
    let geometry = geometry(&header, &axes, &directions)?;
    let packed = PackedSamples {
        path: file,
        offset: data_start,
        packing,
        sample_start: skip,
        encoding,
        dims,
    };
    let loaded = packed.load(ImageFormat::Nrrd, geometry, None, Vec::new())?;
    match loaded
        .notes
        .iter()
        .find(|note| note.contains("are ignored"))
    {
        // Data beyond the samples means that something else precedes them.
        Some(note) if packing != SamplePacking::Uncompressed => {
            let remedy = "if the samples come last, add a line 'byte skip: -1' to the header";
            Err(file_error(
                path,
                format!("would leave data unread: {note}"),
                remedy,
            ))
        }
        _ => Ok(loaded),
    }
}

/// Returns the offset after a number of lines.
fn skip_lines(file: &Path, start: u64, lines: i64) -> Option<u64> {
    use std::io::{BufRead, Seek};
    if lines == 0 {
        return Some(start);
    }
    let mut file = std::fs::File::open(file).ok()?;
    file.seek(std::io::SeekFrom::Start(start)).ok()?;
    let mut reader = std::io::BufReader::new(file);
    let mut at = start;
    for _ in 0..u64::try_from(lines).ok()? {
        match reader.skip_until(b'\n').ok()? {
            0 => return None,
            n => at += n as u64,
        }
    }
    Some(at)
}

fn sample_type(name: &str) -> Option<SampleType> {
    Some(match name {
        "signed char" | "int8" | "int8_t" => SampleType::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => SampleType::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
            SampleType::I16
        }
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => {
            SampleType::U16
        }
        "int" | "signed int" | "int32" | "int32_t" => SampleType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => SampleType::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "int64"
        | "int64_t"
        | "signed long long int" => SampleType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => {
            SampleType::U64
        }
        "float" => SampleType::F32,
        "double" => SampleType::F64,
        _ => return None,
    })
}

/// Returns the direction of each axis, or `None` if the header gives no directions. An axis without
/// direction has the entry `None`.
fn directions(header: &Header<'_>, rank: usize) -> Result<Option<Vec<Option<Vec<f64>>>>> {
    let Some(text) = header.value("spacedirections") else {
        return Ok(None);
    };
    let bad = || header.value_error("space directions", text);
    let mut vectors = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        if let Some(tail) = rest.strip_prefix("none") {
            vectors.push(None);
            rest = tail.trim_start();
            continue;
        }
        let parenthesised = rest.strip_prefix('(').and_then(|r| r.split_once(')'));
        let (vector, tail) = parenthesised.ok_or_else(bad)?;
        vectors.push(Some(parse_vector(vector).ok_or_else(bad)?));
        rest = tail.trim_start();
    }
    if vectors.len() == rank {
        Ok(Some(vectors))
    } else {
        Err(bad())
    }
}

/// Parses one to three finite numbers separated by commas.
fn parse_vector(text: &str) -> Option<Vec<f64>> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|w| w.trim().parse().ok()).collect();
    numbers.filter(|v| (1..=3).contains(&v.len()) && v.iter().all(|x| x.is_finite()))
}

/// Returns the axes of the image, the fastest first: the axes of space, and all others with more
/// than one sample.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if an axis with several samples is not an axis of
/// space.
fn axes(
    header: &Header<'_>,
    counts: &[usize],
    directions: &Option<Vec<Option<Vec<f64>>>>,
) -> Result<Vec<usize>> {
    let kinds: Vec<&str> = header
        .value("kinds")
        .unwrap_or("")
        .split_whitespace()
        .collect();
    let is_space = |axis: usize| {
        let kind = kinds.get(axis).map_or("domain", |kind| kind);
        matches!(kind, "domain" | "space" | "???" | "none" | "time" | "list")
            && directions.as_ref().is_none_or(|d| d[axis].is_some())
    };
    let mut axes: Vec<usize> = (0..counts.len()).collect();
    axes.retain(|&axis| is_space(axis) || counts[axis] != 1);
    match axes.iter().find(|&&axis| !is_space(axis)) {
        None => Ok(axes),
        Some(&axis) => {
            let problem = format!("has {} values per sample (axis {axis})", counts[axis]);
            Err(file_error(header.path, problem, "give one component"))
        }
    }
}

fn geometry(
    header: &Header<'_>,
    axes: &[usize],
    directions: &Option<Vec<Option<Vec<f64>>>>,
) -> Result<Geometry<3>> {
    let mut geometry = Geometry::default();
    let quoted = |text: &str| -> Vec<String> {
        text.split('"')
            .skip(1)
            .step_by(2)
            .map(String::from)
            .collect()
    };
    if let Some(directions) = directions {
        for (k, &axis) in axes.iter().take(3).enumerate() {
            let vector = directions[axis].as_deref().unwrap_or_default();
            geometry.axes[k] = std::array::from_fn(|c| vector.get(c).copied().unwrap_or(0.0));
        }
        if axes.len() == 2 {
            // The third axis is perpendicular to the other two.
            let [a, b, _] = geometry.axes;
            geometry.axes[2] = unit(cross(a, b));
        }
        if let Some(units) = header.value("spaceunits") {
            for (unit, name) in geometry.units.iter_mut().zip(quoted(units)) {
                *unit = name;
            }
        }
    } else if let Some(text) = header.value("spacings") {
        let spacings: Vec<f64> = text
            .split_whitespace()
            .filter_map(|w| w.parse().ok())
            .collect();
        for (k, &axis) in axes.iter().take(3).enumerate() {
            let step = spacings.get(axis).filter(|s| s.is_finite() && **s != 0.0);
            geometry.axes[k][k] = step.copied().unwrap_or(1.0);
        }
        if let Some(units) = header.value("units").map(quoted) {
            for (k, &axis) in axes.iter().take(3).enumerate() {
                geometry.units[k] = units.get(axis).cloned().unwrap_or_default();
            }
        }
    }
    if let Some(labels) = header.value("labels").map(quoted) {
        for (k, &axis) in axes.iter().take(3).enumerate() {
            if let Some(name) = labels.get(axis).filter(|name| !name.is_empty()) {
                geometry.names[k].clone_from(name);
            }
        }
    }
    if directions.is_none() {
        place_along_axes(header, axes, &mut geometry)?;
    }
    if let Some(text) = header.value("spaceorigin") {
        let parenthesised = text
            .trim()
            .strip_prefix('(')
            .and_then(|t| t.strip_suffix(')'));
        let origin = parenthesised.and_then(parse_vector);
        let origin = origin.ok_or_else(|| header.value_error("space origin", text))?;
        geometry.origin = std::array::from_fn(|c| origin.get(c).copied().unwrap_or(0.0));
    }
    let space = header.value("space").unwrap_or_default().to_lowercase();
    let flipped: &[usize] = match space.trim_end_matches("-time") {
        "right-anterior-superior" | "ras" | "rast" => &[0, 1],
        "left-anterior-superior" | "las" | "last" => &[1],
        _ => &[],
    };
    for vector in geometry.axes.iter_mut().chain([&mut geometry.origin]) {
        for &c in flipped {
            // The subtraction avoids -0.
            vector[c] = 0.0 - vector[c];
        }
    }
    // The determinant is zero, too, if the axes of a plane are parallel and the third axis is NaN.
    if geometry.determinant() == 0.0 {
        let problem = "its axes are linearly dependent";
        return Err(file_error(header.path, problem, "set 'space directions'"));
    }
    Ok(geometry)
}

/// Sets the origin, and the spacing if only the ends of the axes are given, for axes without
/// directions. `axis mins` and `axis maxs` are the positions of samples, or with cells as `centers`
/// the ends of the intervals in whose middle the samples lie.
fn place_along_axes(header: &Header<'_>, axes: &[usize], geometry: &mut Geometry<3>) -> Result<()> {
    let words = |name: &str| -> Option<Vec<&str>> {
        Some(header.value(name)?.split_whitespace().collect())
    };
    let numbers = |name: &str| -> Result<Vec<Option<f64>>> {
        let Some(words) = words(name) else {
            return Ok(Vec::new());
        };
        let number = |word: &&str| match word.parse::<f64>() {
            Ok(number) => Ok(Some(number).filter(|x| x.is_finite())),
            Err(_) => Err(header.value_error(name, word)),
        };
        words.iter().map(number).collect()
    };
    let value_at = |list: &[Option<f64>], axis: usize| list.get(axis).copied().flatten();
    let (mins, maxs) = (numbers("axismins")?, numbers("axismaxs")?);
    let spacings = numbers("spacings")?;
    let counts = numbers("sizes")?;
    let centers = words("centers").or_else(|| words("centerings"));
    for (k, &axis) in axes.iter().take(3).enumerate() {
        let in_cells = centers.as_ref().and_then(|c| c.get(axis)) == Some(&"cell");
        let (Some(min), count) = (
            value_at(&mins, axis),
            value_at(&counts, axis).unwrap_or(1.0),
        ) else {
            continue;
        };
        let intervals = if in_cells { count } else { count - 1.0 };
        if let (None, Some(max)) = (value_at(&spacings, axis), value_at(&maxs, axis))
            && intervals > 0.0
            && max != min
        {
            geometry.axes[k][k] = (max - min) / intervals;
        }
        let first = if in_cells { 0.5 } else { 0.0 };
        geometry.origin[k] = min + first * geometry.axes[k][k];
    }
    Ok(())
}

/// Writes compressed (gzip) 32-bit floats, the geometry in double precision, and the names and
/// units of axes.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write<const D: usize>(
    path: &Path,
    dims: [usize; D],
    geometry: &Geometry<D>,
    slabs: &dyn SlabSource,
) -> Result<()> {
    let vector = |v: &[f64; D]| format!("({})", v.map(|x| format!("{x:?}")).join(","));
    let quoted = |words: &[String; D]| {
        let clean = |word: &String| format!("\"{}\"", word.replace(['"', '\n'], " "));
        words.iter().map(clean).collect::<Vec<_>>().join(" ")
    };
    let units = if geometry.units.iter().all(String::is_empty) {
        String::new()
    } else {
        format!("space units: {}\n", quoted(&geometry.units))
    };
    let header = format!(
        "NRRD0004\ntype: float\ndimension: {D}\nspace dimension: {D}\nsizes: {}\n\
         space directions: {}\nkinds: {}\nlabels: {}\n{units}endian: little\nencoding: gzip\n\
         space origin: {}\n\n",
        dims.map(|n| n.to_string()).join(" "),
        geometry.axes.each_ref().map(vector).join(" "),
        ["domain"; D].join(" "),
        quoted(&geometry.names),
        vector(&geometry.origin),
    );
    atomic_write(path, |out| {
        out.write_all(header.as_bytes())?;
        let mut out = GzEncoder::new(out, Compression::fast());
        samples::write_slabs(&mut out, slabs)?;
        out.finish().map(|_| ())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_begin_where_the_header_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nrrd");
        let placement_of = |fields: &str| {
            let header = format!(
                "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 3 1 2\nencoding: raw\n{fields}\n\n"
            );
            std::fs::write(&path, [header.as_bytes(), &[0; 6]].concat()).unwrap();
            let geometry = read(&path).unwrap().image.geometry;
            let steps: [f64; 3] = std::array::from_fn(|k| geometry.axes[k][k]);
            (geometry.origin, steps)
        };
        assert_eq!(placement_of(""), ([0.0; 3], [1.0; 3]));
        assert_eq!(
            placement_of("spacings: 2 3 -4\naxis mins: 10 20 30"),
            ([10.0, 20.0, 30.0], [2.0, 3.0, -4.0])
        );
        assert_eq!(
            placement_of("spacings: 2 3 4\naxis mins: 10 nan 30\ncenters: cell cell node"),
            ([11.0, 0.0, 30.0], [2.0, 3.0, 4.0])
        );
        assert_eq!(
            placement_of("axis mins: 10 20 30\naxis maxs: 16 20 32\ncenterings: node ??? cell"),
            ([10.0, 20.0, 30.5], [3.0, 1.0, 1.0])
        );
    }
}
