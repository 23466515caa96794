//! `atomesh export --to grdecl`: faults of layered models in corner-point grids. Nothing passes a closed fault,
//! by whatever connection that a simulator makes.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use crate::common::{run_validator, write_npy, numbers, run, run_simulator};
use serde_json::Value;

/// Layers, thrown by planes that cross the whole box.
struct Layered {
    dims: [usize; 3],
    /// Of each plane a point, its unit normal, and the throw beyond it.
    planes: Vec<([f64; 3], [f64; 3], f64)>,
    /// Depths at which layers end.
    cuts: Vec<f64>,
    /// How much the layers undulate, and over what distance.
    wave: [f64; 2],
}

impl Layered {
    fn off(&self, plane: usize, x: [f64; 3]) -> f64 {
        let (point, normal, _) = self.planes[plane];
        (0..3).map(|k| (x[k] - point[k]) * normal[k]).sum()
    }

    /// Writes `fault.npy` and `layers.npy`.
    fn write(&self, folder: &Path) {
        let at = |index: [usize; 3]| index.map(|i| i as f64);
        write_npy(&folder.join("fault.npy"), self.dims, |index| {
            let near = |p: usize| (-(self.off(p, at(index)) / 1.2).powi(2)).exp();
            (0..self.planes.len()).map(near).fold(0.0, f64::max) as f32
        });
        write_npy(&folder.join("layers.npy"), self.dims, |index| {
            let [x, y, z] = at(index);
            let thrown: f64 = (0..self.planes.len())
                .filter(|&p| self.off(p, [x, y, z]) > 0.0)
                .map(|p| self.planes[p].2)
                .sum();
            let depth = z - thrown + self.wave[0] * (x / self.wave[1] + y / 40.0).sin();
            self.cuts.iter().filter(|cut| depth > **cut).count() as f32
        });
        let rows = |value: fn(i32) -> f64| -> String {
            (0..8).map(|r| format!("{r},{}\n", value(r))).collect()
        };
        std::fs::write(folder.join("phi.csv"), rows(|r| 0.1 + 0.02 * f64::from(r))).unwrap();
        std::fs::write(folder.join("k.csv"), rows(|r| 10f64.powi(r % 4))).unwrap();
    }

    /// Meshes it, exports a deck with closed faults, and gives the parts of our own graph, by number of
    /// cells.
    fn export(&self, folder: &Path, options: &str) -> Vec<u64> {
        self.write(folder);
        run(
            folder,
            "mesh fault.npy --feature ridges --cells voronoi --distance 5 --quiet -o cells.vtu",
        );
        let rock =
            "--region layers.npy --porosity phi.csv --permeability k.csv --permeability-unit mD";
        let said = run(
            folder,
            &format!(
                "export cells.vtu --to grdecl -o A.GRDECL --down z --depth-at-top 2000 --quiet --json {rock} {options}"
            ),
        );
        let said: Value = serde_json::from_str(&said).unwrap();
        let parts = said["checks"]["compartments"].as_array().unwrap().iter();
        parts.map(|part| part[1].as_u64().unwrap()).collect()
    }
}

