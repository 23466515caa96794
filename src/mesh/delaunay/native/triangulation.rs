//! Incremental construction of weighted Delaunay triangulations (Bowyer 1981, Watson 1981).
//!
//! A point is inserted in three steps:
//!
//! 1. *Locate*: from the cell of the point before, walk through faces that have the new point on
//!    their other side, until a cell contains it.
//! 2. *Cavity*: collect the cells whose spheres contain the point. They are connected.
//! 3. *Star*: replace them by cells that join the point with the faces of the cavity.
//!
//! The space outside the convex hull is filled with *ghost cells*: each joins a face of the hull with
//! the vertex [`GHOST`]. Its sphere is the half-space beyond the face, so that a point outside
//! the hull is inserted like any other.
//!
//! The spheres of cells are stored as rounded numbers (see `sphere`). Where these do
//! not decide, [`predicates`] do, without errors.

use super::predicates::{self, Grid, WeightedPoint, in_sphere, orientation};
use super::sphere::{LinkVertex, Sphere};
use crate::geometry::NONE;
use crate::geometry::{sorted, sub};

/// The vertex at infinity. Points have the vertices 1, 2, ...
pub const GHOST: u32 = 0;
/// Vertices of a removed cell. It counts as a ghost.
const REMOVED: [u32; 4] = [GHOST; 4];
/// Vertices of the cavity's boundary for which edges are found by a table; its size is the square
/// of this.
const MAX_TABLE_VERTICES: usize = 128;
/// The three edges opposite corner 0 and another corner: for each of the corners 1, 2 and 3 the two
/// others, so that the permutation (0, corner, first, second) is even.
const LINK_EDGES: [(u32, usize, usize); 3] = [(1, 1, 2), (2, 2, 0), (3, 0, 1)];
/// The even permutations of the corners that put each corner in turn first.
const ROTATIONS: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]];

/// A tetrahedron, positively oriented; a ghost cell is so if a point beyond its face replaces
/// [`GHOST`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Vertices.
    pub vertices: [u32; 4],
    /// The neighbour beyond the face opposite each vertex: 4 times the cell plus the corner of it
    /// that is opposite the face.
    pub neighbours: [u32; 4],
}

impl Cell {
    /// Returns `true` if the cell lies outside the hull.
    #[inline]
    pub fn is_ghost(&self) -> bool {
        self.vertices.contains(&GHOST)
    }

    /// Returns `true` if the cell lies inside the hull.
    pub fn is_finite(&self) -> bool {
        !self.is_ghost()
    }

    /// Returns the face opposite a corner, in the order in which it forms a positive cell with a
    /// point before it that lies on the side of the corner.
    #[inline(always)]
    pub fn face(&self, corner: usize) -> [u32; 3] {
        let [_, a, b, c] = ROTATIONS[corner];
        [self.vertices[a], self.vertices[b], self.vertices[c]]
    }
}

/// Result of [`Triangulation::insert`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Inserted {
    /// The point is a vertex now.
    Vertex,
    /// The point coincides with this vertex.
    Duplicate(u32),
    /// The point is in no cell of the triangulation because of the weights of others.
    Hidden,
}

/// A cell that joins a face of the cavity with the new point.
#[derive(Debug, Clone, Copy)]
struct NewCell {
    slot: u32,
    /// Indices of the face's vertices among those of the cavity's boundary.
    locals: [u32; 3],
}

/// A weighted Delaunay triangulation to which points can be added.
pub struct Triangulation<const WEIGHTED: bool> {
    /// Positions by vertex. The first one is not used.
    points: Vec<[f64; 3]>,
    /// Weights by vertex; empty unless `WEIGHTED`.
    weights: Vec<f64>,
    /// Numbers by vertex, which decide ties.
    numbers: Vec<u32>,
    /// A grid on which all points are.
    grid: Grid,
    /// Centre of the points' box.
    origin: [f64; 3],
    /// Upper bound of the coordinates relative to the origin, with what rounding adds to them.
    extent: f64,
    cells: Vec<Cell>,
    spheres: Vec<Sphere>,
    free: Vec<u32>,
    /// A cell where the next search starts, never a ghost.
    recent: u32,
    // Work space of `insert`.
    cavity: Vec<u32>,
    local_index: Vec<u32>,
    link: Vec<u32>,
    link_vertices: Vec<LinkVertex>,
    edge_table: Box<[u32; MAX_TABLE_VERTICES * MAX_TABLE_VERTICES]>,
    new_cells: Vec<NewCell>,
}

