//! SEG-Y files made here, byte by byte, and real ones where they are at hand.

use std::path::{Path, PathBuf};

use proptest::prelude::*;

use super::header::FILE_HEADER;
use super::*;
use crate::image::Image;
use crate::io::{self, ReadOptions, segy};

/// One trace: its header fields as (first byte, width, value), and its samples.
#[derive(Clone)]
struct Trace {
    fields: Vec<(usize, usize, i64)>,
    samples: Vec<f64>,
}

#[derive(Clone)]
struct Made {
    little: bool,
    format: i64,
    /// Binary header fields: (byte in the file, width, value).
    fields: Vec<(usize, usize, i64)>,
    extended_text: Vec<&'static str>,
    traces: Vec<Trace>,
}

const SAMPLES: usize = 6;

/// The sample at an inline, crossline and sample index: exact in every format, 8-bit ones included.
fn value(i: usize, c: usize, k: usize) -> f64 {
    ((i * 31 + c * 7 + k * 3) % 120) as f64 - 40.0
}

/// A survey of 4 inlines 10, 12 .. and 3 crosslines 100, 105 .., rotated by 30 degrees, far away.
fn place(i: usize, c: usize) -> [f64; 2] {
    let (sin, cos) = 30f64.to_radians().sin_cos();
    let (a, b) = (25.0 * i as f64, 12.5 * c as f64);
    [
        620_000.0 + a * cos - b * sin,
        6_070_000.0 + a * sin + b * cos,
    ]
}

fn trace(i: usize, c: usize) -> Trace {
    let [x, y] = place(i, c).map(|v| (v * 100.0).round() as i64);
    Trace {
        fields: vec![
            (189, 4, 10 + 2 * i as i64),
            (193, 4, 100 + 5 * c as i64),
            (181, 4, x),
            (185, 4, y),
            (71, 2, -100),
            (109, 2, 48),
        ],
        samples: (0..SAMPLES).map(|k| value(i, c, k)).collect(),
    }
}

fn survey() -> Made {
    let cells = (0..4).flat_map(|i| (0..3).map(move |c| (i, c)));
    Made {
        little: false,
        format: 5,
        fields: vec![(3217, 2, 4000), (3255, 2, 1)],
        extended_text: Vec::new(),
        traces: cells.map(|(i, c)| trace(i, c)).collect(),
    }
}

fn ibm(v: f64) -> u32 {
    if v == 0.0 {
        return 0;
    }
    let mut exponent = 64;
    let mut fraction = v.abs();
    while fraction >= 1.0 {
        fraction /= 16.0;
        exponent += 1;
    }
    while fraction < 1.0 / 16.0 {
        fraction *= 16.0;
        exponent -= 1;
    }
    u32::from(v < 0.0) << 31 | exponent << 24 | (fraction * f64::from(1 << 24)) as u32
}

impl Made {
    fn put(&self, out: &mut [u8], (byte, width, value): (usize, usize, i64)) {
        let field = &mut out[byte - 1..byte - 1 + width];
        field.copy_from_slice(&value.to_be_bytes()[8 - width..]);
        if self.little {
            field.reverse();
        }
    }

    fn bytes(&self) -> Vec<u8> {
        let mut out = vec![b' '; 3200];
        out[..11].copy_from_slice(b"C 1 MADE UP");
        out.resize(FILE_HEADER, 0);
        self.put(&mut out, (3221, 2, SAMPLES as i64));
        self.put(&mut out, (3225, 2, self.format));
        self.put(&mut out, (3505, 2, self.extended_text.len() as i64));
        for &field in &self.fields {
            self.put(&mut out, field);
        }
        for text in &self.extended_text {
            out.extend(text.bytes().chain(std::iter::repeat(b' ')).take(3200));
        }
        for trace in &self.traces {
            let mut header = vec![0; 240];
            for &field in &trace.fields {
                self.put(&mut header, field);
            }
            out.extend(header);
            for &v in &trace.samples {
                let (bits, width) = match self.format {
                    1 => (i64::from(ibm(v)), 4),
                    5 => (i64::from((v as f32).to_bits()), 4),
                    6 => (v.to_bits() as i64, 8),
                    2 | 10 => (v as i64, 4),
                    3 | 11 => (v as i64, 2),
                    7 | 15 => (v as i64, 3),
                    8 | 16 => (v as i64, 1),
                    _ => (v as i64, 8),
                };
                let mut sample = bits.to_be_bytes()[8 - width..].to_vec();
                if self.little {
                    sample.reverse();
                }
                out.extend(sample);
            }
        }
        out
    }

