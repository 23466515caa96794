//! NRRD (`.nrrd`, or `.nhdr` with a separate file of samples), versions 1 to 5: lines `field:
//! value`, an empty line, and the samples as raw bytes, gzip or text.
//!
//! Positions in the spaces right-anterior-superior and left-anterior-superior are converted to
//! left-posterior-superior, as ITK does. Positions in all other spaces are used as they are.
//! `segments` reads the names of labels and the layers of 3D Slicer's segmentations.

use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::metaimage::sibling;
use super::packed::{
    self, DAMAGED_REMEDY, PackedSamples, SamplePacking, SampleStart, dims_from_sizes, file_error,
};
use super::samples::{self, Encoding, Endian, SampleType};
use super::segments::{Segment, describe_layers, label_names, note_on_names, segments};
use super::stream::SlabSource;
use super::{ImageFormat, LoadedImage};
use crate::error::{Error, Result, cause};
use crate::files::atomic_write;
use crate::geometry::{cross, unit};
use crate::image::{ExactLabels, Geometry, Image};

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
            let field = line.split_once(": ").or_else(|| line.split_once(':'));
            // Lines `key:=value` are no fields.
            let is_field =
                |(name, value): &(&str, &str)| !value.starts_with('=') && !name.contains(":=");
            if let Some((name, value)) = field.filter(is_field) {
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

/// Reads a volume. A plane is read as a volume with a single sample along z. Of an image with an axis
/// of layers, that with the number `layer` is read.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file, or the file of its samples, cannot be
/// read, is truncated or damaged, has more than one value per sample, or has an unsupported
/// encoding.
pub fn read(path: &Path, layer: Option<usize>) -> Result<LoadedImage> {
    let (head, _) = packed::read_head(path, MAX_HEADER_BYTES)?;
    let text = packed::ascii_text(&head);
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
    let mut axes = axes(&header, &counts, &directions);
    let layer_axis = layer_axis(&header, &counts, &axes, &directions);
    let segments = segments(&key_value_pairs(&head, header.end), layer_axis.is_some());
    let layers = Layers::new(&counts, layer_axis);
    let layer = layers.number(&header, &segments, layer)?;
    axes.retain(|axis| Some(*axis) != layer_axis);
    check_components(&header, &counts, &axes, &directions)?;
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
        dims: layer_axis.map_or(dims, |_| layers.sizes),
    };
    let mut loaded = packed.load(ImageFormat::Nrrd, geometry, None, Vec::new())?;
    if layer_axis.is_some() {
        loaded.image = layers.image(&loaded.image, layer, dims);
        loaded.notes.push(format!(
            "layer {layer} of {} is read: {}",
            layers.count(),
            describe_layers(&segments, layers.count())
        ));
    }
    loaded.image.label_names = label_names(&segments, layer);
    (loaded.notes).extend(note_on_names(&loaded.image.label_names));
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
fn directions(header: &Header<'_>, rank: usize) -> Result<Directions> {
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

/// Directions of axes, if the header gives them; `None` for an axis without direction.
type Directions = Option<Vec<Option<Vec<f64>>>>;

/// Returns the kind of an axis.
fn kind<'a>(header: &Header<'a>, axis: usize) -> &'a str {
    let kinds = header.value("kinds").unwrap_or("");
    kinds.split_whitespace().nth(axis).unwrap_or("domain")
}

/// Returns `true` for an axis of space.
fn is_space(header: &Header<'_>, axis: usize, directions: &Directions) -> bool {
    matches!(
        kind(header, axis),
        "domain" | "space" | "???" | "none" | "time" | "list"
    ) && directions.as_ref().is_none_or(|d| d[axis].is_some())
}

/// Returns the axes of the image, the fastest first: the axes of space, and all others with more
/// than one sample.
fn axes(header: &Header<'_>, counts: &[usize], directions: &Directions) -> Vec<usize> {
    let mut axes: Vec<usize> = (0..counts.len()).collect();
    axes.retain(|&axis| is_space(header, axis, directions) || counts[axis] != 1);
    axes
}

