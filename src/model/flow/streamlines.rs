//! Streamlines through triangles or tetrahedra (also the parts into which larger cells are cut).
//! They are exact for the rates through the faces.
//!
//! Conserved rates through the faces define a Raviart-Thomas velocity field of lowest order: `u(x)
//! = a + b x` in each cell, with a flux through each face that is constant and the same from both
//! sides. A path in such a field is straight within a cell, so that a streamline needs no time
//! step. It goes from face to face and always leaves a cell through a face with outward flow. So it
//! never crosses a face without flow and never stops between two cells with inconsistent
//! velocities.
//!
//! All streamlines carry the same rate: their starting points are distributed over the inflow faces
//! in proportion to the rates.

use std::ops::Range;
use std::path::Path;

use crate::parallel::prelude::*;

use super::face_rates::FaceRates;
use super::reconstruction::CellReconstruction;
use super::shape_functions::corners;
use super::wells::{LocatedWell, barycentric};
use crate::Result;
use crate::files::vtk::{ArraySource, PolyData};
use crate::geometry::{distance2, to_3d};
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::progress::CancelToken;

/// Largest number of faces that one streamline may cross, to stop closed loops; regular streamlines
/// cross far fewer.
const MAX_CROSSED_FACES: usize = 100_000;

/// Streamlines: polylines in one list of points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Streamlines<const D: usize = 3> {
    /// The points, line after line.
    pub points: Vec<[f64; D]>,
    /// Travel time of the fluid to each point, for porosity 1.
    pub time: Vec<f64>,
    /// The end of each line in `points`.
    pub ends: Vec<u32>,
    /// The rate that each line carries.
    pub rate: f64,
}

/// A cell with a smaller volume, relative to the cube of its longest edge at one corner, is flat: its
/// shape is rounding error.
const FLAT_VOLUME: f64 = 1e-12;

/// A face where streamlines begin. `cell` is the cell that fluid enters through the face; if
/// `source` is given, it is the cell that fluid leaves.
struct Inlet {
    cell: u32,
    face: u8,
    rate: f64,
    source: Option<u32>,
}

impl<const D: usize> Streamlines<D> {
    /// Traces `count` streamlines from sources and inflow boundaries to sinks and outflow
    /// boundaries. `positions` are the positions of the wells. Once `cancel` is cancelled, the
    /// remaining lines are omitted.
    pub fn trace<M: Simplices<D>>(
        mesh: &M,
        rates: &FaceRates<D>,
        wells: &[LocatedWell],
        positions: &[[f64; D]],
        count: usize,
        cancel: &CancelToken<'_>,
    ) -> Self {
        let wells: Vec<(Range<u32>, f64)> = wells
            .iter()
            .map(|well| (well.cell..well.cell + 1, well.rate))
            .collect();
        Self::trace_between(mesh, rates, &wells, positions, count, cancel)
    }

    /// Traces streamlines through polyhedra or polygons that are cut into parts. `wells` are pairs
    /// of a cell and its rate; the other arguments are those of [`trace`](Self::trace).
    pub fn trace_polyhedra<M: Simplices<D>>(
        reconstruction: &CellReconstruction<D, M>,
        wells: &[(u32, f64)],
        positions: &[[f64; D]],
        count: usize,
        cancel: &CancelToken<'_>,
    ) -> Self {
        let parts = |cell: u32| {
            reconstruction.cell_start[cell as usize]..reconstruction.cell_start[cell as usize + 1]
        };
        let wells: Vec<_> = wells
            .iter()
            .map(|&(cell, rate)| (parts(cell), rate))
            .collect();
        Self::trace_between(
            &reconstruction.mesh,
            &reconstruction.rates,
            &wells,
            positions,
            count,
            cancel,
        )
    }

    /// Traces streamlines from sources to sinks. Each well is a range of cells.
    fn trace_between<M: Simplices<D>>(
        mesh: &M,
        rates: &FaceRates<D>,
        wells: &[(Range<u32>, f64)],
        positions: &[[f64; D]],
        count: usize,
        cancel: &CancelToken<'_>,
    ) -> Self {
        let inlets = inlets(rates, wells);
        let total: f64 = inlets.iter().map(|inlet| inlet.rate).sum();
        if count == 0 || inlets.is_empty() || total <= 0.0 {
            return Self::default();
        }
        let rate = total / count as f64;
        let mut starts = Vec::with_capacity(count);
        let (mut index, mut rate_before) = (0, 0.0);
        for line in 0..count {
            let target = (line as f64 + 0.5) * rate;
            while index + 1 < inlets.len() && rate_before + inlets[index].rate < target {
                rate_before += inlets[index].rate;
                index += 1;
            }
            starts.push((&inlets[index], line));
        }
        let sink = |c: u32| {
            wells
                .iter()
                .position(|(cells, rate)| *rate < 0.0 && cells.contains(&c))
        };
        let lines: Vec<(Vec<[f64; D]>, Vec<f64>)> = starts
            .into_par_iter()
            .take_any_while(|_| !cancel.is_cancelled())
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
                let end_cell = trace_path(mesh, rates, cell, &mut points, &mut time);
                if let Some(well) = end_cell.and_then(sink) {
                    points.push(positions[well]);
                    time.push(time.last().copied().unwrap_or(0.0));
                }
                (points, time)
            })
            .collect();
        let mut streamlines = Self {
            rate,
            ..Self::default()
        };
        for (points, time) in lines {
            streamlines.points.extend(points);
            streamlines.time.extend(time);
            streamlines.ends.push(streamlines.points.len() as u32);
        }
        streamlines
    }

    /// Writes a VTK file of polylines (.vtp).
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let points: Vec<[f64; 3]> = self.points.iter().map(|&point| to_3d(point)).collect();
        let (count, rate) = (self.ends.len(), self.rate);
        PolyData {
            counted: &["Lines"],
            point_data: Some(vec![ArraySource::slice("time", 1, &self.time)]),
            cell_data: Some(vec![ArraySource::computed("rate", 1, count, |_| rate)]),
            ..PolyData::new("Lines", &points, count, |i| i64::from(self.ends[i]))
        }
        .write(path)
    }
}