    fn read(&self) -> Result<Loaded> {
        self.read_with(&SegyBytes::default())
    }

    fn read_with(&self, bytes: &SegyBytes) -> Result<Loaded> {
        with_file(&self.bytes(), |path| segy::read(path, bytes))
    }

    fn scan(&self) -> SegyInfo {
        with_file(&self.bytes(), |path| {
            segy::scan(path, &SegyBytes::default()).unwrap().0
        })
    }

    fn refusal(&self) -> String {
        self.read().unwrap_err().to_string()
    }

    fn set(&mut self, trace: usize, byte: usize, width: usize, value: i64) {
        self.traces[trace].fields.push((byte, width, value));
    }
}

fn with_file<T>(bytes: &[u8], job: impl FnOnce(&Path) -> T) -> T {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.sgy");
    std::fs::write(&path, bytes).unwrap();
    job(&path)
}

fn assert_values(image: &Image<3>) {
    assert_eq!(image.dims(), [SAMPLES, 3, 4]);
    for ((i, c, k), v) in ndarray::indices((4, 3, SAMPLES))
        .into_iter()
        .zip(image.as_slice())
    {
        assert_eq!(
            f64::from(*v),
            value(i, c, k),
            "inline {i} crossline {c} sample {k}"
        );
    }
}

fn has_note(loaded: &Loaded, text: &str) -> bool {
    loaded.notes.iter().any(|note| note.contains(text))
}

#[test]
fn every_sample_format_in_both_byte_orders() {
    for little in [false, true] {
        for format in [1, 2, 3, 5, 6, 7, 8, 9] {
            let loaded = Made {
                little,
                format,
                ..survey()
            }
            .read()
            .unwrap();
            assert_values(&loaded.image);
        }
        for (format, wrap) in [
            (10, 2f64.powi(32)),
            (11, 65536.0),
            (15, 2f64.powi(24)),
            (16, 256.0),
        ] {
            let image = Made {
                little,
                format,
                ..survey()
            }
            .read()
            .unwrap()
            .image;
            let v = value(0, 0, 0);
            assert_eq!(image.as_slice()[0], (v + wrap) as f32, "format {format}");
            assert_eq!(f64::from(image.samples[[1, 2, 5]]), value(1, 2, 5));
        }
    }
    let refused = Made {
        format: 4,
        ..survey()
    }
    .refusal();
    assert!(refused.contains("sample format 4"), "{refused}");
    let refused = Made {
        format: 0,
        ..survey()
    }
    .refusal();
    assert!(refused.contains("sample format 0"), "{refused}");
}

#[test]
fn geometry_of_a_rotated_survey() {
    let loaded = survey().read().unwrap();
    let geometry = &loaded.image.geometry;
    assert_eq!(geometry.names, ["sample", "crossline", "inline"]);
    assert_eq!(geometry.units, ["m", "m", "ms"]);
    for (i, c, k) in [(0, 0, 0), (3, 2, 5), (1, 2, 0)] {
        let found = geometry.to_physical([k as f64, c as f64, i as f64]);
        let [x, y] = place(i, c);
        // Coordinates are rounded to centimetres.
        assert!(
            (found[0] - x).abs() < 0.01 && (found[1] - y).abs() < 0.01,
            "{found:?}"
        );
        assert_eq!(found[2], -(48.0 + 4.0 * k as f64));
    }
    let fit = loaded.survey.unwrap().fit.unwrap();
    assert!(fit.max < 0.01 && fit.rms > 0.0);
    // Down, then to the left of the inlines, then along them: right-handed.
    assert!((geometry.determinant() - 4.0 * 12.5 * 25.0).abs() < 1.0);
}