/// A random model, the same for the same number.
fn random(seed: u64) -> Layered {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(1);
    let mut within = |low: f64, high: f64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        low + (high - low) * (state >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..8).for_each(|_| _ = within(0.0, 1.0));
    let dims = [
        within(44.0, 60.0) as usize,
        within(20.0, 32.0) as usize,
        within(28.0, 40.0) as usize,
    ];
    let [nx, ny, nz] = dims.map(|n| n as f64);
    let count = 1 + seed as usize % 2;
    let strike = within(-20.0, 20.0).to_radians();
    let dip = within(if count == 1 { 42.0 } else { 62.0 }, 90.0).to_radians();
    let lean = if within(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
    let normal = [
        strike.cos() * dip.sin(),
        strike.sin() * dip.sin(),
        lean * dip.cos(),
    ];
    let planes = (0..count).map(|p| {
        let share = if count == 1 { 0.5 } else { [0.33, 0.67][p] };
        let point = [nx * share + within(-2.0, 2.0), ny / 2.0, nz / 2.0];
        let sign = if within(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
        (point, normal, sign * within(3.0, 9.0))
    });
    let planes = planes.collect();
    let layers = within(3.0, 6.0) as usize;
    let cut = |k: usize| nz * k as f64 / layers as f64 + within(-2.0, 2.0);
    let cuts = (1..layers).map(cut).collect();
    Layered {
        dims,
        planes,
        cuts,
        wave: [within(1.0, 3.0), within(15.0, 30.0)],
    }
}

/// A corner-point grid as a file has it.
struct Grid {
    dims: [usize; 3],
    zcorn: Vec<f64>,
    active: Vec<f64>,
    /// How often each face of a cell (towards -x, +x, -y, +y, -z, +z) is multiplied.
    multiplied: BTreeMap<([usize; 3], usize), usize>,
    edited: BTreeMap<[[usize; 3]; 2], usize>,
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
        let mut multiplied = BTreeMap::new();
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
                *multiplied
                    .entry(([n[0] - 1, n[2] - 1, k - 1], face))
                    .or_default() += 1;
            }
        }
        let mut edited = BTreeMap::new();
        if let Ok(text) = std::fs::read_to_string(folder.join("A-edit.GRDECL")) {
            for line in text.lines().filter(|line| line.starts_with(' ')) {
                let words: Vec<&str> = line.split_whitespace().collect();
                let at =
                    |places: [usize; 3]| places.map(|p| words[p].parse::<usize>().unwrap() - 1);
                let pair = match words[0] {
                    "'TRANX'" | "'TRANY'" => {
                        let lower = at([2, 4, 6]);
                        let mut upper = lower;
                        upper[usize::from(words[0] == "'TRANY'")] += 1;
                        [lower, upper]
                    }
                    _ => [at([0, 1, 2]), at([3, 4, 5])],
                };
                *edited.entry(pair).or_default() += 1;
            }
        }
        Self {
            dims,
            zcorn: values("ZCORN"),
            active: values("ACTNUM"),
            multiplied,
            edited,
        }
    }

    /// Depths of the top and the bottom of a cell at its corner (i, j).
    fn depths(&self, [i, j, k]: [usize; 3], [a, b]: [usize; 2]) -> [f64; 2] {
        let [n, m, _] = self.dims;
        [0, 1].map(|bottom| {
            let row = (2 * k + bottom) * 2 * m + 2 * j + b;
            self.zcorn[row * 2 * n + 2 * i + a]
        })
    }

    /// All pairs of active cells that share some of a face, with the axis across it.
    fn pairs(&self) -> Vec<([[usize; 3]; 2], usize)> {
        let [n, m, layers] = self.dims;
        let active = |[i, j, k]: [usize; 3]| self.active[i + n * (j + m * k)] > 0.0;
        let mut pairs = Vec::new();
        for at in 0..n * m * layers {
            let cell = [at % n, at / n % m, at / (n * m)];
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
                    // Along the face, more often than where its edges could cross.
                    let overlap = (0..=32).any(|step| {
                        let share = f64::from(step) / 32.0;
                        let side = |cell: [usize; 3], along: usize| {
                            let ends = [0, 1].map(|end| {
                                let corner = if axis == 0 {
                                    [along, end]
                                } else {
                                    [end, along]
                                };
                                self.depths(cell, corner)
                            });
                            [0, 1].map(|z| ends[0][z] + share * (ends[1][z] - ends[0][z]))
                        };
                        let ([top, bottom], [other, below]) = (side(cell, 1), side(next, 0));
                        bottom.min(below) - top.max(other) > 1e-6
                    });
                    if active(next) && (axis == 2 || overlap) {
                        pairs.push(([cell, next], axis));
                    }
                }
            }
        }
        pairs
    }

    /// The sizes of the parts that nothing joins if all that is multiplied is closed, the largest first. No
    /// connection is multiplied twice.
    fn parts(&self) -> Vec<u64> {
        let [n, m, layers] = self.dims;
        let number = |[i, j, k]: [usize; 3]| i + n * (j + m * k);
        let mut name: Vec<usize> = (0..n * m * layers).collect();
        fn find(name: &[usize], mut at: usize) -> usize {
            while name[at] != at {
                at = name[at];
            }
            at
        }
        for (pair, axis) in self.pairs() {
            let of_face = |cell: [usize; 3], face: usize| {
                self.multiplied.get(&(cell, face)).copied().unwrap_or(0)
            };
            let times = of_face(pair[0], 2 * axis + 1)
                + of_face(pair[1], 2 * axis)
                + self.edited.get(&pair).copied().unwrap_or(0);
            assert!(times <= 1, "{pair:?} is multiplied {times} times");
            if times == 0 {
                let [a, b] = pair.map(|cell| find(&name, number(cell)));
                name[a.max(b)] = a.min(b);
            }
        }
        let mut sizes = vec![0u64; name.len()];
        for at in (0..name.len()).filter(|&at| self.active[at] > 0.0) {
            sizes[find(&name, at)] += 1;
        }
        sizes.retain(|size| *size > 0);
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        sizes
    }
}