/// Returns the faces through which fluid enters from outside the mesh or leaves the cells of a
/// source.
fn inlets<const D: usize>(rates: &FaceRates<D>, wells: &[(Range<u32>, f64)]) -> Vec<Inlet> {
    let mut inlets = Vec::new();
    for (face, (&outflow, &neighbour)) in rates.outflow.iter().zip(&rates.neighbours).enumerate() {
        if neighbour == NONE && outflow < 0.0 {
            inlets.push(Inlet {
                cell: (face / (D + 1)) as u32,
                face: (face % (D + 1)) as u8,
                rate: -outflow,
                source: None,
            });
        }
    }
    for (source, (cells, rate)) in wells.iter().enumerate().filter(|(_, well)| well.1 > 0.0) {
        let first = inlets.len();
        let mut leaving = 0.0;
        for cell in cells.clone() {
            let (outflow, neighbours) = rates.faces_of(cell as usize);
            for k in (0..=D).filter(|&k| outflow[k] > 0.0 && neighbours[k] != NONE) {
                if !cells.contains(&neighbours[k]) {
                    leaving += outflow[k];
                    inlets.push(Inlet {
                        cell,
                        face: k as u8,
                        rate: rate * outflow[k],
                        source: Some(source as u32),
                    });
                }
            }
        }
        inlets[first..]
            .iter_mut()
            .for_each(|inlet| inlet.rate /= leaving);
    }
    inlets
}

