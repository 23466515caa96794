//! Streamlines through triangles or tetrahedra (also those that larger cells are cut into), exact for the
//! rates through their faces.
//!
//! Rates through the faces that are conserved make one velocity field of the lowest order of Raviart
//! and Thomas: `u(x) = a + b x` in each cell, its flux through each face constant and the same from
//! both sides. A path in such a field is straight within a cell, so a streamline needs no time step:
//! it goes from face to face, always leaving through a face with flow outwards. It never crosses a
//! face without flow, and is never caught between two cells that disagree.
//!
//! All streamlines carry the same rate: they begin on the faces where fluid comes in, in proportion.

use std::ops::Range;
use std::path::Path;

use crate::parallel::prelude::*;

use super::face_rates::FaceRates;
use super::reconstruction::CellReconstruction;
use super::shape_functions::corners;
use super::wells::{LocatedWell, barycentric};
use crate::Result;
use crate::files::atomic_write;
use crate::files::vtk::{ArraySource, Document};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::progress::CancelToken;

/// Faces that one streamline may cross: far more than any that does not go round in circles.
const MAX_CROSSED_FACES: usize = 100_000;

/// Polylines, in one list.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Streamlines<const D: usize = 3> {
    /// Their points, line after line.
    pub points: Vec<[f64; D]>,
    /// For each point the time that fluid needs to get there, for porosity 1.
    pub time: Vec<f64>,
    /// Where each line ends in `points`.
    pub ends: Vec<u32>,
    /// The rate that each line stands for.
    pub rate: f64,
}

/// Where streamlines begin: a face of a cell, seen from the one that fluid enters (or, at a source,
/// leaves), and the source.
struct Inlet {
    cell: u32,
    face: u8,
    rate: f64,
    source: Option<u32>,
}

impl<const D: usize> Streamlines<D> {
    /// Traces `count` streamlines from sources and from where fluid comes in through the boundary to
    /// sinks or out. `positions` are where the wells are. Once `patience` is over, what is left is left
    /// out.
    pub fn trace<M: Simplices<D>>(
        mesh: &M,
        rates: &FaceRates<D>,
        wells: &[LocatedWell],
        positions: &[[f64; D]],
        count: usize,
        patience: &CancelToken<'_>,
    ) -> Self {
        let wells: Vec<(Range<u32>, f64)> = wells
            .iter()
            .map(|well| (well.cell..well.cell + 1, well.rate))
            .collect();
        Self::trace_between(mesh, rates, &wells, positions, count, patience)
    }

    /// The same through polyhedra or polygons, each of which is cut into parts. Wells are known by
    /// their cell and rate.
    pub fn trace_polyhedra<M: Simplices<D>>(
        inside: &CellReconstruction<D, M>,
        wells: &[(u32, f64)],
        positions: &[[f64; D]],
        count: usize,
        patience: &CancelToken<'_>,
    ) -> Self {
        let parts =
            |cell: u32| inside.cell_start[cell as usize]..inside.cell_start[cell as usize + 1];
        let wells: Vec<_> = wells
            .iter()
            .map(|&(cell, rate)| (parts(cell), rate))
            .collect();
        Self::trace_between(
            &inside.mesh,
            &inside.rates,
            &wells,
            positions,
            count,
            patience,
        )
    }

