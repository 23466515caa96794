//! Tests images that `slice` draws: colours, cuts and overlays are where they should be, and
//! impossible options are refused with the possible ones.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use crate::common::{expect_refusal, planar_fault, run, write_npy, write_npy_2d};

/// The pixels of a picture, row by row, without the margins around the drawing.
struct Pixels {
    width: usize,
    colors: Vec<[u8; 3]>,
}

impl Pixels {
    fn read(path: &Path) -> Self {
        let decoder = png::Decoder::new(BufReader::new(File::open(path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        let (width, height) = (info.width as usize, info.height as usize);
        let rows = bytes.as_chunks::<3>().0.chunks(width);
        let inside = rows.skip(60).take(height - 100);
        let colors: Vec<[u8; 3]> = inside.flat_map(|row| row[..width - 130].to_vec()).collect();
        Self {
            width: width - 130,
            colors,
        }
    }

    /// Returns the number of pixels whose colour matches, and their mean column and row.
    fn matching(&self, matches: impl Fn(&[u8; 3]) -> bool) -> (usize, [usize; 2]) {
        let colors = self.colors.iter().enumerate();
        let indices: Vec<usize> = (colors.filter(|(_, c)| matches(c)))
            .map(|(i, _)| i)
            .collect();
        let mean = |coordinate: fn(usize, usize) -> usize| {
            let sum: usize = indices.iter().map(|&i| coordinate(i, self.width)).sum();
            sum / indices.len().max(1)
        };
        (indices.len(), [mean(|i, w| i % w), mean(|i, w| i / w)])
    }
}

fn red([r, _, b]: &[u8; 3]) -> bool {
    *r > 80 && r - (*r).min(*b) > 60
}

fn blue([r, _, b]: &[u8; 3]) -> bool {
    *b > 80 && b - (*b).min(*r) > 60
}

fn green([r, g, b]: &[u8; 3]) -> bool {
    *g > 60 && u16::from(*g) > 2 * u16::from(*r.max(b))
}

fn black(color: &[u8; 3]) -> bool {
    color.iter().all(|c| *c < 28)
}

/// Writes a planar fault nearly across x, its mesh, and the flow through it from small x to large
/// x.
fn write_flow_through_fault(dir: &Path) {
    write_npy(
        &dir.join("sheet.npy"),
        [40, 36, 32],
        planar_fault([40, 36, 32]),
    );
    run(dir, "mesh sheet.npy -o mesh.vtu --distance 6 --quiet");
    run(
        dir,
        "flow mesh.vtu --pressure xmin=2e5 --pressure xmax=1e5 --faults 0.01 -o flow.vtu --streamlines lines.vtp --lines 30 --quiet",
    );
}

#[test]
fn flow_is_drawn_with_its_faults_and_streamlines() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_flow_through_fault(dir);
    let draw = |files: &str, options: &str| {
        run(
            dir,
            &format!("slice {files} -o a.png --view 3d --quiet {options}"),
        );
        Pixels::read(&dir.join("a.png"))
    };
    let painted = draw("flow.vtu", "--color pressure --cut z");
    let ((high, [left, _]), (low, [right, _])) = (painted.matching(red), painted.matching(blue));
    assert!(high > 5_000 && low > 5_000, "{high} {low}");
    assert!(left < right, "{left} {right}");
    let (dark, _) = painted.matching(black);
    assert!(dark > 500, "{dark}");
    assert_eq!(painted.matching(green).0, 0);
    let (lines, _) = draw("flow.vtu lines.vtp", "--color pressure --cut z").matching(green);
    assert!(lines > 300, "{lines}");
    // Streamlines are drawn with the image and by themselves.
    assert!(draw("sheet.npy lines.vtp", "").matching(green).0 > 300);
    let alone = draw("lines.vtp", "");
    assert!(alone.matching(green).0 > 300 && alone.matching(red).0 == 0);
}

#[test]
fn surfaces_are_drawn_alone_and_with_the_given_direction_up() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_npy(
        &dir.join("sheet.npy"),
        [40, 36, 32],
        planar_fault([40, 36, 32]),
    );
    run(dir, "mesh sheet.npy -o mesh.vtu --distance 6 --quiet");
    run(dir, "surface mesh.vtu -o sheet.vtp --quiet");
    let mut sizes = Vec::new();
    for up in ["z", "x"] {
        run(
            dir,
            &format!("slice sheet.vtp -o {up}.png --view 3d --up {up} --quiet"),
        );
        let pixels = Pixels::read(&dir.join(format!("{up}.png")));
        let (count, _) = pixels.matching(red);
        assert!(count > 10_000, "{count}");
        sizes.push((pixels.width, pixels.colors.len()));
    }
    assert_ne!(sizes[0], sizes[1]);
    // Sections show the trace of the surface.
    run(dir, "slice sheet.npy sheet.vtp -o s.png --quiet");
    assert!(Pixels::read(&dir.join("s.png")).matching(red).0 > 300);
}

#[test]
fn impossible_drawings_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_flow_through_fault(dir);
    write_npy_2d(&dir.join("line.npy"), [40, 36], |[x, _]| x as f32);
    run(dir, "surface mesh.vtu -o sheet.vtp --quiet");
    std::fs::write(dir.join("torn.vtp"), "<VTKFile type=\"PolyData\"").unwrap();
    for (line, expected) in [
        ("slice flow.vtu", "give the image, or --view 3d"),
        ("slice sheet.npy mesh.vtu lines.vtp", "give --view 3d"),
        ("slice sheet.npy mesh.vtu --cut x", "give --view 3d"),
        (
            "slice flow.vtu --view 3d --color presure",
            "node, pressure, region",
        ),
        (
            "slice sheet.npy --view 3d --color pressure",
            "give the mesh",
        ),
        ("slice sheet.vtp --view 3d --cut x", "omit it"),
        ("slice sheet.vtp --view 3d --at 1,2,3", "omit it"),
        ("slice sheet.vtp --view 3d --up w", "give x, y, z, -x"),
        ("slice line.npy --up z", "give x, y, or -x, -y"),
        ("slice sheet.npy --at 1,2", "has 2 values, not 3"),
        ("slice sheet.vtp --view 3d --spacing 1,1,1", "omit it"),
        ("slice torn.vtp --view 3d", "torn.vtp"),
        ("slice absent.vtp --view 3d", "absent.vtp"),
        ("slice line.npy sheet.vtp", "the image is 2-D"),
        ("slice line.npy mesh.vtu", "the image is 2-D"),
        ("slice sheet.npy mesh.vtu flow.vtu", "one file too many"),
    ] {
        let line = format!("{line} -o p.png");
        let error = expect_refusal(dir, &line.split(' ').collect::<Vec<_>>());
        assert!(error.contains(expected), "{line}: {error}");
    }
}