/// Returns a point of the inlet's face. The points of successive lines are spread evenly.
fn point_on_face<const D: usize, M: Simplices<D>>(
    mesh: &M,
    inlet: &Inlet,
    line: usize,
) -> [f64; D] {
    let face = mesh.face(inlet.cell as usize, usize::from(inlet.face));
    // The additive recurrence of the plastic number (in 2-D, only one of its two sequences), folded
    // into the triangle.
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

/// Returns `true` if a cell has no volume but for rounding errors.
fn is_flat<const D: usize>(corners: &[[f64; D]; 4], volume: f64) -> bool {
    let lengths2 = corners[1..=D].iter().map(|p| distance2(p, &corners[0]));
    let longest = lengths2.fold(0.0, f64::max).sqrt();
    volume <= FLAT_VOLUME * longest.powi(D as i32)
}

/// Appends the points of a path that starts at the last point, which lies in `cell`. Returns the
/// cell in which the path ends, or `None` if it leaves the mesh.
fn trace_path<const D: usize, M: Simplices<D>>(
    mesh: &M,
    rates: &FaceRates<D>,
    mut cell: u32,
    points: &mut Vec<[f64; D]>,
    time: &mut Vec<f64>,
) -> Option<u32> {
    let (mut x, mut now) = (points.last().copied()?, time.last().copied()?);
    let mut previous = NONE;
    for _ in 0..MAX_CROSSED_FACES {
        let p = corners(mesh, cell as usize);
        let (outflow, neighbours) = rates.faces_of(cell as usize);
        if is_flat(&p, mesh.volume(cell as usize)) {
            // The path crosses the cell in one point, where most of the fluid leaves it.
            let widest = (0..=D).max_by(|&a, &b| outflow[a].total_cmp(&outflow[b]));
            match widest.map(|k| neighbours[k]) {
                Some(next) if next != NONE && next != previous => {
                    (previous, cell) = (cell, next);
                    continue;
                }
                _ => return Some(cell),
            }
        }
        let size = D as f64 * mesh.volume(cell as usize);
        let growth = outflow.iter().sum::<f64>() / size;
        let velocity: [f64; D] = std::array::from_fn(|c| {
            (0..=D).map(|k| outflow[k] * (x[c] - p[k][c])).sum::<f64>() / size
        });
        let point_at = |reach: f64| std::array::from_fn(|c| x[c] + reach * velocity[c]);
        // Where the straight path meets each face, in multiples of the velocity.
        let shares = barycentric(&p, x);
        let shares_ahead = barycentric(&p, point_at(1.0));
        let mut exit: Option<(f64, usize)> = None;
        for k in (0..=D).filter(|&k| outflow[k] > 0.0) {
            let decrease = shares[k] - shares_ahead[k];
            let reach = shares[k].max(0.0) / decrease;
            if decrease > 0.0 && exit.is_none_or(|(min_reach, _)| reach < min_reach) {
                exit = Some((reach, k));
            }
        }
        // In a contracting field the path may end before it reaches the face.
        let Some((reach, k)) = exit.filter(|(reach, _)| 1.0 + growth * reach > 1e-12) else {
            return Some(cell);
        };
        x = point_at(reach);
        let z = growth * reach;
        now += if z.abs() < 1e-8 {
            reach
        } else {
            z.ln_1p() / growth
        };
        points.push(x);
        time.push(now);
        let next = neighbours[k];
        if next == NONE {
            return None;
        }
        // Back through the face it entered by: the rates are of the size of rounding errors.
        if next == previous && reach == 0.0 {
            return Some(cell);
        }
        (previous, cell) = (cell, next);
    }
    Some(cell)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::{faces_on, jittered_box};
    use crate::mesh::{TetMesh, TriMesh};
    use crate::model::flow::test_meshes::flow_through;
    use crate::model::flow::{FaultLaw, PointWell, Rock, Tensor};

    fn lines_of<const D: usize>(streamlines: &Streamlines<D>) -> Vec<&[[f64; D]]> {
        let mut begin = 0;
        let line = |&end: &u32| {
            let line = &streamlines.points[begin..end as usize];
            begin = end as usize;
            line
        };
        streamlines.ends.iter().map(line).collect()
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
        let no_rates = vec![0.0; mesh.nodes().len()];
        let solution = flow.solve(&no_rates, &fixed).unwrap();
        let rates = flow
            .face_rates(&solution.pressure, &[], &fixed, &CancelToken::never())
            .unwrap();
        let cancel = &CancelToken::never();
        let streamlines = Streamlines::trace(&mesh, &rates, &[], &[], 50, cancel);
        assert!((streamlines.rate * 50.0 - 2.0 * 4f64.powi(D as i32 - 1)).abs() < 1e-9);
        for line in lines_of(&streamlines) {
            let (first, last) = (line[0], line[line.len() - 1]);
            assert!(
                first[0].abs() < 1e-9 && (last[0] - 6.0).abs() < 1e-9,
                "{first:?} {last:?}"
            );
            let offset = |x: &[f64; D]| (1..D).map(|k| (x[k] - first[k]).abs()).sum::<f64>();
            assert!(line.iter().all(|x| offset(x) < 1e-7));
        }
        for &end in &streamlines.ends {
            assert!((streamlines.time[end as usize - 1] - 3.0).abs() < 1e-8);
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
        let point = |x: [f64; 3]| -> [f64; D] { std::array::from_fn(|k| x[k]) };
        let (source, sink) = (point([3.1, 2.2, 1.4]), point([9.2, 2.1, 1.6]));
        let well = |position, rate| PointWell {
            name: "well".into(),
            position,
            rate,
        };
        let wells = flow.locate(&[well(source, 1.0), well(sink, -1.0)]).unwrap();
        let solution = flow.solve(&flow.rates(&wells), &[]).unwrap();
        let rates = flow
            .face_rates(&solution.pressure, &wells, &[], &CancelToken::never())
            .unwrap();
        let cancel = &CancelToken::never();
        let streamlines = Streamlines::trace(
            &flow.split_mesh.mesh,
            &rates,
            &wells,
            &[source, sink],
            40,
            cancel,
        );
        let lines = lines_of(&streamlines);
        assert_eq!(lines.len(), 40);
        let arrived = lines
            .iter()
            .filter(|line| line.last() == Some(&sink))
            .count();
        assert!(arrived >= 38, "{arrived} of 40 arrive");
        for line in lines {
            assert_eq!(line[0], source);
            for step in line.windows(2) {
                if (step[0][0] - 6.0) * (step[1][0] - 6.0) < -1e-9 {
                    panic!("a segment jumps over x = 6: {step:?}");
                }
            }
            // A line changes sides only beyond the tip of the fault.
            let crossing = line.windows(2).find(|s| s[0][0] < 6.0 && s[1][0] >= 6.0);
            if let Some(step) = crossing {
                assert!(step[1][1] > 8.0 - 1e-9, "{step:?}");
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines.vtp");
        streamlines.write(&path).unwrap();
        let file = crate::files::vtk::VtkFile::read(&path, "PolyData").unwrap();
        let piece = file.piece().unwrap();
        assert_eq!(
            file.parse_attribute::<usize>(piece, "NumberOfLines")
                .unwrap(),
            [40]
        );
        let points = file
            .array(&piece.child("Points").unwrap().children[0])
            .unwrap();
        assert_eq!(points.values.len(), 3 * streamlines.points.len());
    }

    #[test]
    fn streamlines_go_from_source_to_sink_around_a_closed_fault() {
        check_closed_fault::<2, TriMesh>();
        check_closed_fault::<3, TetMesh>();
    }
}
