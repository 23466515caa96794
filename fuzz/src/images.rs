//! Checks any bytes as an image of any format.

use std::fs;
use std::path::Path;

use atomesh::image::formats::{self, AnyImage, ReadOptions};

const ENDINGS: [&str; 14] = [
    "npy", "vti", "nrrd", "mha", "nii", "tif", "png", "sgy", "inr", "nii.gz", "vtk", "mhd", "nhdr",
    "dcm",
];

/// Reads the bytes as an image file, whose format the first byte selects.
///
/// The file must be refused in one line, or the image must survive a round trip through a file.
///
/// # Panics
/// Panics if this does not hold.
pub fn check_image(folder: &Path, bytes: &[u8]) {
    let Some((&first, bytes)) = bytes.split_first() else {
        return;
    };
    let path = folder.join(format!(
        "image.{}",
        ENDINGS[usize::from(first) % ENDINGS.len()]
    ));
    fs::write(&path, bytes).expect("a file");
    let read = formats::read_any(&path, &ReadOptions::default());
    fs::remove_file(&path).expect("the file");
    let image = match read {
        Err(error) => {
            let line = error.to_string();
            assert!(line.contains("; ") && !line.contains('\n'), "{line}");
            return;
        }
        Ok(AnyImage::Plane(loaded)) => loaded.image.to_3d(),
        Ok(AnyImage::Space(loaded)) => loaded.image,
    };
    assert_eq!(
        image.as_slice().len(),
        image.dims().iter().product::<usize>()
    );
    if image.as_slice().len() > 1 << 16 {
        return;
    }
    let copy = folder.join("copy.npy");
    if formats::write(&copy, &image).is_ok() {
        let reread = formats::read_any(&copy, &ReadOptions::default());
        fs::remove_file(&copy).expect("the file");
        let reread = match reread.expect("what was written is read") {
            AnyImage::Plane(loaded) => loaded.image.to_3d(),
            AnyImage::Space(loaded) => loaded.image,
        };
        let bits = |samples: &[f32]| samples.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(reread.as_slice()), bits(image.as_slice()));
    }
}