#[test]
fn any_order_of_traces() {
    let mut made = survey();
    let crossline_first: Vec<Trace> = (0..3)
        .flat_map(|c| (0..4).map(move |i| trace(i, c)))
        .collect();
    made.traces = crossline_first;
    assert_values(&made.read().unwrap().image);
    made.traces.reverse();
    assert_values(&made.read().unwrap().image);
    made.traces.swap(2, 9);
    assert_values(&made.read().unwrap().image);
}

#[test]
fn missing_and_duplicate_traces_are_told() {
    let mut made = survey();
    made.traces.remove(4); // inline 1, crossline 1
    let mut twice = trace(0, 2);
    twice.samples.fill(99.0);
    made.traces.push(twice);
    let loaded = made.read().unwrap();
    let info = loaded.survey.as_ref().unwrap();
    assert_eq!((info.missing, info.duplicates), (1, 1));
    assert!(has_note(&loaded, "1 of 12 cells have no trace"));
    assert!(has_note(&loaded, "1 traces repeat"));
    assert_eq!(loaded.image.samples[[1, 1, 3]], 0.0);
    // The first of the duplicates stays.
    assert_eq!(f64::from(loaded.image.samples[[0, 2, 3]]), value(0, 2, 3));
}

#[test]
fn coordinates_are_never_taken_on_trust() {
    // Line numbers where X and Y should be, coordinates in source X, Y.
    let mut made = survey();
    for t in 0..12 {
        let (i, c) = (t / 3, t % 3);
        let [x, y] = place(i, c).map(|v| (v * 100.0).round() as i64);
        made.set(t, 181, 4, 10 + 2 * i as i64);
        made.set(t, 185, 4, 100 + 5 * c as i64);
        made.set(t, 73, 4, x);
        made.set(t, 77, 4, y);
    }
    let loaded = made.read().unwrap();
    assert!(has_note(
        &loaded,
        "bytes 181 and 185 only repeat the line numbers"
    ));
    assert!(has_note(&loaded, "placed by X, Y at bytes 73 and 77"));
    assert!((loaded.image.geometry.origin[0] - 620_000.0).abs() < 0.01);

    // Scattered coordinates: none can be used.
    for t in 0..12 {
        for byte in [73, 77, 181, 185] {
            made.set(t, byte, 4, ((t * 7919 + byte * 31) % 1009) as i64);
        }
    }
    let loaded = made.read().unwrap();
    assert!(has_note(&loaded, "do not follow the line numbers"));
    assert!(has_note(&loaded, "no usable X, Y"));
    let geometry = &loaded.image.geometry;
    assert_eq!(geometry.to_physical([0.0, 2.0, 3.0])[..2], [16.0, 110.0]);
    assert_eq!(geometry.units, ["line", "line", "ms"]);
}

#[test]
fn scalars_multiply_divide_or_do_nothing() {
    for (scalar, factor) in [(-10, 0.1), (10, 10.0), (0, 1.0), (1, 1.0)] {
        let mut made = survey();
        for t in 0..12 {
            made.set(t, 71, 2, scalar);
        }
        let found = made.read().unwrap().image.geometry.origin[0];
        assert!(
            (found - 62_000_000.0 * factor).abs() < factor,
            "{scalar}: {found}"
        );
    }
    // Byte 0: no scalar at all.
    let ignored = survey()
        .read_with(&"scalar=0,delay=0".parse().unwrap())
        .unwrap();
    let origin = ignored.image.geometry.origin;
    assert!((origin[0] - 62_000_000.0).abs() < 1.0);
    assert_eq!(origin[2], 0.0);
}

