//! Tests the resident session, with the lines of scripts.

use std::fs;
use std::path::PathBuf;

use atomesh::cli::run_line;
use atomesh::mesh::Mesh;
use atomesh::mesh::check::check;
use atomesh::mesh_file::AnyMesh;
use atomesh::progress::NoProgress;
use atomesh::store::StoredMesh;
use atomesh::workbench::{MeshPatch, Workbench};
use atomesh::{Result, SynthSpec, with_mesh};

/// Random numbers.
struct Random(u64);

impl Random {
    /// Returns a number from 0 to `bound`, without `bound`.
    fn below(&mut self, bound: f64) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64 * bound
    }
}

/// A folder with an image, and a session on it.
struct Bench {
    folder: tempfile::TempDir,
    dims: Vec<usize>,
    workbench: Workbench,
}

impl Bench {
    /// Makes an image of these dimensions, and its mesh.
    fn new(dims: &str, options: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let spec = SynthSpec {
            dims: dims.parse().unwrap(),
            ..SynthSpec::default()
        };
        let image = atomesh::synth("faults".parse().unwrap(), &spec).unwrap();
        image.write(&folder.path().join("image.npy")).unwrap();
        let mut bench = Self {
            folder,
            dims: image.dims(),
            workbench: Workbench::default(),
        };
        bench.run(&format!("mesh IMAGE -o MESH {options}")).unwrap();
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs a line, in which the names of files are words in capitals.
    fn run(&mut self, line: &str) -> Result<Option<MeshPatch>> {
        let [image, mesh] =
            ["image.npy", "mesh.vtu"].map(|name| self.path(name).display().to_string());
        let line = line.replace("IMAGE", &image).replace("MESH", &mesh);
        run_line(&mut self.workbench, &line, &mut NoProgress).map(|(_, patch)| patch)
    }

    fn mesh(&self) -> Option<&AnyMesh> {
        self.workbench.mesh(&self.path("mesh.vtu"))
    }

    /// Returns the bytes of the file of the mesh; `None` if there is no mesh.
    fn bytes(&self) -> Option<Vec<u8>> {
        let path = self.path("bytes.vtu");
        self.mesh()?.write(&path).unwrap();
        Some(fs::read(path).unwrap())
    }

    /// Returns a line of a random kind at a random place.
    fn random_line(&self, random: &mut Random) -> String {
        let nodes = with_mesh!(self.mesh().unwrap(), file => file.mesh.nodes().len());
        let coordinate = |&n: &usize| (random.below((n - 1) as f64) * 8.0).round() / 8.0;
        let place: Vec<String> = self
            .dims
            .iter()
            .map(coordinate)
            .map(|x| x.to_string())
            .collect();
        let place = place.join(",");
        let atom = random.below(nodes as f64) as usize;
        match random.below(7.0) as usize {
            0 => format!("edit MESH IMAGE -o MESH --add {place}"),
            1 => format!("edit MESH IMAGE -o MESH --add {place} --free"),
            2 | 3 => format!("edit MESH IMAGE -o MESH --move {atom}:{place} --free"),
            4 => format!("edit MESH IMAGE -o MESH --remove {atom}"),
            5 => format!("paint MESH -o MESH --seed {place}=3 --level 12"),
            _ => "paint MESH -o MESH --seed auto".into(),
        }
    }
}

/// Checks that a mesh is valid.
fn check_mesh(mesh: &AnyMesh) {
    with_mesh!(mesh.clone(), file => {
        let stored = StoredMesh::new(file, "the mesh").unwrap();
        let (extent, tolerance) = (stored.space.extent, stored.space.tolerance());
        let report = check(&stored.lattice, extent.map(|_| 0.0), extent, tolerance);
        assert!(report.passed(), "{:?}", report.problems);
    });
}

/// Brings a copy of the nodes and cells up to date by a patch, and compares it with the mesh.
fn check_patch(patch: &MeshPatch, copy: &mut (Vec<f64>, Vec<u32>), mesh: &AnyMesh) {
    let d = patch.dimensions;
    copy.0.resize(d * patch.node_count[1], 0.0);
    copy.1.resize((d + 1) * patch.cell_count[1], 0);
    for (&n, x) in patch.nodes.iter().zip(patch.positions.chunks(d)) {
        copy.0[d * n as usize..][..d].copy_from_slice(x);
    }
    for (&c, corners) in patch.cells.iter().zip(patch.corners.chunks(d + 1)) {
        copy.1[(d + 1) * c as usize..][..d + 1].copy_from_slice(corners);
    }
    let (nodes, cells) = match mesh {
        AnyMesh::Triangles(file) => (
            file.mesh.nodes.as_flattened(),
            file.mesh.triangles.as_flattened(),
        ),
        AnyMesh::Tetrahedra(file) => (
            file.mesh.nodes.as_flattened(),
            file.mesh.tets.as_flattened(),
        ),
        _ => panic!("not simplices"),
    };
    assert!(
        copy.0 == nodes && copy.1 == cells,
        "the patch misses a change"
    );
}

/// Runs random actions with undo and redo between them.
fn check_random_actions(dims: &str, options: &str, count: usize) {
    let mut bench = Bench::new(dims, options);
    let mut random = Random(7);
    // The bytes of the mesh after each action that is done.
    let mut history = vec![bench.bytes()];
    let mut copy = (Vec::new(), Vec::new());
    bench.workbench.undo().unwrap();
    let patch = bench.workbench.redo().unwrap();
    check_patch(&patch, &mut copy, bench.mesh().unwrap());
    let (mut position, mut refused) = (0, 0);
    for _ in 0..count {
        let kind = random.below(1.0);
        let patch = if kind < 0.2 && position > 0 {
            position -= 1;
            bench.workbench.undo()
        } else if kind < 0.35 && position + 1 < history.len() {
            position += 1;
            bench.workbench.redo()
        } else {
            let line = bench.random_line(&mut random);
            match bench.run(&line) {
                Ok(patch) => {
                    position += 1;
                    history.truncate(position);
                    history.push(bench.bytes());
                    patch
                }
                Err(_) => {
                    refused += 1;
                    None
                }
            }
        };
        let mesh = bench.mesh().unwrap();
        if let Some(patch) = patch {
            check_patch(&patch, &mut copy, mesh);
        }
        check_mesh(mesh);
        assert!(bench.bytes() == history[position], "a state differs");
        assert_eq!(bench.workbench.done().count(), position + 1);
        assert_eq!(
            bench.workbench.undone().count(),
            history.len() - 1 - position
        );
    }
    assert!(
        refused < count / 4,
        "{refused} of {count} actions were refused"
    );

    let script = bench.workbench.script();
    let mut rerun = Workbench::default();
    for line in script.lines() {
        run_line(&mut rerun, line, &mut NoProgress).unwrap();
    }
    let last = bench.bytes();
    std::mem::swap(&mut bench.workbench, &mut rerun);
    assert!(bench.bytes() == last, "the script makes another mesh");
    std::mem::swap(&mut bench.workbench, &mut rerun);

    while position > 0 {
        position -= 1;
        bench.workbench.undo().unwrap();
    }
    assert!(
        bench.bytes() == history[0],
        "undoing everything leaves another mesh"
    );
    bench.workbench.undo().unwrap();
    assert!(bench.mesh().is_none() && bench.workbench.undo().is_none());
    while bench.workbench.redo().is_some() {}
    assert!(
        bench.bytes() == *history.last().unwrap(),
        "redoing everything"
    );
}

#[test]
fn random_actions_in_a_volume_are_undone_redone_and_repeated_to_the_byte() {
    check_random_actions("36,32,28", "--distance 6 --feature ridges", 60);
}

#[test]
fn random_actions_in_the_plane_are_undone_redone_and_repeated_to_the_byte() {
    check_random_actions("90,70", "--distance 5 --feature ridges", 90);
}

#[test]
fn prepared_edits_make_the_same_mesh() {
    for options in ["--feature ridges", "--cells voronoi"] {
        let mut states = Vec::new();
        for is_prepared in [false, true] {
            let mut bench = Bench::new("60,50", &format!("--distance 6 {options}"));
            let start = bench.bytes();
            if is_prepared {
                let [image, mesh] = ["image.npy", "mesh.vtu"].map(|name| bench.path(name));
                let prepared = bench
                    .workbench
                    .prepare_edits(&mesh, &image, &mut NoProgress);
                prepared.unwrap();
                assert!(bench.bytes() == start && bench.workbench.done().count() == 1);
                assert!(
                    bench
                        .workbench
                        .prepare_edits(&image, &mesh, &mut NoProgress)
                        .is_err()
                );
            }
            bench.run("edit MESH IMAGE -o MESH --add 30.25,20").unwrap();
            states.push(bench.bytes());
        }
        assert!(states[0] == states[1], "{options}");
    }
}

#[test]
fn voronoi_cells_are_edited_and_undone() {
    let mut bench = Bench::new("60,50", "--distance 6 --cells voronoi");
    let start = bench.bytes();
    let patch = bench
        .run("edit MESH IMAGE -o MESH --add 30.25,20")
        .unwrap()
        .unwrap();
    assert!(
        patch.cells.is_empty() && patch.cell_count.iter().all(|&count| count > 50),
        "{patch:?}"
    );
    assert!(bench.bytes() != start);
    bench.workbench.undo().unwrap();
    assert!(bench.bytes() == start);
}

#[test]
fn lines_that_fail_change_nothing() {
    let mut bench = Bench::new("50,40", "--distance 6");
    let start = bench.bytes();
    bench.run("edit MESH IMAGE -o MESH --add 20.5,20").unwrap();
    bench.workbench.undo().unwrap();
    for (line, expected) in [
        ("edit MESH IMAGE -o MESH --add 900,20", "--add 900,20: "),
        ("edit MESH IMAGE -o MESH", "has nothing to do"),
        (
            "edit MESH IMAGE -o MESH.png --add 9,9",
            "mesh.vtu.png: does not end in .vtu",
        ),
        (
            "paint MESH -o MESH --seed 900,20",
            "--seed 900,20: lies outside the mesh",
        ),
        ("paint absent.vtu -o MESH --seed auto", "absent.vtu"),
        ("mesh IMAGE -o IMAGE", "does not end in .vtu"),
        ("quality absent.vtu", "absent.vtu"),
    ] {
        let error = bench.run(line).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert!(!error.contains('<'), "a name in memory: {error}");
        assert!(bench.bytes() == start, "{line}");
        assert_eq!(bench.workbench.undone().count(), 1, "{line}");
    }
    // A verb that makes no mesh works on the mesh in memory, and leaves it.
    assert!(bench.run("quality MESH").unwrap().is_none());
    assert!(bench.bytes() == start);
    assert_eq!(bench.workbench.script().lines().count(), 1);
}

#[test]
fn a_mesh_of_a_file_is_not_replaced() {
    let mut bench = Bench::new("50,40", "--distance 6");
    bench.workbench.write_meshes().unwrap();
    bench.workbench = Workbench::default();
    let error = bench
        .run("edit MESH IMAGE -o MESH --add 20.5,20")
        .unwrap_err();
    assert!(
        error.to_string().contains("would overwrite an input"),
        "{error}"
    );
}