impl<const WEIGHTED: bool> Triangulation<WEIGHTED> {
    /// Returns the triangulation of four points that are not in one plane. `low` and `high` are the
    /// corners of the box of all points, which are on `grid`; space for `capacity` points is
    /// reserved. Coordinates are between 1e-15 and 1e15, or smaller than what matters.
    pub fn new(
        first: [WeightedPoint; 4],
        numbers: [u32; 4],
        [low, high]: [[f64; 3]; 2],
        grid: Grid,
        capacity: usize,
    ) -> Self {
        let origin = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
        let largest = (0..3)
            .map(|k| low[k].abs().max(high[k].abs()))
            .fold(0.0, f64::max);
        let half_size = (0..3).map(|k| 0.5 * (high[k] - low[k])).fold(0.0, f64::max);
        let mut new = Self {
            points: Vec::with_capacity(capacity + 1),
            weights: Vec::new(),
            numbers: Vec::with_capacity(capacity + 1),
            grid,
            origin,
            extent: half_size + 1e-8 * largest,
            cells: Vec::with_capacity(7 * capacity),
            spheres: Vec::with_capacity(7 * capacity),
            free: Vec::new(),
            recent: 0,
            cavity: Vec::new(),
            local_index: Vec::with_capacity(capacity + 1),
            link: Vec::new(),
            link_vertices: Vec::new(),
            edge_table: Box::new([0; MAX_TABLE_VERTICES * MAX_TABLE_VERTICES]),
            new_cells: Vec::new(),
        };
        new.push_vertex(
            WeightedPoint {
                x: [f64::NAN; 3],
                weight: 0.0,
            },
            u32::MAX,
        );
        for (point, number) in first.into_iter().zip(numbers) {
            new.push_vertex(point, number);
        }
        let mut vertices = [1, 2, 3, 4];
        if orientation(first.map(|p| p.x)) < 0 {
            vertices.swap(2, 3);
        }
        new.cells.extend(first_cells(vertices));
        new.spheres.push(Sphere::UNKNOWN);
        new.spheres.extend([Sphere::UNKNOWN_GHOST; 4]);
        new
    }

    /// Adds a point without cells.
    fn push_vertex(&mut self, point: WeightedPoint, number: u32) -> u32 {
        self.points.push(point.x);
        if WEIGHTED {
            self.weights.push(point.weight);
        }
        self.numbers.push(number);
        self.local_index.push(NONE);
        self.points.len() as u32 - 1
    }

    /// Returns the point numbers of the cells inside the hull.
    pub fn tets(&self) -> Vec<[u32; 4]> {
        let finite = self.cells.iter().filter(|cell| cell.is_finite());
        finite
            .map(|cell| cell.vertices.map(|v| self.numbers[v as usize]))
            .collect()
    }

    /// Returns all cells, among them ghosts and removed ones, and the number of each vertex.
    pub fn into_cells(self) -> (Vec<Cell>, Vec<u32>) {
        (self.cells, self.numbers)
    }

    /// Returns the number of slots for cells, some of which may be free.
    pub fn cell_count(&self) -> usize {
        self.cells.len()
    }

    /// Returns the cell of a slot.
    pub fn cell(&self, slot: u32) -> &Cell {
        &self.cells[slot as usize]
    }