#[test]
fn line_numbers_elsewhere() {
    let mut made = survey();
    for t in 0..12 {
        for (from, to) in [(189, 9), (193, 21)] {
            let number = made.traces[t]
                .fields
                .iter()
                .find(|f| f.0 == from)
                .unwrap()
                .2;
            made.set(t, to, 4, number);
            made.set(t, from, 4, 0);
        }
    }
    let loaded = made.read().unwrap();
    assert_values(&loaded.image);
    assert!(has_note(
        &loaded,
        "bytes 9 and 21 make one and are used instead"
    ));
    let told = made
        .read_with(&"inline=9,crossline=21".parse().unwrap())
        .unwrap();
    assert_eq!(told.image, loaded.image);
    assert!(!has_note(&told, "instead"));
    // Wrong bytes by the user are not second-guessed.
    let wrong = made
        .read_with(&"inline=13,crossline=17".parse().unwrap())
        .unwrap_err();
    assert!(wrong.to_string().contains("--segy-bytes"), "{wrong}");
}

#[test]
fn what_is_no_volume_is_refused_and_described() {
    let cut = |traces: usize| {
        let mut made = survey();
        made.traces.truncate(traces);
        made
    };
    for (made, says) in [
        (cut(0), "has no traces"),
        (cut(1), "has a single trace"),
        (cut(3), "is a single line"),
    ] {
        let refused = made.refusal();
        assert!(refused.contains(says), "{refused}");
        let info = made.scan();
        assert_eq!(info.traces, made.traces.len());
        assert!(info.problem.unwrap().contains(says));
    }

    let mut gathers = survey();
    for c in 0..12 {
        let mut far = gathers.traces[c].clone();
        far.fields.push((37, 4, 500));
        gathers.traces.push(far);
    }
    assert!(gathers.refusal().contains("pre-stack"));

    let mut shifted = survey();
    shifted.set(7, 109, 2, 52);
    assert!(shifted.refusal().contains("from 48 to 52 ms"));
    assert!(shifted.read_with(&"delay=0".parse().unwrap()).is_ok());
    shifted.set(7, 29, 2, 2); // a dead trace
    assert!(shifted.read().is_ok());
}

#[test]
fn cut_off_files() {
    let bytes = survey().bytes();
    let read = |length: usize| {
        with_file(&bytes[..length], |path| {
            segy::read(path, &SegyBytes::default())
        })
        .unwrap_err()
        .to_string()
    };
    assert!(read(0).contains("is cut off"));
    assert!(read(FILE_HEADER - 1).contains("a SEG-Y header alone has 3600"));
    assert!(read(FILE_HEADER).contains("has no traces"));
    assert!(read(bytes.len() - 1).contains("left over after 11 traces"));
    // A count of extended headers that the file does not have.
    let mut made = survey();
    made.fields.push((3505, 2, 3000));
    assert!(made.refusal().contains("3000 extended textual headers"));
}

#[test]
fn headers_of_later_revisions() {
    let mut made = survey();
    made.extended_text = vec!["((OTHER: STANZA))", "((SEG: EndText))"];
    assert_values(&made.read().unwrap().image);
    made.fields.push((3505, 2, -1));
    assert_values(&made.read().unwrap().image);

    // Revision 2: the sample count and interval in their new places, marked little-endian.
    let mut made = survey();
    made.little = true;
    made.fields.extend([
        (3221, 2, 0),
        (3269, 4, SAMPLES as i64),
        (3273, 8, 2500f64.to_bits() as i64),
        (3297, 4, 0x0102_0304),
    ]);
    let loaded = made.read().unwrap();
    assert_values(&loaded.image);
    assert_eq!(loaded.survey.unwrap().dt_ms, Some(2.5));
    // Revision 1: delay in tenths of a millisecond.
    let mut made = survey();
    made.fields.push((3501, 1, 1));
    for t in 0..12 {
        made.set(t, 215, 2, -10);
    }
    assert_eq!(made.read().unwrap().image.geometry.origin[2], -4.8);
}

