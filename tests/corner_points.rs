//! Tests `atomesh export --to grdecl`: faults of layered models in corner-point grids. Nothing
//! flows through a closed fault, by any connection that a simulator makes.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{numbers, run, run_simulator, run_validator, write_npy};
use serde_json::Value;

/// Layers that planar faults displace. Each plane crosses the whole box.
struct Layered {
    dims: [usize; 3],
    /// Each plane has a point, a unit normal, and the throw beyond the plane.
    planes: Vec<([f64; 3], [f64; 3], f64)>,
    /// Depths of the boundaries between layers.
    boundaries: Vec<f64>,
    /// Amplitude and wavelength of the undulation of layers, in samples.
    wave: [f64; 2],
}

impl Layered {
    fn signed_distance(&self, plane: usize, x: [f64; 3]) -> f64 {
        let (point, normal, _) = self.planes[plane];
        (0..3).map(|k| (x[k] - point[k]) * normal[k]).sum()
    }

    /// Writes `fault.npy` and `layers.npy`.
    fn write(&self, folder: &Path) {
        let position = |index: [usize; 3]| index.map(|i| i as f64);
        write_npy(&folder.join("fault.npy"), self.dims, |index| {
            let brightness =
                |p: usize| (-(self.signed_distance(p, position(index)) / 1.2).powi(2)).exp();
            (0..self.planes.len()).map(brightness).fold(0.0, f64::max) as f32
        });
        write_npy(&folder.join("layers.npy"), self.dims, |index| {
            let [x, y, z] = position(index);
            let throw: f64 = (0..self.planes.len())
                .filter(|&p| self.signed_distance(p, [x, y, z]) > 0.0)
                .map(|p| self.planes[p].2)
                .sum();
            let depth = z - throw + self.wave[0] * (x / self.wave[1] + y / 40.0).sin();
            self.boundaries
                .iter()
                .filter(|boundary| depth > **boundary)
                .count() as f32
        });
        let rows = |value: fn(i32) -> f64| -> String {
            (0..8).map(|r| format!("{r},{}\n", value(r))).collect()
        };
        std::fs::write(folder.join("phi.csv"), rows(|r| 0.1 + 0.02 * f64::from(r))).unwrap();
        std::fs::write(folder.join("k.csv"), rows(|r| 10f64.powi(r % 4))).unwrap();
    }

    /// Meshes the model, exports a deck with the fault options, and returns the number of cells of
    /// each compartment of the model.
    fn export(&self, folder: &Path, options: &str) -> Vec<u64> {
        self.write(folder);
        run(
            folder,
            "mesh fault.npy --feature ridges --cells voronoi --distance 5 --quiet -o cells.vtu",
        );
        let rock =
            "--region layers.npy --porosity phi.csv --permeability k.csv --permeability-unit mD";
        let stdout = run(
            folder,
            &format!(
                "export cells.vtu --to grdecl -o A.GRDECL --down z --depth-at-top 2000 --quiet --json {rock} {options}"
            ),
        );
        let report: Value = serde_json::from_str(&stdout).unwrap();
        let compartments = report["checks"]["compartments"].as_array().unwrap().iter();
        compartments.map(|part| part[1].as_u64().unwrap()).collect()
    }
}