    /// Returns the slots of the cells that the last insertion or replacement made.
    pub fn new_cells(&self) -> impl Iterator<Item = u32> + '_ {
        self.new_cells.iter().map(|cell| cell.slot)
    }

    /// Returns the number of a vertex's point.
    pub fn number(&self, vertex: u32) -> u32 {
        self.numbers[vertex as usize]
    }

    /// Returns the position of a vertex.
    #[inline]
    pub fn point(&self, vertex: u32) -> [f64; 3] {
        self.points[vertex as usize]
    }

    #[inline]
    fn weighted_point(&self, vertex: u32) -> WeightedPoint {
        WeightedPoint {
            x: self.point(vertex),
            weight: self.weight(vertex),
        }
    }

    /// Inserts a point. `number` decides ties.
    pub fn insert(&mut self, point: WeightedPoint, number: u32) -> Inserted {
        self.insert_near(point, number, self.recent)
    }

    /// Inserts a point; the search starts at the cell `near`, which is not a ghost.
    pub fn insert_near(&mut self, point: WeightedPoint, number: u32, near: u32) -> Inserted {
        let start = self.locate(point.x, near);
        let cell = self.cells[start as usize];
        if !cell.is_ghost() {
            let same = cell.vertices.iter().find(|v| self.point(**v) == point.x);
            if let Some(&vertex) = same
                && !WEIGHTED
            {
                self.recent = start;
                return Inserted::Duplicate(vertex);
            }
        }
        self.grid.include(point.x);
        let vertex = self.push_vertex(point, number);
        if WEIGHTED && !cell.is_ghost() && !self.is_in_conflict(start, vertex) {
            self.points.pop();
            self.weights.pop();
            self.numbers.pop();
            self.local_index.pop();
            self.recent = start;
            return Inserted::Hidden;
        }
        self.fill_cavity(start, vertex);
        Inserted::Vertex
    }

    /// Returns a cell that contains the point, or a ghost cell whose half-space does.
    fn locate(&self, x: [f64; 3], near: u32) -> u32 {
        let mut current = near;
        let mut previous = NONE;
        let mut first_corner = 0;
        'walk: loop {
            let cell = &self.cells[current as usize];
            let [a, b, c, d] = cell.vertices;
            let corners = [self.point(a), self.point(b), self.point(c), self.point(d)];
            // Vectors from x.
            let [a, b, c, d] = corners;
            let [a, b, c, d] = [sub(a, x), sub(b, x), sub(c, x), sub(d, x)];
            // Different corners first at each step, so that the walk cannot go in circles for long.
            first_corner = (first_corner + 1) & 3;
            for i in 0..4 {
                let k = (first_corner + i) & 3;
                let next = cell.neighbours[k] >> 2;
                if next == previous {
                    continue;
                }
                // The volume with x instead of corner k, up to its sign.
                let [u, v, w] = match k {
                    0 => [b, c, d],
                    1 => [a, d, c],
                    2 => [d, a, b],
                    _ => [c, b, a],
                };
                let is_beyond = match predicates::orientation_filter(u, v, w) {
                    Some(side) => side < 0,
                    None => {
                        let mut corners = corners;
                        corners[k] = x;
                        orientation(corners) < 0
                    }
                };
                if is_beyond {
                    if self.cells[next as usize].is_ghost() {
                        return next;
                    }
                    previous = current;
                    current = next;
                    continue 'walk;
                }
            }
            return current;
        }
    }

    /// Returns the weight of a vertex.
    #[inline(always)]
    fn weight(&self, vertex: u32) -> f64 {
        if WEIGHTED {
            self.weights[vertex as usize]
        } else {
            0.0
        }
    }

    /// Returns `true` if the sphere of a cell contains a vertex, without rounding errors.
    #[cold]
    #[inline(never)]
    fn is_in_conflict(&self, cell: u32, vertex: u32) -> bool {
        let vertices = self.cells[cell as usize].vertices;
        if vertices.contains(&GHOST) {
            return self.is_beyond_hull(cell, vertex);
        }
        let [a, b, c, d] = vertices;
        let numbers = [a, b, c, d, vertex].map(|v| self.numbers[v as usize]);
        let tet = vertices.map(|v| self.weighted_point(v));
        in_sphere(tet, self.weighted_point(vertex), numbers, self.grid) < 0
    }

    /// Returns `true` if a vertex is beyond the hull's face of a ghost cell, or in its plane and in
    /// the sphere of the cell behind the face.
    fn is_beyond_hull(&self, ghost: u32, vertex: u32) -> bool {
        let cell = &self.cells[ghost as usize];
        let corner = cell.vertices.iter().position(|v| *v == GHOST).unwrap_or(0);
        let mut vertices = cell.vertices;
        vertices[corner] = vertex;
        match orientation(vertices.map(|v| self.point(v))) {
            0 => {
                // The neighbour is in the cavity already, or its sphere is known.
                let inner = cell.neighbours[corner] >> 2;
                self.spheres[inner as usize].is_in_cavity() || self.is_in_conflict(inner, vertex)
            }
            side => side > 0,
        }
    }

    /// Replaces the cells in conflict with `vertex`, of which `start` is one, by cells that join the
    /// faces of the cavity with the vertex.
    fn fill_cavity(&mut self, start: u32, vertex: u32) {
        let (centre, weight) = (self.point(vertex), self.weight(vertex));
        let x = sub(centre, self.origin);
        self.extent = x.iter().fold(self.extent, |m, x| m.max(x.abs()));
        self.cavity.clear();
        self.new_cells.clear();
        self.link.clear();
        self.link_vertices.clear();
        self.cavity.push(start);
        self.spheres[start as usize] = Sphere::IN_CAVITY;
        let mut next = 0;
        while let Some(&in_cavity) = self.cavity.get(next) {
            next += 1;
            let cell = self.cells[in_cavity as usize];
            // All four are read before the first is needed, since each may be far away in memory.
            let [a, b, c, d] = cell.neighbours;
            let sphere_of = |outer: u32| self.spheres[(outer >> 2) as usize];
            let spheres = [sphere_of(a), sphere_of(b), sphere_of(c), sphere_of(d)];
            for k in 0..4 {
                let outer = cell.neighbours[k];
                let neighbour = outer >> 2;
                if spheres[k].is_in_cavity() {
                    continue;
                }
                let is_in_conflict = spheres[k].contains(x, weight, self.extent);
                if is_in_conflict.unwrap_or_else(|| self.is_in_conflict(neighbour, vertex)) {
                    self.spheres[neighbour as usize] = Sphere::IN_CAVITY;
                    self.cavity.push(neighbour);
                    continue;
                }
                let [a, b, c] = cell.face(k);
                let locals = [
                    self.link_index(a, vertex, centre),
                    self.link_index(b, vertex, centre),
                    self.link_index(c, vertex, centre),
                ];
                let sphere = self.sphere([a, b, c], locals, x, weight);
                let cell = Cell {
                    vertices: [vertex, a, b, c],
                    neighbours: [outer, 0, 0, 0],
                };
                let slot = self.put_cell(cell, sphere);
                self.cells[neighbour as usize].neighbours[(outer & 3) as usize] = 4 * slot;
                self.new_cells.push(NewCell { slot, locals });
                for (corner, from, to) in LINK_EDGES {
                    self.edge_table[edge_index(locals[from], locals[to])] = 4 * slot + corner;
                }
                if !sphere.is_ghost() {
                    self.recent = slot;
                }
            }
        }
        if self.link.len() <= MAX_TABLE_VERTICES {
            for &NewCell { slot, locals } in &self.new_cells {
                let neighbours = &mut self.cells[slot as usize].neighbours;
                for (corner, from, to) in LINK_EDGES {
                    neighbours[corner as usize] =
                        self.edge_table[edge_index(locals[to], locals[from])];
                }
            }
        } else {
            self.connect_by_sorting();
        }
        for &v in &self.link {
            self.local_index[v as usize] = NONE;
        }
        for &slot in &self.cavity {
            self.cells[slot as usize].vertices = REMOVED;
        }
        self.free.extend_from_slice(&self.cavity);
    }

    /// Replaces connected cells, all cells of `vertex` inside the hull among them, by cells that
    /// join the vertex with the boundary of these cells. The boundary is seen from the vertex as a
    /// whole, and no other vertex is inside it. Afterwards the triangulation is no longer that of
    /// the weights of `insert`, and nothing can be inserted.
    pub fn replace_star(&mut self, vertex: u32, removed: &[u32]) {
        self.new_cells.clear();
        // The two faces at each edge that is opposite the vertex, as 4 times the cell plus corner.
        let mut edges: Vec<([u32; 2], u32)> = Vec::new();
        let mut faces = Vec::new();
        for &cell in removed {
            let cell = self.cells[cell as usize];
            for k in 0..4 {
                let outer = cell.neighbours[k];
                if removed.contains(&(outer >> 2)) {
                    continue;
                }
                let others = cell.face(k);
                if others.contains(&vertex) {
                    let mut edge = others.into_iter().filter(|v| *v != vertex);
                    if let (Some(a), Some(b)) = (edge.next(), edge.next()) {
                        edges.push((sorted([a, b]), outer));
                    }
                } else {
                    faces.push((others, outer));
                }
            }
        }
        for &slot in removed {
            self.cells[slot as usize].vertices = REMOVED;
        }
        self.free.extend_from_slice(removed);
        for ([a, b, c], outer) in faces {
            let cell = Cell {
                vertices: [vertex, a, b, c],
                neighbours: [outer, 0, 0, 0],
            };
            let slot = self.put_cell(cell, Sphere::UNKNOWN);
            self.cells[(outer >> 2) as usize].neighbours[(outer & 3) as usize] = 4 * slot;
            self.new_cells.push(NewCell {
                slot,
                locals: [0; 3],
            });
            edges.push((sorted([b, c]), 4 * slot + 1));
            edges.push((sorted([c, a]), 4 * slot + 2));
            edges.push((sorted([a, b]), 4 * slot + 3));
        }
        edges.sort_unstable();
        for pair in edges.chunks_exact(2) {
            self.connect(pair[0].1, pair[1].1);
        }
    }

    /// Makes two faces, given as 4 times the cell plus the corner, those of neighbours.
    fn connect(&mut self, a: u32, b: u32) {
        self.cells[(a >> 2) as usize].neighbours[(a & 3) as usize] = b;
        self.cells[(b >> 2) as usize].neighbours[(b & 3) as usize] = a;
    }

    /// Stores a new cell and returns its slot. Slots of removed cells are used first.
    #[inline(always)]
    fn put_cell(&mut self, cell: Cell, sphere: Sphere) -> u32 {
        if let Some(slot) = self.free.pop() {
            self.cells[slot as usize] = cell;
            self.spheres[slot as usize] = sphere;
            return slot;
        }
        self.cells.push(cell);
        self.spheres.push(sphere);
        self.cells.len() as u32 - 1
    }

    /// Returns the index of `v` among the vertices of the cavity's boundary, and appends it if it
    /// is not yet there. `vertex` is the new point at `centre`.
    #[inline(always)]
    fn link_index(&mut self, v: u32, vertex: u32, centre: [f64; 3]) -> u32 {
        let local = &mut self.local_index[v as usize];
        if *local != NONE {
            return *local;
        }
        *local = self.link.len() as u32;
        let index = *local;
        let difference = sub(self.points[v as usize], centre);
        let weight = self.weight(v) - self.weight(vertex);
        self.link.push(v);
        self.link_vertices.push(LinkVertex::new(difference, weight));
        index
    }

    /// Connects the new cells with each other if they have too many vertices for the table.
    #[cold]
    fn connect_by_sorting(&mut self) {
        let mut edges = Vec::with_capacity(3 * self.new_cells.len());
        for &NewCell { slot, locals } in &self.new_cells {
            for (corner, from, to) in LINK_EDGES {
                let [from, to] = [locals[from], locals[to]];
                edges.push((from.min(to), from.max(to), 4 * slot + corner));
            }
        }
        edges.sort_unstable();
        for pair in edges.chunks_exact(2) {
            self.connect(pair[0].2, pair[1].2);
        }
    }

    /// Returns the sphere of a new cell, whose first corner is the new vertex at `x` relative to the
    /// origin, with this weight.
    #[inline(always)]
    fn sphere(&self, vertices: [u32; 3], locals: [u32; 3], x: [f64; 3], weight: f64) -> Sphere {
        let [b, c, d] = locals;
        let link_vertex = |local: u32| self.link_vertices[local as usize];
        let [b, c, d] = [link_vertex(b), link_vertex(c), link_vertex(d)];
        if !vertices.contains(&GHOST) {
            return Sphere::through(x, weight, [b, c, d]);
        }
        // The volume of the cell with a point instead of the ghost is that of the two others and the
        // point.
        match vertices.map(|v| v == GHOST) {
            [true, ..] => Sphere::half_space(x, c, d),
            [_, true, _] => Sphere::half_space(x, d, b),
            _ => Sphere::half_space(x, b, c),
        }
    }
}