#[test]
fn intervals_and_counts_that_disagree_are_told() {
    let mut made = survey();
    made.set(0, 117, 2, 2000);
    made.set(0, 115, 2, 99);
    let loaded = made.read().unwrap();
    assert!(has_note(&loaded, "4000 us, the first trace's 2000 us"));
    assert!(has_note(&loaded, "first trace says 99 samples"));
    // Where the file header's cannot be right, the trace's is used.
    made.fields.extend([(3217, 2, -4000), (3221, 2, 17)]);
    made.set(0, 115, 2, SAMPLES as i64);
    let loaded = made.read().unwrap();
    assert_values(&loaded.image);
    assert_eq!(loaded.survey.unwrap().dt_ms, Some(2.0));
    // None at all: the vertical axis counts samples.
    made.set(0, 117, 2, 0);
    let loaded = made.read().unwrap();
    assert!(has_note(&loaded, "counts samples"));
    assert_eq!(loaded.image.geometry.units[2], "sample");
}

#[test]
fn ieee_floats_labelled_ibm_are_doubted() {
    let mut made = survey();
    made.format = 5;
    for (t, trace) in made.traces.iter_mut().enumerate() {
        trace.samples = (0..200)
            .map(|k| ((t * 200 + k) as f64 * 0.7).sin() * 1000.0)
            .collect();
    }
    made.fields.push((3221, 2, 200));
    assert!(!has_note(&made.read().unwrap(), "odd for IBM"));
    let mut bytes = made.bytes();
    bytes[3225] = 1;
    let loaded = with_file(&bytes, |path| segy::read(path, &SegyBytes::default())).unwrap();
    assert!(has_note(&loaded, "odd for IBM"));
    let mut ibm = made.clone();
    ibm.format = 1;
    assert!(!has_note(&ibm.read().unwrap(), "odd for IBM"));
}

#[test]
fn segy_is_recognised_by_its_content() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("no-ending");
    std::fs::write(&path, survey().bytes()).unwrap();
    let loaded = io::read(&path, &ReadOptions::default()).unwrap();
    assert_eq!(loaded.format, Format::Segy);
    // A mask of zeros and ones has a plausible sample format, but no text.
    std::fs::write(&path, [0u8, 1].repeat(5000)).unwrap();
    let error = io::read(&path, &ReadOptions::default()).unwrap_err();
    assert!(
        error.to_string().contains("no known image format"),
        "{error}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..Default::default() })]
    /// Whatever is wrong with a file, the answer is an image that fits into it, or an error.
    #[test]
    fn damaged_files_never_panic(
        changes in prop::collection::vec((3200usize..4000, any::<u8>()), 0..12),
        cut in 0usize..7000,
        little: bool,
    ) {
        let mut bytes = Made { little, ..survey() }.bytes();
        for (at, byte) in changes {
            bytes[at] = byte;
        }
        bytes.truncate(cut.max(1));
        with_file(&bytes, |path| {
            if let Ok(loaded) = segy::read(path, &SegyBytes::default()) {
                assert!(loaded.image.samples.len() <= 10 * bytes.len());
            }
            let _ = io::describe(path, &ReadOptions::default());
        });
    }
}