/// Returns a random model that depends on the seed only.
fn random(seed: u64) -> Layered {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(1);
    let mut uniform = |low: f64, high: f64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        low + (high - low) * (state >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..8).for_each(|_| _ = uniform(0.0, 1.0));
    let dims = [
        uniform(44.0, 60.0) as usize,
        uniform(20.0, 32.0) as usize,
        uniform(28.0, 40.0) as usize,
    ];
    let [nx, ny, nz] = dims.map(|n| n as f64);
    let count = 1 + seed as usize % 2;
    let strike = uniform(-20.0, 20.0).to_radians();
    let dip = uniform(if count == 1 { 42.0 } else { 62.0 }, 90.0).to_radians();
    let lean = if uniform(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
    let normal = [
        strike.cos() * dip.sin(),
        strike.sin() * dip.sin(),
        lean * dip.cos(),
    ];
    let planes = (0..count).map(|p| {
        let fraction = if count == 1 { 0.5 } else { [0.33, 0.67][p] };
        let point = [nx * fraction + uniform(-2.0, 2.0), ny / 2.0, nz / 2.0];
        let sign = if uniform(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
        (point, normal, sign * uniform(3.0, 9.0))
    });
    let planes = planes.collect();
    let layers = uniform(3.0, 6.0) as usize;
    let boundary = |k: usize| nz * k as f64 / layers as f64 + uniform(-2.0, 2.0);
    let boundaries = (1..layers).map(boundary).collect();
    Layered {
        dims,
        planes,
        boundaries,
        wave: [uniform(1.0, 3.0), uniform(15.0, 30.0)],
    }
}

/// A corner-point grid, as read from a file.
struct Grid {
    dims: [usize; 3],
    zcorn: Vec<f64>,
    active: Vec<f64>,
    /// Number of multipliers on each face of a cell (towards -x, +x, -y, +y, -z, +z).
    face_multipliers: BTreeMap<([usize; 3], usize), usize>,
    connection_multipliers: BTreeMap<[[usize; 3]; 2], usize>,
}

impl Grid {
    fn read(folder: &Path) -> Self {
        let text = std::fs::read_to_string(folder.join("A.GRDECL")).unwrap();
        let block = |name: &str| {
            let start = text.find(&format!("\n{name}\n")).unwrap() + name.len() + 2;
            let end = start + text[start..].find("\n/").unwrap_or(text[start..].len());
            &text[start..end]
        };
        let values = |name: &str| -> Vec<f64> {
            let words = block(name).split_whitespace();
            words.map(|word| word.parse().unwrap()).collect()
        };
        let dims = text.split("SPECGRID\n").nth(1).unwrap().split_whitespace();
        let dims: Vec<usize> = dims.take(3).map(|word| word.parse().unwrap()).collect();
        let dims = [dims[0], dims[1], dims[2]];
        let mut face_multipliers = BTreeMap::new();
        for line in block("FAULTS").lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let n: Vec<usize> = words[1..7]
                .iter()
                .map(|word| word.parse().unwrap())
                .collect();
            let side = words[7].trim_matches('\'');
            let face = 2 * ["X", "Y", "Z"]
                .iter()
                .position(|s| side.starts_with(s))
                .unwrap()
                + usize::from(!side.ends_with('-'));
            // OPM Flow: "When the face is in Z direction we must have K1 == K2".
            assert!(face < 4 || n[4] == n[5], "{line}");
            for k in n[4]..=n[5] {
                *face_multipliers
                    .entry(([n[0] - 1, n[2] - 1, k - 1], face))
                    .or_default() += 1;
            }
        }
        let mut connection_multipliers = BTreeMap::new();
        if let Ok(text) = std::fs::read_to_string(folder.join("A-edit.GRDECL")) {
            for line in text.lines().filter(|line| line.starts_with(' ')) {
                let words: Vec<&str> = line.split_whitespace().collect();
                let cell_at =
                    |columns: [usize; 3]| columns.map(|p| words[p].parse::<usize>().unwrap() - 1);
                let pair = match words[0] {
                    "'TRANX'" | "'TRANY'" => {
                        let lower = cell_at([2, 4, 6]);
                        let mut upper = lower;
                        upper[usize::from(words[0] == "'TRANY'")] += 1;
                        [lower, upper]
                    }
                    _ => [cell_at([0, 1, 2]), cell_at([3, 4, 5])],
                };
                *connection_multipliers.entry(pair).or_default() += 1;
            }
        }
        Self {
            dims,
            zcorn: values("ZCORN"),
            active: values("ACTNUM"),
            face_multipliers,
            connection_multipliers,
        }
    }

    /// Returns the depths of the top and of the bottom of a cell at its corner (a, b).
    fn depths(&self, [i, j, k]: [usize; 3], [a, b]: [usize; 2]) -> [f64; 2] {
        let [n, m, _] = self.dims;
        [0, 1].map(|bottom| {
            let row = (2 * k + bottom) * 2 * m + 2 * j + b;
            self.zcorn[row * 2 * n + 2 * i + a]
        })
    }

    /// Returns all pairs of active cells whose faces overlap, with the axis across the face.
    fn pairs(&self) -> Vec<([[usize; 3]; 2], usize)> {
        let [n, m, layers] = self.dims;
        let active = |[i, j, k]: [usize; 3]| self.active[i + n * (j + m * k)] > 0.0;
        let mut pairs = Vec::new();
        for index in 0..n * m * layers {
            let cell = [index % n, index / n % m, index / (n * m)];
            for axis in 0..3 {
                let mut next = cell;
                next[axis] += 1;
                if next[axis] == self.dims[axis] || !active(cell) {
                    continue;
                }
                let layers = if axis == 2 {
                    next[2]..next[2] + 1
                } else {
                    0..layers
                };
                for k in layers {
                    next[2] = k;
                    // Sample along the face, densely enough for edges that cross.
                    let overlap = (0..=32).any(|step| {
                        let fraction = f64::from(step) / 32.0;
                        let side = |cell: [usize; 3], end_along: usize| {
                            let ends = [0, 1].map(|end| {
                                let corner = if axis == 0 {
                                    [end_along, end]
                                } else {
                                    [end, end_along]
                                };
                                self.depths(cell, corner)
                            });
                            [0, 1].map(|z| ends[0][z] + fraction * (ends[1][z] - ends[0][z]))
                        };
                        let ([top, bottom], [next_top, next_bottom]) =
                            (side(cell, 1), side(next, 0));
                        bottom.min(next_bottom) - top.max(next_top) > 1e-6
                    });
                    if active(next) && (axis == 2 || overlap) {
                        pairs.push(([cell, next], axis));
                    }
                }
            }
        }
        pairs
    }

    /// Returns the cell counts of the compartments if all multiplied connections are closed, the
    /// largest first. Asserts that no connection is multiplied twice.
    fn compartments(&self) -> Vec<u64> {
        let [n, m, layers] = self.dims;
        let index = |[i, j, k]: [usize; 3]| i + n * (j + m * k);
        let mut parent: Vec<usize> = (0..n * m * layers).collect();
        fn find(parent: &[usize], mut index: usize) -> usize {
            while parent[index] != index {
                index = parent[index];
            }
            index
        }
        for (pair, axis) in self.pairs() {
            let multipliers_of = |cell: [usize; 3], face: usize| {
                self.face_multipliers
                    .get(&(cell, face))
                    .copied()
                    .unwrap_or(0)
            };
            let times = multipliers_of(pair[0], 2 * axis + 1)
                + multipliers_of(pair[1], 2 * axis)
                + self.connection_multipliers.get(&pair).copied().unwrap_or(0);
            assert!(times <= 1, "{pair:?} is multiplied {times} times");
            if times == 0 {
                let [a, b] = pair.map(|cell| find(&parent, index(cell)));
                parent[a.max(b)] = a.min(b);
            }
        }
        let mut sizes = vec![0u64; parent.len()];
        for cell in (0..parent.len()).filter(|&cell| self.active[cell] > 0.0) {
            sizes[find(&parent, cell)] += 1;
        }
        sizes.retain(|size| *size > 0);
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        sizes
    }
}

/// Counts the compartments that hold more than a hundredth of all cells. The others are cells that
/// a rough fault cuts off.
fn count_large(sizes: &[f64]) -> usize {
    let total: f64 = sizes.iter().sum();
    sizes.iter().filter(|size| **size > 0.01 * total).count()
}

#[test]
fn no_connection_of_split_pillars_crosses_a_closed_fault() {
    for seed in [6, 9] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let model = random(seed);
        let expected = model.export(folder, "--faults closed");
        let expected: Vec<f64> = expected.iter().map(|n| *n as f64).collect();
        assert_eq!(
            count_large(&expected),
            1 + model.planes.len(),
            "{seed}: {expected:?}"
        );
        let sizes = Grid::read(folder).compartments();
        assert_eq!(sizes.len(), 1 + model.planes.len(), "{seed}: {sizes:?}");
    }
}