/// Returns the axis that counts layers: of the kind `list`, without a direction, beside axes of space.
fn layer_axis(
    header: &Header<'_>,
    counts: &[usize],
    axes: &[usize],
    directions: &Directions,
) -> Option<usize> {
    let is_layers =
        |axis: &&usize| kind(header, **axis) == "list" && !is_space(header, **axis, directions);
    let layers = axes.iter().find(is_layers).copied();
    layers.filter(|_| counts.len() > 2)
}

/// Checks that each sample has one value.
fn check_components(
    header: &Header<'_>,
    counts: &[usize],
    axes: &[usize],
    directions: &Directions,
) -> Result<()> {
    let mut others = axes
        .iter()
        .filter(|axis| !is_space(header, **axis, directions));
    match others.next() {
        None => Ok(()),
        Some(&axis) => {
            let problem = format!("has {} values per sample (axis {axis})", counts[axis]);
            Err(file_error(header.path, problem, "give one component"))
        }
    }
}

/// The key/value pairs of a header that ends at byte `end`, in UTF-8.
fn key_value_pairs(head: &[u8], end: u64) -> Vec<(String, String)> {
    let head = &head[..head.len().min(end as usize)];
    let text = String::from_utf8_lossy(head);
    let pair = |line: &str| {
        let (key, value) = line.split_once(":=")?;
        Some((key.trim().to_string(), value.trim().to_string()))
    };
    text.lines().filter_map(pair).collect()
}

/// The layers of an image in the order of its samples.
struct Layers {
    /// Number of samples that lie side by side in one layer, number of layers, and number of such
    /// runs in a layer.
    sizes: [usize; 3],
}

impl Layers {
    fn new(counts: &[usize], axis: Option<usize>) -> Self {
        let product = |counts: &[usize]| counts.iter().fold(1usize, |n, &c| n.saturating_mul(c));
        let sizes = match axis {
            Some(axis) => [
                product(&counts[..axis]),
                counts[axis],
                product(&counts[axis + 1..]),
            ],
            None => [product(counts), 1, 1],
        };
        Self { sizes }
    }

    fn count(&self) -> usize {
        self.sizes[1]
    }

    /// Returns the number of the layer that is read.
    ///
    /// # Errors
    /// Returns an [`Error::Io`](crate::Error::Io) that lists the layers if none is chosen of several,
    /// or one that does not exist.
    fn number(
        &self,
        header: &Header<'_>,
        segments: &[Segment],
        chosen: Option<usize>,
    ) -> Result<usize> {
        let problem = match chosen {
            None if self.count() == 1 => return Ok(0),
            Some(layer) if layer < self.count() => return Ok(layer),
            None => format!("has {} layers", self.count()),
            Some(layer) => format!("has no layer {layer}"),
        };
        let layers = describe_layers(segments, self.count());
        let remedy = format!("give one of the layers {layers}");
        let error = cause(header.path.display(), problem, remedy);
        Err(Error::Io(error.with_parameter("layer")))
    }

    /// Returns one layer of an image of all layers.
    fn image(&self, all: &Image<3>, layer: usize, dims: [usize; 3]) -> Image<3> {
        let [run, count, runs] = self.sizes;
        let starts = || (0..runs).map(|k| (k * count + layer) * run);
        let samples = starts().flat_map(|start| &all.as_slice()[start..start + run]);
        let samples = samples.copied().collect();
        let mut image = Image::new(dims, samples, all.geometry.clone());
        image.labels = all.labels.as_ref().map(|labels| {
            let offsets = starts().flat_map(|start| start..start + run);
            ExactLabels::from_integers(offsets.map(|i| labels.values[labels.indices[i] as usize]))
        });
        image
    }
}