/// The parts that are more than a cell that a rough fault cuts off: more than a hundredth of all.
fn large(sizes: &[f64]) -> usize {
    let all: f64 = sizes.iter().sum();
    sizes.iter().filter(|size| **size > 0.01 * all).count()
}

#[test]
fn no_connection_of_split_pillars_leaks_through_a_closed_fault() {
    for seed in [6, 9] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let model = random(seed);
        let own = model.export(folder, "--faults closed");
        let own: Vec<f64> = own.iter().map(|n| *n as f64).collect();
        assert_eq!(large(&own), 1 + model.planes.len(), "{seed}: {own:?}");
        let found = Grid::read(folder).parts();
        assert_eq!(found.len(), 1 + model.planes.len(), "{seed}: {found:?}");
    }
}

#[test]
fn faults_that_run_through_columns_have_a_record_for_each_layer() {
    // Too flat for pillars.
    let flat = Layered {
        dims: [50, 20, 30],
        planes: vec![([25.0, 10.0, 15.0], [0.5, 0.0, 0.75f64.sqrt()], 6.0)],
        cuts: vec![10.0, 20.0],
        wave: [1.0, 20.0],
    };
    let folder = tempfile::tempdir().unwrap();
    flat.export(folder.path(), "--faults 0.1");
    let grid = Grid::read(folder.path());
    let down = grid
        .multiplied
        .keys()
        .filter(|(_, face)| *face == 5)
        .count();
    assert!(down > 10, "{down}");
    let parts: Vec<f64> = grid.parts().iter().map(|n| *n as f64).collect();
    assert_eq!(large(&parts), 2, "{parts:?}");
}

#[test]
#[ignore = "needs OPM Flow, resfo and SciPy: make test-all"]
fn opm_flow_has_the_compartments_of_our_own_graph() {
    for seed in 0..20 {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let model = random(seed);
        let own = model.export(folder, "--faults closed");
        let own: Vec<f64> = own.iter().map(|n| *n as f64).collect();
        let mut flow = Command::new("flow");
        flow.current_dir(folder)
            .args(["A.DATA", "--output-dir=out", "--threads-per-process=1"]);
        run_simulator(&mut flow);
        let out = folder.join("out");
        let arguments = [out.as_os_str(), OsStr::new("A")];
        let found = run_validator("resfo and SciPy", "compartments.py", &arguments);
        let porv = numbers(&found["porv"]);
        println!("{seed}: own {own:?}, OPM Flow {porv:?}");
        assert_eq!(large(&own), 1 + model.planes.len(), "{seed}: {own:?}");
        assert_eq!(large(&porv), large(&own), "{seed}: {porv:?}");
        // It makes the connections that this file expects of it.
        let read: Vec<f64> = numbers(&found["cells"]);
        let ours = Grid::read(folder).parts();
        assert_eq!(read.len(), ours.len());
        assert_eq!(read.iter().sum::<f64>(), ours.iter().sum::<u64>() as f64);
    }
}