    /// From sources to sinks, each of which is a range of cells.
    fn trace_between<M: Simplices<D>>(
        mesh: &M,
        rates: &FaceRates<D>,
        wells: &[(Range<u32>, f64)],
        positions: &[[f64; D]],
        count: usize,
        patience: &CancelToken<'_>,
    ) -> Self {
        let inlets = inlets(rates, wells);
        let total: f64 = inlets.iter().map(|inlet| inlet.rate).sum();
        if count == 0 || inlets.is_empty() || total <= 0.0 {
            return Self::default();
        }
        let rate = total / count as f64;
        let mut starts = Vec::with_capacity(count);
        let (mut at, mut before) = (0, 0.0);
        for line in 0..count {
            let wanted = (line as f64 + 0.5) * rate;
            while at + 1 < inlets.len() && before + inlets[at].rate < wanted {
                before += inlets[at].rate;
                at += 1;
            }
            starts.push((&inlets[at], line));
        }
        let sink = |c: u32| {
            wells
                .iter()
                .position(|(cells, rate)| *rate < 0.0 && cells.contains(&c))
        };
        let lines: Vec<(Vec<[f64; D]>, Vec<f64>)> = starts
            .into_par_iter()
            .take_any_while(|_| !patience.is_cancelled())
            .map(|(inlet, line)| {
                let mut points = Vec::new();
                let mut time = Vec::new();
                let start = point_on_face(mesh, inlet, line);
                let mut cell = inlet.cell;
                if let Some(source) = inlet.source {
                    points.push(positions[source as usize]);
                    time.push(0.0);
                    cell = rates.faces_of(cell as usize).1[usize::from(inlet.face)];
                }
                points.push(start);
                time.push(0.0);
                let stopped = follow(mesh, rates, cell, &mut points, &mut time);
                if let Some(well) = stopped.and_then(sink) {
                    points.push(positions[well]);
                    time.push(time.last().copied().unwrap_or(0.0));
                }
                (points, time)
            })
            .collect();
        let mut all = Self {
            rate,
            ..Self::default()
        };
        for (points, time) in lines {
            all.points.extend(points);
            all.time.extend(time);
            all.ends.push(all.points.len() as u32);
        }
        all
    }

    /// Writes a VTK file of polylines (.vtp).
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if it cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut document = Document::new("PolyData", &[]);
        document.open(
            "Piece",
            &[
                ("NumberOfPoints", self.points.len().to_string()),
                ("NumberOfLines", self.ends.len().to_string()),
            ],
        );
        document.open("PointData", &[]);
        document.add_array(ArraySource::slice("time", 1, &self.time));
        document.close();
        document.open("CellData", &[]);
        document.add_array(ArraySource::computed("rate", 1, self.ends.len(), |_| {
            self.rate
        }));
        document.close();
        document.open("Points", &[]);
        document.add_array(ArraySource::computed(
            "Points",
            3,
            3 * self.points.len(),
            |i| self.points[i / 3].get(i % 3).copied().unwrap_or(0.0),
        ));
        document.close();
        document.open("Lines", &[]);
        document.add_array(ArraySource::computed(
            "connectivity",
            1,
            self.points.len(),
            |i| i as i64,
        ));
        document.add_array(ArraySource::computed("offsets", 1, self.ends.len(), |i| {
            i64::from(self.ends[i])
        }));
        atomic_write(path, |out| document.write(out))
    }
}

/// Faces through which fluid comes from outside or from a source's cell.
fn inlets<const D: usize>(rates: &FaceRates<D>, wells: &[(Range<u32>, f64)]) -> Vec<Inlet> {
    let mut inlets = Vec::new();
    for (face, (&out, &beyond)) in rates.outflow.iter().zip(&rates.neighbors).enumerate() {
        if beyond == NONE && out < 0.0 {
            inlets.push(Inlet {
                cell: (face / (D + 1)) as u32,
                face: (face % (D + 1)) as u8,
                rate: -out,
                source: None,
            });
        }
    }
    for (source, (cells, rate)) in wells.iter().enumerate().filter(|(_, well)| well.1 > 0.0) {
        let from = inlets.len();
        let mut leaving = 0.0;
        for cell in cells.clone() {
            let (out, around) = rates.faces_of(cell as usize);
            for k in (0..=D).filter(|&k| out[k] > 0.0 && around[k] != NONE) {
                if !cells.contains(&around[k]) {
                    leaving += out[k];
                    inlets.push(Inlet {
                        cell,
                        face: k as u8,
                        rate: rate * out[k],
                        source: Some(source as u32),
                    });
                }
            }
        }
        inlets[from..]
            .iter_mut()
            .for_each(|inlet| inlet.rate /= leaving);
    }
    inlets
}