#[test]
fn faults_through_columns_have_a_record_for_each_layer() {
    // The fault dips too gently for split pillars.
    let flat = Layered {
        dims: [50, 20, 30],
        planes: vec![([25.0, 10.0, 15.0], [0.5, 0.0, 0.75f64.sqrt()], 6.0)],
        boundaries: vec![10.0, 20.0],
        wave: [1.0, 20.0],
    };
    let folder = tempfile::tempdir().unwrap();
    flat.export(folder.path(), "--faults 0.1");
    let grid = Grid::read(folder.path());
    let downward = grid
        .face_multipliers
        .keys()
        .filter(|(_, face)| *face == 5)
        .count();
    assert!(downward > 10, "{downward}");
    let compartments: Vec<f64> = grid.compartments().iter().map(|n| *n as f64).collect();
    assert_eq!(count_large(&compartments), 2, "{compartments:?}");
}

#[test]
#[ignore = "needs OPM Flow, resfo and SciPy: make test-all"]
fn opm_flow_has_the_compartments_of_the_model() {
    for seed in 0..20 {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let model = random(seed);
        let expected = model.export(folder, "--faults closed");
        let expected: Vec<f64> = expected.iter().map(|n| *n as f64).collect();
        let mut flow = Command::new("flow");
        flow.current_dir(folder)
            .args(["A.DATA", "--output-dir=out", "--threads-per-process=1"]);
        run_simulator(&mut flow);
        let out = folder.join("out");
        let arguments = [out.as_os_str(), OsStr::new("A")];
        let result = run_validator("resfo and SciPy", "compartments.py", &arguments);
        let porv = numbers(&result["porv"]);
        println!("{seed}: model {expected:?}, OPM Flow {porv:?}");
        assert_eq!(
            count_large(&expected),
            1 + model.planes.len(),
            "{seed}: {expected:?}"
        );
        assert_eq!(
            count_large(&porv),
            count_large(&expected),
            "{seed}: {porv:?}"
        );
        // OPM Flow makes the connections that this test derives from the file.
        let cells: Vec<f64> = numbers(&result["cells"]);
        let compartments = Grid::read(folder).compartments();
        assert_eq!(cells.len(), compartments.len());
        assert_eq!(
            cells.iter().sum::<f64>(),
            compartments.iter().sum::<u64>() as f64
        );
    }
}