/// The folder of real data, if it is there.
fn data(folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("ATOMESH_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let path = root.join(folder);
    if !path.is_dir() {
        println!("skipped: no {} (set ATOMESH_DATA)", path.display());
        return None;
    }
    Some(path)
}

fn read_real(path: &Path) -> Result<Loaded> {
    io::read(path, &ReadOptions::default())
}

#[test]
fn seismic3d() {
    let Some(folder) = data("seismic3d") else {
        return;
    };
    let loaded = read_real(&folder.join("SEISMIC3D.sgy")).unwrap();
    assert_eq!(loaded.image.dims(), [268, 181, 76]);
    let info = loaded.survey.as_ref().unwrap();
    assert_eq!((info.missing, info.duplicates), (0, 0));
    assert_eq!((info.dt_ms, info.t0_ms), (Some(3.0), 999.0));
    assert!(has_note(
        &loaded,
        "bytes 181 and 185 only repeat the line numbers"
    ));
    // Source X, Y hold local metres: a grid of 25 m x 12.5 m, to within rounding.
    let fit = info.fit.as_ref().unwrap();
    assert!((fit.pitch()[0] - 25.0).abs() < 0.01 && (fit.pitch()[1] - 12.5).abs() < 0.01);
    assert!(fit.max < 1.0);
    let geometry = &loaded.image.geometry;
    assert_eq!(geometry.to_physical([267.0, 0.0, 0.0])[2], -1800.0);

    let stats = loaded.image.stats();
    assert!((stats.min + 0.976_118).abs() < 1e-5 && (stats.max - 1.419_807).abs() < 1e-5);
    let mut distinct: Vec<u32> = loaded
        .image
        .as_slice()
        .iter()
        .map(|v| v.to_bits())
        .collect();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), 106);
}

#[test]
fn the_same_cube_in_every_format() {
    let Some(folder) = data("formats_segy/segyio") else {
        return;
    };
    let f3 = read_real(&folder.join("f3.sgy")).unwrap();
    assert_eq!(f3.image.dims(), [75, 18, 23]);
    assert_eq!(f3.image.as_slice()[5000..5003], [793.0, -1653.0, -3525.0]);
    let geometry = &f3.image.geometry;
    assert!((geometry.origin[0] - 620_197.2).abs() < 0.1);
    assert!((geometry.origin[1] - 6_074_232.9).abs() < 0.1);
    let other = read_real(&folder.join("f3-lsb.sgy")).unwrap();
    assert_eq!(other.image, f3.image);
    for format in [1, 2, 3, 5, 6, 7, 9] {
        for order in ["msb", "lsb"] {
            let name = format!("multiformats/Format{format}{order}.sgy");
            let other = read_real(&folder.join(&name)).unwrap();
            assert_eq!(other.image, f3.image, "{name}");
        }
    }
    // These formats cannot hold the values: unsigned ones wrapped, 8-bit ones cut off.
    for (format, modulus) in [(10, 2f64.powi(32)), (11, 65536.0), (15, 2f64.powi(24))] {
        let name = format!("multiformats/Format{format}msb.sgy");
        let image = read_real(&folder.join(&name)).unwrap().image;
        for (a, b) in image.as_slice().iter().zip(f3.image.as_slice()) {
            assert_eq!(*a, f64::from(*b).rem_euclid(modulus) as f32, "{name}");
        }
    }
}