/// A point of the inlet's face: evenly spread, another one for each line.
fn point_on_face<const D: usize, M: Simplices<D>>(
    mesh: &M,
    inlet: &Inlet,
    line: usize,
) -> [f64; D] {
    let face = mesh.face(inlet.cell as usize, usize::from(inlet.face));
    // The additive recurrence of the plastic number (in the plane one of its two), folded into the
    // triangle.
    let spread = |step: f64| (0.5 + step * line as f64).fract();
    let (mut u, mut v) = (spread(0.754_877_666_246_692_8), 0.0);
    if D == 3 {
        v = spread(0.569_840_290_998_053_2);
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
    }
    let shares = [1.0 - u - v, u, v];
    std::array::from_fn(|c| {
        let corners = face.iter().zip(shares);
        corners.map(|(&n, s)| s * mesh.nodes()[n as usize][c]).sum()
    })
}

/// Appends the points of a path from the last one, which lies in cell `at`. Gives the cell in which
/// it comes to rest; none if it leaves the mesh.
fn follow<const D: usize, M: Simplices<D>>(
    mesh: &M,
    rates: &FaceRates<D>,
    mut at: u32,
    points: &mut Vec<[f64; D]>,
    time: &mut Vec<f64>,
) -> Option<u32> {
    let (mut x, mut now) = (points.last().copied()?, time.last().copied()?);
    let mut entered = NONE;
    for _ in 0..MAX_CROSSED_FACES {
        let p = corners(mesh, at as usize);
        let (out, around) = rates.faces_of(at as usize);
        let size = D as f64 * mesh.volume(at as usize);
        let growth = out.iter().sum::<f64>() / size;
        let velocity: [f64; D] =
            std::array::from_fn(|c| (0..=D).map(|k| out[k] * (x[c] - p[k][c])).sum::<f64>() / size);
        let along = |reach: f64| std::array::from_fn(|c| x[c] + reach * velocity[c]);
        // Where the straight path meets each face, in lengths of the velocity.
        let here = barycentric(&p, x);
        let ahead = barycentric(&p, along(1.0));
        let mut exit: Option<(f64, usize)> = None;
        for k in (0..=D).filter(|&k| out[k] > 0.0) {
            let falls = here[k] - ahead[k];
            let reach = here[k].max(0.0) / falls;
            if falls > 0.0 && exit.is_none_or(|(least, _)| reach < least) {
                exit = Some((reach, k));
            }
        }
        // In a field that contracts the path may end before it gets there.
        let Some((reach, k)) = exit.filter(|(reach, _)| 1.0 + growth * reach > 1e-12) else {
            return Some(at);
        };
        x = along(reach);
        let z = growth * reach;
        now += if z.abs() < 1e-8 {
            reach
        } else {
            z.ln_1p() / growth
        };
        points.push(x);
        time.push(now);
        let next = around[k];
        if next == NONE {
            return None;
        }
        // Back through the face it came by: rates of rounding size only.
        if next == entered && reach == 0.0 {
            return Some(at);
        }
        (entered, at) = (at, next);
    }
    Some(at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::{faces_on, jittered_box};
    use crate::mesh::{TetMesh, TriMesh};
    use crate::model::flow::test_meshes::flow_through;
    use crate::model::flow::{FaultLaw, PointWell, Rock, Tensor};

    fn lines_of<const D: usize>(all: &Streamlines<D>) -> Vec<&[[f64; D]]> {
        let mut begin = 0;
        let line = |&end: &u32| {
            let line = &all.points[begin..end as usize];
            begin = end as usize;
            line
        };
        all.ends.iter().map(line).collect()
    }

    fn check_uniform_flow<const D: usize, M: Simplices<D>>() {
        let mut n = [4; D];
        n[0] = 6;
        let mesh: M = jittered_box(n, n.map(|n| n as f64), 0.25, |_| true);
        let rock = Rock::uniform(Tensor::isotropic(2.0), 1.0);
        let flow = flow_through(&mesh, &[], rock, FaultLaw::OPEN);
        let fixed: Vec<(u32, f64)> = flow
            .nodes_where(|i| mesh.nodes()[i][0] == 0.0 || mesh.nodes()[i][0] == 6.0)
            .into_iter()
            .map(|i| (i, -mesh.nodes()[i as usize][0]))
            .collect();
        let none = vec![0.0; mesh.nodes().len()];
        let found = flow.solve(&none, &fixed).unwrap();
        let rates = flow
            .face_rates(&found.pressure, &[], &fixed, &CancelToken::never())
            .unwrap();
        let patience = &CancelToken::never();
        let all = Streamlines::trace(&mesh, &rates, &[], &[], 50, patience);
        assert!((all.rate * 50.0 - 2.0 * 4f64.powi(D as i32 - 1)).abs() < 1e-9);
        for line in lines_of(&all) {
            let (first, last) = (line[0], line[line.len() - 1]);
            assert!(
                first[0].abs() < 1e-9 && (last[0] - 6.0).abs() < 1e-9,
                "{first:?} {last:?}"
            );
            let off = |x: &[f64; D]| (1..D).map(|k| (x[k] - first[k]).abs()).sum::<f64>();
            assert!(line.iter().all(|x| off(x) < 1e-7));
        }
        for &end in &all.ends {
            assert!((all.time[end as usize - 1] - 3.0).abs() < 1e-8);
        }
    }

    #[test]
    fn in_uniform_flow_streamlines_are_straight_and_arrive_in_time() {
        check_uniform_flow::<2, TriMesh>();
        check_uniform_flow::<3, TetMesh>();
    }

    fn check_closed_fault<const D: usize, M: Simplices<D>>() {
        let n: [usize; D] = std::array::from_fn(|k| if k < 2 { 12 } else { 3 });
        let mesh: M = jittered_box(n, n.map(|n| n as f64), 0.2, |x| x[0] != 6.0);
        let bits = faces_on(&mesh, |x| x[0] == 6.0 && x[1] <= 8.0);
        let rock = Rock::uniform(Tensor::isotropic(1.0), 1.0);
        let flow = flow_through(&mesh, &bits, rock, FaultLaw::CLOSED);
        let place = |at: [f64; 3]| -> [f64; D] { std::array::from_fn(|k| at[k]) };
        let (from, to) = (place([3.1, 2.2, 1.4]), place([9.2, 2.1, 1.6]));
        let well = |position, rate| PointWell {
            name: "well".into(),
            position,
            rate,
        };
        let wells = flow.locate(&[well(from, 1.0), well(to, -1.0)]).unwrap();
        let found = flow.solve(&flow.rates(&wells), &[]).unwrap();
        let rates = flow
            .face_rates(&found.pressure, &wells, &[], &CancelToken::never())
            .unwrap();
        let patience = &CancelToken::never();
        let all = Streamlines::trace(
            &flow.split_mesh.mesh,
            &rates,
            &wells,
            &[from, to],
            40,
            patience,
        );
        let lines = lines_of(&all);
        assert_eq!(lines.len(), 40);
        let arrived = lines.iter().filter(|line| line.last() == Some(&to)).count();
        assert!(arrived >= 38, "{arrived} of 40 arrive");
        for line in lines {
            assert_eq!(line[0], from);
            for step in line.windows(2) {
                if (step[0][0] - 6.0) * (step[1][0] - 6.0) < -1e-9 {
                    panic!("a segment jumps over x = 6: {step:?}");
                }
            }
            // Where a line changes sides it does so beyond the fault's tip.
            let crossing = line.windows(2).find(|s| s[0][0] < 6.0 && s[1][0] >= 6.0);
            if let Some(step) = crossing {
                assert!(step[1][1] > 8.0 - 1e-9, "{step:?}");
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines.vtp");
        all.write(&path).unwrap();
        let read = crate::files::vtk::VtkFile::read(&path, "PolyData").unwrap();
        let piece = read.piece().unwrap();
        assert_eq!(
            read.parse_attribute::<usize>(piece, "NumberOfLines")
                .unwrap(),
            [40]
        );
        let points = read
            .array(&piece.child("Points").unwrap().children[0])
            .unwrap();
        assert_eq!(points.values.len(), 3 * all.points.len());
    }

    #[test]
    fn streamlines_go_from_source_to_sink_round_a_closed_fault() {
        check_closed_fault::<2, TriMesh>();
        check_closed_fault::<3, TetMesh>();
    }
}