/// Returns a positive tetrahedron and the four ghost cells around it.
fn first_cells(vertices: [u32; 4]) -> [Cell; 5] {
    // The cell beyond the face opposite corner k is cell k + 1. Two corners are exchanged, so that
    // it is oriented as the first cell seen from outside.
    let [a, b, c, d] = vertices;
    let mut cells = [
        vertices,
        [b, GHOST, c, d],
        [a, GHOST, d, c],
        [a, GHOST, b, d],
        [a, GHOST, c, b],
    ]
    .map(|vertices| Cell {
        vertices,
        neighbours: [0; 4],
    });
    let faces: [[u32; 3]; 20] =
        std::array::from_fn(|i| sorted([1, 2, 3].map(|j| cells[i / 4].vertices[(i + j) % 4])));
    for (i, face) in faces.iter().enumerate() {
        let other = (0..20).find(|&j| j / 4 != i / 4 && faces[j] == *face);
        if let Some(other) = other {
            cells[i / 4].neighbours[i % 4] = other as u32;
        }
    }
    cells
}

/// Returns the place of an edge in the table. Edges of vertices beyond the table overwrite others;
/// then the table is not used.
#[inline(always)]
fn edge_index(from: u32, to: u32) -> usize {
    (from as usize * MAX_TABLE_VERTICES + to as usize) % (MAX_TABLE_VERTICES * MAX_TABLE_VERTICES)
}
