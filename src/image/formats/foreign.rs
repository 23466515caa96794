//! Files of other programs that are recognised by their content and not read, each with the tool that
//! converts them without losing the positions of their samples.
//!
//! The table is consulted only where no reader knows a file.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::extension;
use crate::error::{Error, cause};

/// Number of bytes at the start, and at the end, of a container in which its kind is looked for.
const CONTAINER_BYTES: u64 = 1 << 18;

/// First bytes of HDF5 files, whose contents the entries below tell apart.
const HDF5_MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";

/// First bytes of zip archives.
const ZIP_MAGIC: &[u8] = b"PK\x03\x04";

/// Test by which a format is recognised.
#[derive(Clone, Copy)]
enum Mark {
    /// These bytes at this offset.
    At(usize, &'static [u8]),
    /// These first bytes, and this text within the first or the last bytes of the file.
    Within(&'static [u8], &'static [u8]),
    /// A function of the first bytes.
    Is(fn(&[u8]) -> bool),
}

use Mark::{At, Is, Within};

/// A format that is recognised: its name with an article, its mark and the remedy.
type Format = (&'static str, Mark, &'static str);

/// Formats with marks of their own, the more special before the more general.
#[rustfmt::skip]
const FORMATS: &[Format] = &[
    // Seismic volumes.
    ("a VDS volume (OpenVDS)", At(0, b"HueDataStore"), "convert it to SEG-Y, with SEGYExport of OpenVDS"),
    (
        "a ZGY volume",
        At(0, b"VBS\0"),
        "export it as SEG-Y, from Petrel or with seismic-zfp (ZgyConverter, SgzConverter)",
    ),
    ("a CBVS volume of OpendTect", Is(is_cbvs), "export it as SEG-Y, from OpendTect"),
    ("a GOCAD voxet", Is(is_voxet), "give the file of its property with --raw (often f32be), --spacing and --origin"),
    // Geological models.
    (
        "an OMF 1 project",
        At(0, b"\x84\x83\x82\x81"),
        "write its block model to .npy, in Python with omf: the array is reshape(nu, nv, nw).T, as w is \
         fastest; give --spacing and --origin",
    ),
    (
        "an OMF 2 project",
        Within(ZIP_MAGIC, b"Open Mining Format"),
        "write its block model to .npy, in Python with omf: the array is reshape(nw, nv, nu), as u is \
         fastest; give --spacing and --origin",
    ),
    (
        "a geoh5 project",
        Within(HDF5_MAGIC, b"GEOSCIENCE"),
        "write its block model to .npy, in Python with geoh5py: the array is values.reshape(nv, nu, \
         nz).transpose(2, 0, 1), as z is fastest; give --spacing and --origin",
    ),
    (
        "a RESQML package",
        Within(ZIP_MAGIC, b"resqml"),
        "write the property to .npy, in Python with resqpy, and give --spacing and --origin",
    ),
    // Scans.
    ("an MRC volume", Is(is_mrc), "convert it to .nrrd, in Python with SimpleITK or mrcfile"),
    ("an AmiraMesh file", At(0, b"# AmiraMesh"), "save it as .nrrd, from Amira, Avizo or Fiji"),
    ("an Avizo file", At(0, b"# Avizo"), "save it as .nrrd, from Amira, Avizo or Fiji"),
    ("a surface of Amira", At(0, b"# HyperSurface"), "give an image, not a surface"),
    ("a FreeSurfer volume (MGH)", Is(is_mgh), FREESURFER_REMEDY),
    ("a MINC 1 volume", Within(b"CDF", b"minc"), "convert it to .nii, with mnc2nii, or in Python with nibabel"),
    ("a MINC 2 volume", Within(HDF5_MAGIC, b"minc-2.0"), "convert it to .nii, with mnc2nii, or in Python with nibabel"),
    ("an AFNI header", Is(is_afni), "convert it to .nii.gz, with 3dAFNItoNIFTI"),
    ("an Imaris file", Within(HDF5_MAGIC, b"DataSetInfo"), BIOFORMATS_REMEDY),
    ("a Zeiss CZI file", At(0, b"ZISRAWFILE"), BIOFORMATS_REMEDY),
    ("a Nikon ND2 file", At(0, b"\xda\xce\xbe\x0a"), BIOFORMATS_REMEDY),
    ("a Leica LIF file", Is(is_lif), BIOFORMATS_REMEDY),
    (
        "an OLE container, such as of Zeiss Xradia (.txm), Zeiss ZVI or Olympus OIB",
        At(0, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"),
        BIOFORMATS_REMEDY,
    ),
    ("a Scanco ISQ volume", At(0, b"CTDATA-HEADER_V1"), "convert it to .nrrd, in Python with itk-ioscanco"),
    ("a Scanco AIM volume", At(0, b"AIMDATA_V030"), "convert it to .nrrd, in Python with itk-ioscanco"),
    (
        "a JCAMP-DX text, such as the parameters of Bruker",
        At(0, b"##TITLE"),
        "convert the scan to .nii.gz, in Python with brkraw",
    ),
    (
        "an OpenVDB volume",
        At(0, b" BDV"),
        "write its grid to .npy, in Python with pyopenvdb, and give --spacing and --origin",
    ),
    // Maps.
    ("a grid of GMT or another netCDF file", At(0, b"CDF\x01"), NETCDF_REMEDY),
    ("a grid of GMT or another netCDF file", At(0, b"CDF\x02"), NETCDF_REMEDY),
    ("a grid of GMT or another netCDF file", At(0, b"CDF\x05"), NETCDF_REMEDY),
    ("an ERDAS Imagine raster", At(0, b"EHFA_HEADER_TAG"), "convert a grid of heights with gdal_translate -of AAIGrid"),
    (
        "an ENVI header",
        At(0, b"ENVI"),
        "convert a grid of heights with gdal_translate -of AAIGrid, or give the samples with --raw",
    ),
    // Arrays.
    (
        "a MATLAB file",
        At(0, b"MATLAB 5.0 MAT-file"),
        "write the array to .npy, in Python with scipy.io.loadmat and numpy.save",
    ),
    ("a FITS file", At(0, b"SIMPLE  ="), "write the array to .npy, in Python with astropy and numpy.save"),
    ("an HDF4 file", At(0, b"\x0e\x03\x13\x01"), "write the data set to .npy, in Python with pyhdf and numpy.save"),
    (
        "an archive of NumPy (.npz)",
        Within(ZIP_MAGIC, b".npy"),
        "write one of its arrays to .npy, with numpy.load and numpy.save",
    ),
    // Pictures.
    ("a JPEG picture", At(0, b"\xff\xd8\xff"), "convert it to .png, e.g. in Python with Pillow"),
    ("a JPEG 2000 picture", At(0, b"\0\0\0\x0cjP  "), "convert it to .tif, with opj_decompress"),
    ("a JPEG 2000 picture", At(0, b"\xff\x4f\xff\x51"), "convert it to .tif, with opj_decompress"),
    ("a GIF picture", At(0, b"GIF8"), "convert it to .png, e.g. in Python with Pillow"),
    ("a BMP picture", Is(is_bmp), "convert it to .png, e.g. in Python with Pillow"),
    (
        "a WebP picture",
        Is(|head| head.starts_with(b"RIFF") && has(head, 8, b"WEBP")),
        "convert it to .png, e.g. in Python with Pillow",
    ),
    ("a PNM picture", Is(is_pnm), "convert it to .png, e.g. in Python with Pillow"),
    ("an OpenEXR picture", At(0, b"\x76\x2f\x31\x01"), "convert it to .tif, with oiiotool"),
    // Archives.
    ("a zip archive", At(0, ZIP_MAGIC), "unpack it, with unzip"),
    ("a bzip2 file", At(0, b"BZh"), "unpack it, with bunzip2"),
    ("an xz file", At(0, b"\xfd7zXZ\0"), "unpack it, with unxz"),
    ("a Zstandard file", At(0, b"\x28\xb5\x2f\xfd"), "unpack it, with unzstd"),
    ("an LZ4 file", At(0, b"\x04\x22\x4d\x18"), "unpack it, with unlz4"),
    ("a 7-Zip archive", At(0, b"7z\xbc\xaf\x27\x1c"), "unpack it, with 7z x"),
    ("a RAR archive", At(0, b"Rar!\x1a\x07"), "unpack it, with unrar x"),
    ("a tar archive", At(257, b"ustar"), "unpack it, with tar -xf"),
    // Meshes.
    ("a mesh of Gmsh", At(0, b"$MeshFormat"), MESH_REMEDY),
    ("a surface in PLY", Is(|head| head.starts_with(b"ply\n") || head.starts_with(b"ply\r\n")), MESH_REMEDY),
    ("a file of GOCAD", Is(|head| head.trim_ascii_start().starts_with(b"GOCAD ")), MESH_REMEDY),
];

/// Formats without a mark of their own, by plausible headers. They are tried after all readers.
#[rustfmt::skip]
const UNMARKED_FORMATS: &[Format] = &[
    (
        "an SGZ volume (seismic-zfp)",
        Is(is_sgz),
        "convert it to SEG-Y, in Python with seismic_zfp.conversion.SgzConverter",
    ),
    (
        "a DICOM file without a preamble",
        Is(is_bare_dicom),
        "convert the whole series to .nii.gz: dcm2niix FOLDER, or in Python with SimpleITK",
    ),
    ("a header of Madagascar (RSF)", Is(is_rsf), "convert it to SEG-Y, with sfsegywrite"),
];

const FREESURFER_REMEDY: &str =
    "convert it to .nii.gz, with mri_convert, or in Python with nibabel";
const BIOFORMATS_REMEDY: &str = "convert it to .ome.tif, with bfconvert of Bio-Formats";
const NETCDF_REMEDY: &str = "convert a grid of heights with gmt grdconvert IN OUT.grd=sf; write a volume to .npy, \
in Python with xarray and numpy.save";
const MESH_REMEDY: &str = "give an image, not a mesh or a surface";

/// Returns `true` if `bytes` stand at an offset of the first bytes of a file.
fn has(head: &[u8], offset: usize, bytes: &[u8]) -> bool {
    head.get(offset..)
        .is_some_and(|rest| rest.starts_with(bytes))
}

/// Returns `true` if `bytes` stand anywhere in `text`.
fn contains(text: &[u8], bytes: &[u8]) -> bool {
    text.windows(bytes.len()).any(|window| window == bytes)
}

/// Returns the integer of 32 bits, lowest byte first, with this number in a header of such integers.
fn word(head: &[u8], number: usize) -> Option<u32> {
    let bytes = head.get(4 * number..)?.first_chunk()?;
    Some(u32::from_le_bytes(*bytes))
}

/// Returns `true` for the volumes of OpendTect: three letters and a flag of the byte order.
fn is_cbvs(head: &[u8]) -> bool {
    head.starts_with(b"dGB") && head.get(3).is_some_and(|flag| *flag < 2)
}

fn is_voxet(head: &[u8]) -> bool {
    head.trim_ascii_start().starts_with(b"GOCAD Voxet")
}

/// Returns `true` for a data set of DICOM that begins with an element of group 2 or 8, in little-endian
/// order with a value representation.
fn is_bare_dicom(head: &[u8]) -> bool {
    const REPRESENTATIONS: [&[u8; 2]; 8] = [b"UL", b"UI", b"CS", b"SH", b"LO", b"DA", b"TM", b"OB"];
    let starts = has(head, 0, b"\x08\0") || has(head, 0, b"\x02\0");
    let is_early_element = head.get(3) == Some(&0) && head.get(2).is_some_and(|e| *e < 0x21);
    let vr = head.get(4..6);
    starts && is_early_element && REPRESENTATIONS.iter().any(|known| vr == Some(&known[..]))
}

/// Returns `true` for volumes of MRC and CCP4: a text, and a stamp of the byte order.
fn is_mrc(head: &[u8]) -> bool {
    let stamp = head.get(212..214);
    has(head, 208, b"MAP")
        && [b"\x44\x44", b"\x44\x41", b"\x11\x11"]
            .iter()
            .any(|known| stamp == Some(&known[..]))
}

/// Returns `true` for volumes of FreeSurfer: version 1, sizes and a known type, highest byte first.
fn is_mgh(head: &[u8]) -> bool {
    let number = |k: usize| {
        let bytes = head.get(4 * k..)?.first_chunk()?;
        Some(i32::from_be_bytes(*bytes))
    };
    let is_size = |k: usize| number(k).is_some_and(|n| (1..=1 << 16).contains(&n));
    number(0) == Some(1)
        && (1..5).all(is_size)
        && number(5).is_some_and(|kind| (0..=10).contains(&kind))
        && head.len() >= 284
}

fn is_afni(head: &[u8]) -> bool {
    let text = head[..head.len().min(200)].trim_ascii_start();
    text.starts_with(b"type") && contains(text, b"-attribute") && contains(text, b"name")
}

/// Returns `true` for files of Leica: a first block of XML in letters of two bytes.
fn is_lif(head: &[u8]) -> bool {
    has(head, 0, b"\x70\0\0\0") && has(head, 8, b"\x2a")
}

fn is_bmp(head: &[u8]) -> bool {
    // The length of the second header.
    let size = head.get(14..18);
    head.starts_with(b"BM")
        && [12u8, 40, 52, 56, 64, 108, 124]
            .iter()
            .any(|known| size == Some(&[*known, 0, 0, 0][..]))
}

fn is_pnm(head: &[u8]) -> bool {
    head.first() == Some(&b'P')
        && head.get(1).is_some_and(|kind| (b'1'..=b'6').contains(kind))
        && head.get(2).is_some_and(|next| next.is_ascii_whitespace())
        && head
            .get(3)
            .is_some_and(|next| next.is_ascii_digit() || *next == b'#')
}

/// Returns `true` for a header of seismic-zfp: sizes, and blocks of 4096 bytes.
fn is_sgz(head: &[u8]) -> bool {
    let (Some(blocks), Some(bits)) = (word(head, 0), word(head, 10)) else {
        return false;
    };
    let bits = match bits as i32 {
        bits @ 1..=32 => f64::from(bits),
        reciprocal @ -32..=-2 => -1.0 / f64::from(reciprocal),
        _ => return false,
    };
    let sizes = (11..14).map(|k| word(head, k).map_or(0.0, f64::from));
    let has_sizes = (1..4).all(|k| word(head, k).is_some_and(|n| (1..1 << 24).contains(&n)));
    (1..=64).contains(&blocks) && has_sizes && sizes.product::<f64>() * bits == 8.0 * 4096.0
}

/// Returns `true` for a header of Madagascar: sizes of axes and the file of samples.
fn is_rsf(head: &[u8]) -> bool {
    let text = &head[..head.len().min(4096)];
    contains(text, b"n1=") && contains(text, b"in=") && contains(text, b"esize=")
}

/// Returns the start and the end of a file, in which the kind of a container is looked for.
fn container_text(path: &Path) -> Vec<u8> {
    let read = || -> std::io::Result<Vec<u8>> {
        let mut file = File::open(path)?;
        let mut text = Vec::new();
        (&mut file).take(CONTAINER_BYTES).read_to_end(&mut text)?;
        let length = file.metadata()?.len();
        if length > CONTAINER_BYTES {
            file.seek(SeekFrom::Start(
                (length - CONTAINER_BYTES).max(CONTAINER_BYTES),
            ))?;
            file.take(CONTAINER_BYTES).read_to_end(&mut text)?;
        }
        Ok(text)
    };
    read().unwrap_or_default()
}

/// Returns the first of these formats that a file has.
fn find(formats: &'static [Format], path: &Path, head: &[u8]) -> Option<&'static Format> {
    let mut text = None;
    formats.iter().find(|(_, mark, _)| match mark {
        At(offset, bytes) => has(head, *offset, bytes),
        Within(magic, bytes) => {
            head.starts_with(magic)
                && contains(text.get_or_insert_with(|| container_text(path)), bytes)
        }
        Is(test) => test(head),
    })
}

fn error(path: &Path, name: &str, remedy: &str) -> Error {
    let problem = format!("is {name}, which is not read");
    Error::Io(cause(path.display(), problem, remedy))
}

/// Returns the error for a file that has the mark of a format that is not read; `None` for others.
/// `head` has its first bytes.
pub(super) fn refusal(path: &Path, head: &[u8]) -> Option<Error> {
    if let Some((name, _, remedy)) = find(FORMATS, path, head) {
        return Some(error(path, name, remedy));
    }
    match extension(path).as_str() {
        "mgz" | "mgh" => Some(error(path, "a FreeSurfer volume (MGH)", FREESURFER_REMEDY)),
        "brik" => {
            let remedy = "convert it to .nii.gz, with 3dAFNItoNIFTI";
            Some(error(path, "the samples of an AFNI volume", remedy))
        }
        _ => None,
    }
}

/// Returns the error for a file that no reader knows: by a plausible header of a format that is not
/// read, or by a header beside it. `head` has its first bytes.
pub(super) fn late_refusal(path: &Path, head: &[u8]) -> Option<Error> {
    if let Some((name, _, remedy)) = find(UNMARKED_FORMATS, path, head) {
        return Some(error(path, name, remedy));
    }
    let header = header_beside(path)?;
    let problem = "holds samples, which a header beside it describes";
    let remedy = format!("give {}", header.display());
    Some(Error::Io(cause(path.display(), problem, remedy)))
}

/// Returns the header beside a file of samples: `a.mhd`, `a.nhdr` or `a.hdr` beside `a.raw` or
/// `a.raw.gz`, if it names the file or is of NIfTI.
fn header_beside(path: &Path) -> Option<PathBuf> {
    let is_packed = matches!(extension(path).as_str(), "gz" | "bz2");
    let base = if is_packed {
        path.with_extension("")
    } else {
        path.to_path_buf()
    };
    let name = path.file_name()?.to_string_lossy().into_owned();
    let names_samples = |header: &PathBuf| {
        let mut text = Vec::new();
        let file = File::open(header);
        let read = file.and_then(|file| file.take(CONTAINER_BYTES).read_to_end(&mut text));
        read.is_ok() && contains(&text, name.as_bytes())
    };
    ["mhd", "nhdr", "hdr"]
        .map(|ending| base.with_extension(ending))
        .into_iter()
        .filter(|header| header != path)
        .find(names_samples)
}

/// Returns the error for a folder of files that are not read; `None` for others.
pub(super) fn folder_refusal(folder: &Path) -> Option<Error> {
    let entries = std::fs::read_dir(folder).ok()?;
    let mut paths: Vec<_> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let is_there = |name: &str| paths.iter().any(|path| path.ends_with(name));
    if is_there("acqp") && is_there("method") || is_there("2dseq") {
        let remedy = "convert the scan to .nii.gz, in Python with brkraw";
        return Some(error(folder, "a scan of Bruker", remedy));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::{ReadOptions, read_any};
    use super::*;

    fn message(path: &Path) -> String {
        let error = read_any(path, &ReadOptions::default()).unwrap_err();
        let text = error.to_string();
        assert_eq!(text.lines().count(), 1, "{text}");
        text
    }

    /// Returns `length` zeros with these bytes at these offsets.
    fn bytes(length: usize, parts: &[(usize, &[u8])]) -> Vec<u8> {
        let mut bytes = vec![0; length];
        for (offset, part) in parts {
            bytes[*offset..offset + part.len()].copy_from_slice(part);
        }
        bytes
    }

    /// Returns the first bytes of a file of each format that has no fixed ones.
    fn special_files() -> Vec<(Vec<u8>, &'static str)> {
        let words = |words: &[i32]| {
            words
                .iter()
                .flat_map(|w| w.to_le_bytes())
                .collect::<Vec<_>>()
        };
        let sgz = words(&[
            2, 32, 8, 8, 0, 1, 1, 4000, 1, 1, 4, 4, 4, 512, 4, 256, 1, 64, 10241,
        ]);
        let half_bit = words(&[2, 32, 8, 8, 0, 1, 1, 4000, 1, 1, -2, 64, 64, 16, 4, 256]);
        let mgh: Vec<u8> = [1, 4, 3, 2, 1, 3]
            .iter()
            .flat_map(|w: &i32| w.to_be_bytes())
            .collect();
        vec![
            (
                b"\x08\0\x05\0CS\x0a\0ISO_IR 100".to_vec(),
                "dcm2niix FOLDER",
            ),
            (b"dGB\x01\x02".to_vec(), "from OpendTect"),
            (b"GOCAD Voxet 1\n".to_vec(), "--raw"),
            (b"GOCAD TSurf 1\n".to_vec(), "not a mesh"),
            (
                bytes(400, &[(0, b"\x08\0\x05\0CS\x0a\0ISO_IR 100")]),
                "without a preamble",
            ),
            (bytes(1024, &[(208, b"MAP \x44\x44\0\0")]), "mrcfile"),
            (bytes(300, &[(0, &mgh)]), "mri_convert"),
            (
                b"\ntype = string-attribute\nname = TYPESTRING\n".to_vec(),
                "3dAFNItoNIFTI",
            ),
            (bytes(40, &[(0, b"\x70"), (8, b"\x2a")]), "bfconvert"),
            (bytes(60, &[(0, b"BM"), (14, b"\x28")]), "Pillow"),
            (b"RIFF\x10\0\0\0WEBPVP8 ".to_vec(), "Pillow"),
            (b"P5\n3 2\n255\n".to_vec(), "Pillow"),
            (b"ply\nformat ascii 1.0\n".to_vec(), "not a mesh"),
            (bytes(8192, &[(0, &sgz)]), "seismic_zfp"),
            (bytes(8192, &[(0, &half_bit)]), "seismic_zfp"),
            (b"\tn1=3 esize=4\n\tin=\"a.rsf@\"\n".to_vec(), "sfsegywrite"),
        ]
    }

    #[test]
    fn each_format_of_others_is_refused_with_the_tool_that_converts_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let mut files: Vec<(Vec<u8>, &str)> = special_files();
        for (_, mark, remedy) in FORMATS.iter().chain(UNMARKED_FORMATS) {
            match mark {
                At(offset, magic) => files.push((bytes(1200, &[(*offset, magic)]), remedy)),
                Within(magic, text) => {
                    files.push((bytes(1200, &[(0, magic), (900, text)]), remedy));
                    // The directory of an archive is at its end.
                    files.push((bytes(400_000, &[(0, magic), (399_000, text)]), remedy));
                }
                Is(_) => {}
            }
        }
        for (bytes, remedy) in &files {
            std::fs::write(&path, bytes).unwrap();
            let message = message(&path);
            assert!(message.contains(remedy), "{message} (expected: {remedy})");
            assert!(message.contains("which is not read; "), "{message}");
        }
        // Each format was recognised once at least.
        for (name, _, remedy) in FORMATS.iter().chain(UNMARKED_FORMATS) {
            let is_made = |(_, part): &(Vec<u8>, &str)| remedy.contains(part);
            assert!(files.iter().any(is_made), "{name}");
        }
    }

    #[test]
    fn samples_without_a_header_name_the_header_beside_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("a.raw"), [1; 24]).unwrap();
        assert!(message(&path("a.raw")).contains("not in a known image format"));
        std::fs::write(path("a.mhd"), "NDims = 3\nElementDataFile = other.raw\n").unwrap();
        assert!(message(&path("a.raw")).contains("not in a known image format"));
        for (header, samples, text) in [
            ("a.mhd", "a.raw", "NDims = 3\nElementDataFile = a.raw\n"),
            ("b.nhdr", "b.raw.gz", "NRRD0004\ndata file: b.raw.gz\n"),
        ] {
            std::fs::write(path(header), text).unwrap();
            std::fs::write(path(samples), [1; 24]).unwrap();
            let message = message(&path(samples));
            let remedy = format!("give {}", path(header).display());
            assert!(message.ends_with(&remedy), "{message}");
        }
    }

    #[test]
    fn folders_of_scanners_are_refused_with_a_tool() {
        let folder = tempfile::tempdir().unwrap();
        for file in ["acqp", "method"] {
            std::fs::write(folder.path().join(file), b"##TITLE").unwrap();
        }
        let message = message(folder.path());
        assert!(message.contains("brkraw"), "{message}");
    }
}