fn geometry(header: &Header<'_>, axes: &[usize], directions: &Directions) -> Result<Geometry<3>> {
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
/// directions. `axis mins` and `axis maxs` are the positions of samples, or with cells as `centres`
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
    let centres = words("centers").or_else(|| words("centerings"));
    for (k, &axis) in axes.iter().take(3).enumerate() {
        let in_cells = centres.as_ref().and_then(|c| c.get(axis)) == Some(&"cell");
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
    use crate::image::LabelValue;

    #[test]
    fn axes_begin_where_the_header_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nrrd");
        let placement_of = |fields: &str| {
            let header = format!(
                "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 3 1 2\nencoding: raw\n{fields}\n\n"
            );
            std::fs::write(&path, [header.as_bytes(), &[0; 6]].concat()).unwrap();
            let geometry = read(&path, None).unwrap().image.geometry;
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

    /// Returns a segmentation of two layers, as 3D Slicer writes it.
    fn layered_segmentation() -> Vec<u8> {
        let header = "NRRD0004\ntype: unsigned char\ndimension: 4\nspace: left-posterior-superior\n\
                      sizes: 2 3 2 2\nspace directions: none (2,0,0) (0,2,0) (0,0,3)\n\
                      kinds: list domain domain domain\nencoding: raw\nspace origin: (10,20,30)\n\
                      Segment0_LabelValue:=1\nSegment0_Layer:=0\nSegment0_Name:=Kn\u{f6}chel\n\
                      Segment1_LabelValue:=1\nSegment1_Layer:=1\nSegment1_Name:=Skin: outer\n\
                      Segment2_LabelValue:=2\nSegment2_Layer:=0\nSegment2_Name:=Muscle\n\
                      Segmentation_ReferenceImageExtentOffset:=5 6 7\n\n";
        // The layer is the fastest axis; layer 0 holds 1 and 2, layer 1 holds 0 and 1.
        let samples = (0..12).flat_map(|i| [1 + u8::from(i % 3 == 2), u8::from(i < 6)]);
        [header.as_bytes(), &samples.collect::<Vec<u8>>()].concat()
    }

    #[test]
    fn a_layer_of_a_segmentation_is_read_with_the_names_of_its_labels() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.seg.nrrd");
        std::fs::write(&path, layered_segmentation()).unwrap();
        let name = |label: i128, name: &str| (LabelValue::Whole(label), name.to_string());
        let names = [
            vec![name(1, "Kn\u{f6}chel"), name(2, "Muscle")],
            vec![name(1, "Skin: outer")],
        ];
        let samples: [Vec<f32>; 2] = [
            (0..12)
                .map(|i| if i % 3 == 2 { 2.0 } else { 1.0 })
                .collect(),
            (0..12).map(|i| if i < 6 { 1.0 } else { 0.0 }).collect(),
        ];
        for layer in 0..2 {
            let image = read(&path, Some(layer)).unwrap().image;
            assert_eq!(image.dims(), [3, 2, 2]);
            assert_eq!(image.as_slice(), samples[layer]);
            assert_eq!(image.label_names, names[layer]);
            // The offset in the image that was segmented does not move the samples.
            assert_eq!(image.geometry.origin, [10.0, 20.0, 30.0]);
            assert_eq!(image.geometry.spacing(), [2.0, 2.0, 3.0]);
        }
        for layer in [None, Some(2)] {
            let error = read(&path, layer).unwrap_err().to_string();
            assert!(
                error.contains("0 (Kn\u{f6}chel, Muscle), 1 (Skin: outer)"),
                "{error}"
            );
        }
    }

    #[test]
    fn colors_are_not_layers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.nrrd");
        let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 3 2 2\nkinds: RGB-color domain domain\nencoding: raw\n\n";
        std::fs::write(&path, [header.as_bytes(), &[0; 12]].concat()).unwrap();
        let error = read(&path, None).unwrap_err().to_string();
        assert!(error.contains("has 3 values per sample"), "{error}");
    }
}