/// Every file of the collection, with what it must give: dims, or part of the refusal.
#[test]
fn odd_and_broken_files() {
    let Some(folder) = data("formats_segy") else {
        return;
    };
    const LINES: &str = "make no survey";
    let refused: &[(&str, &str)] = &[
        ("segyio/1x1.sgy", LINES),
        ("segyio/1xN.sgy", "pre-stack"),
        ("segyio/Mx1.sgy", "pre-stack"),
        ("segyio/broken.sgy", "68 bytes are left over after 3 traces"),
        ("segyio/decrement.sgy", "single line"),
        ("segyio/decrement-lsb.sgy", "single line"),
        ("segyio/increment.sgy", "single line"),
        ("segyio/increment-lsb.sgy", "single line"),
        ("segyio/delay-scalar.sgy", "single trace"),
        ("segyio/interval-neg-bin-neg-trace.sgy", "single trace"),
        ("segyio/interval-neg-bin-pos-trace.sgy", "single trace"),
        ("segyio/interval-pos-bin-neg-trace.sgy", "single trace"),
        ("segyio/long.sgy", LINES),
        ("segyio/multi-text.sgy", "single trace"),
        ("segyio/shot-gather.sgy", LINES),
        ("segyio/small.su", "no known image format"),
        ("segyio/small-lsb.su", "no known image format"),
        ("segyio/text.sgy", "no traces"),
        ("segyio/trace-header-extensions.sgy", "single line"),
        ("segyio/mapping-minimal.sgy", LINES),
        ("segyio/mapping-unsupported-type.sgy", LINES),
        ("segyio/mapping-shifted.sgy", "several traces in a cell"),
        ("segyio/multiformats/Format4msb.sgy", "sample format 4"),
        ("segysak/f3-iline-111.sgy", "single line"),
    ];
    let read: &[(&str, [usize; 3])] = &[
        ("segyio/tiny.sgy", [4, 2, 3]),
        ("segyio/mapping-default.sgy", [4, 2, 3]),
        ("segyio/mapping-empty.sgy", [4, 2, 3]),
        ("segyio/mapping-multiple-stanzas.sgy", [4, 2, 3]),
        ("segyio/stanzas-known-count.sgy", [4, 2, 3]),
        ("segyio/stanzas-unknown-count.sgy", [4, 2, 3]),
        ("segyio/trace-header-extension1.sgy", [4, 2, 3]),
        ("segyio/小文件.sgy", [50, 5, 5]),
        ("segyio/rotated-small-rev2.sgy", [50, 5, 5]),
        ("segysak/f3-ebcidctest.sgy", [463, 100, 2]),
        ("segysak/f3-withdead.sgy", [75, 18, 23]),
        ("segysak/test-geometry.sgy", [4, 202, 61]),
    ];
    for (name, says) in refused {
        let error = read_real(&folder.join(name)).unwrap_err().to_string();
        assert!(error.contains(says), "{name}: {error}");
    }
    for (name, dims) in read {
        assert_eq!(
            read_real(&folder.join(name)).unwrap().image.dims(),
            *dims,
            "{name}"
        );
    }
    let dead = read_real(&folder.join("segysak/f3-withdead.sgy")).unwrap();
    assert_eq!(dead.survey.unwrap().missing, 175);

    // Nothing in the folder may panic, and all but two sorts can at least be described.
    for sub in ["segyio", "segyio/multiformats", "segysak"] {
        for entry in std::fs::read_dir(folder.join(sub)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            let described = io::describe(&path, &ReadOptions::default());
            if name.ends_with(".sgy") && !name.starts_with("Format4") {
                assert!(described.unwrap().to_lines().contains("SEG-Y"), "{name}");
            }
        }
    }
}

#[test]
fn one_survey_turned_in_eight_directions() {
    let Some(folder) = data("formats_segy/segyio") else {
        return;
    };
    // Azimuths of the inline and crossline steps as the file names say, and the scalar as pitch.
    for (name, clockwise) in [
        ("normal", 0.0f64),
        ("acute", 45.0),
        ("right", 90.0),
        ("obtuse", 135.0),
        ("straight", 180.0),
        ("reflex", 225.0),
        ("left", 270.0),
        ("inv-acute", 315.0),
    ] {
        let loaded = read_real(&folder.join(format!("{name}-small.sgy"))).unwrap();
        let fit = loaded.survey.unwrap().fit.unwrap();
        let [x, y] = fit.crossline;
        let off = (x.atan2(y).to_degrees() - clockwise + 180.0).rem_euclid(360.0) - 180.0;
        assert!(off.abs() < 1e-6, "{name}: off by {off} degrees");
        assert!(fit.max < 1e-6 * fit.pitch()[0], "{name}");
    }
}
