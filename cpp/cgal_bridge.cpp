// See cgal_bridge.h. The kernel has exact predicates and inexact constructions: signs are always
// right.

#include <algorithm>
#include <array>
#include <cstddef>
#include <utility>
#include <vector>

#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Delaunay_triangulation_cell_base_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_data_structure_3.h>
#include <CGAL/Triangulation_vertex_base_with_info_3.h>

#include "atomesh/cpp/cgal_bridge.h"
#include "atomesh/src/mesh/delaunay/bridge.rs.h"

namespace atomesh {
namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Vertex = CGAL::Triangulation_vertex_base_with_info_3<std::uint32_t, Kernel>;
using Cell = CGAL::Delaunay_triangulation_cell_base_3<Kernel>;
using Delaunay =
    CGAL::Delaunay_triangulation_3<Kernel, CGAL::Triangulation_data_structure_3<Vertex, Cell>>;
using Topology = CGAL::Triangulation_data_structure_3<>;
using Tet = std::array<std::uint32_t, 4>;

Point point_at(rust::Slice<const double> points, std::uint32_t i) {
  return Point(points[3 * i], points[3 * i + 1], points[3 * i + 2]);
}

Delaunay delaunay_of(rust::Slice<const double> points, const std::vector<std::uint32_t> &numbers) {
  std::vector<std::pair<Point, std::uint32_t>> numbered;
  numbered.reserve(numbers.size());
  for (std::uint32_t i : numbers) {
    numbered.emplace_back(point_at(points, i), i);
  }
  return Delaunay(numbered.begin(), numbered.end());
}

// Returns six times the signed volume, in extended precision.
long double volume6(const Point &a, const Point &b, const Point &c, const Point &d) {
  long double m[3][3];
  const Point *const others[3] = {&b, &c, &d};
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      m[i][k] = static_cast<long double>((*others[i])[k]) - a[k];
    }
  }
  return m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
         m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
         m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
}

// Cells and, for each face (face k is opposite node k), the number 4 * cell + k of the equal face
// of the neighbouring cell.
struct Adjacency {
  std::vector<Tet> cells;
  std::vector<Tet> joined;
  std::uint64_t hull_faces = 0;
  std::uint64_t overfull_faces = 0; // faces of more than two cells, or of a single infinite cell
  bool closed = false;              // every face has two different cells
};

constexpr std::uint32_t none = UINT32_MAX;

// Finds equal faces by sorting. For each face of only one cell an infinite cell is added beyond it:
// its node k is `infinite`, the other nodes are those of the finite cell, and its orientation is
// opposite.
Adjacency join(std::vector<Tet> tets, std::uint32_t infinite) {
  Adjacency result;
  result.cells = std::move(tets);
  for (bool finite : {true, false}) {
    std::vector<Tet> &cells = result.cells;
    const std::size_t count = cells.size();
    result.joined.resize(count, Tet{none, none, none, none});
    std::vector<Tet> faces; // three sorted nodes, then the face's number
    faces.reserve(4 * count);
    for (std::size_t t = 0; t < count; ++t) {
      for (std::uint32_t k = 0; k < 4; ++k) {
        if (result.joined[t][k] != none) {
          continue;
        }
        Tet face = {cells[t][(k + 1) & 3], cells[t][(k + 2) & 3], cells[t][(k + 3) & 3],
                    static_cast<std::uint32_t>(4 * t + k)};
        std::sort(face.begin(), face.begin() + 3);
        faces.push_back(face);
      }
    }
    std::sort(faces.begin(), faces.end());
    for (std::size_t begin = 0, end; begin < faces.size(); begin = end) {
      for (end = begin + 1; end < faces.size(); ++end) {
        if (!std::equal(faces[begin].begin(), faces[begin].begin() + 3, faces[end].begin())) {
          break;
        }
      }
      const std::uint32_t first = faces[begin][3];
      if (end - begin == 2 && first / 4 != faces[begin + 1][3] / 4) {
        const std::uint32_t second = faces[begin + 1][3];
        result.joined[first / 4][first % 4] = second;
        result.joined[second / 4][second % 4] = first;
      } else if (end - begin == 1 && finite) {
        const std::uint32_t k = first % 4;
        Tet outer = cells[first / 4];
        outer[k] = infinite;
        std::swap(outer[(k + 1) & 3], outer[(k + 2) & 3]);
        result.joined[first / 4][k] = static_cast<std::uint32_t>(4 * cells.size() + k);
        cells.push_back(outer);
        result.joined.push_back(Tet{none, none, none, none});
        result.joined.back()[k] = first;
        ++result.hull_faces;
      } else {
        ++result.overfull_faces;
      }
    }
    if (result.overfull_faces > 0) {
      return result;
    }
  }
  result.closed = true;
  return result;
}

// Returns CGAL's own check of the topology, including the infinite cells: neighbours are mutual,
// orientations agree, and Euler's relation holds, i.e. it is a 3-manifold without boundary.
bool is_valid_topology(const Adjacency &adjacency, std::size_t vertex_count) {
  Topology topology;
  topology.set_dimension(3);
  std::vector<Topology::Vertex_handle> vertices(vertex_count);
  for (auto &vertex : vertices) {
    vertex = topology.create_vertex();
  }
  std::vector<Topology::Cell_handle> cells;
  cells.reserve(adjacency.cells.size());
  for (const Tet &c : adjacency.cells) {
    cells.push_back(
        topology.create_cell(vertices[c[0]], vertices[c[1]], vertices[c[2]], vertices[c[3]]));
    for (std::uint32_t node : c) {
      vertices[node]->set_cell(cells.back());
    }
  }
  for (std::size_t t = 0; t < cells.size(); ++t) {
    for (int k = 0; k < 4; ++k) {
      cells[t]->set_neighbor(k, cells[adjacency.joined[t][k] / 4]);
    }
  }
  return topology.is_valid();
}

} // namespace

rust::Vec<std::uint32_t> cgal_triangulate(rust::Slice<const double> points) {
  std::vector<std::uint32_t> all(points.size() / 3);
  for (std::size_t i = 0; i < all.size(); ++i) {
    all[i] = static_cast<std::uint32_t>(i);
  }
  const Delaunay delaunay = delaunay_of(points, all);
  check_distinct(all.size(), delaunay.number_of_vertices());
  rust::Vec<std::uint32_t> tets;
  if (delaunay.dimension() == 3) {
    tets.reserve(4 * delaunay.number_of_finite_cells());
    for (const auto &cell : delaunay.finite_cell_handles()) {
      for (int k = 0; k < 4; ++k) {
        tets.push_back(cell->vertex(k)->info());
      }
    }
  }
  return tets;
}

CgalVerdict cgal_validate(rust::Slice<const double> points, rust::Slice<const std::uint32_t> tets) {
  CgalVerdict verdict{};
  const auto infinite = static_cast<std::uint32_t>(points.size() / 3);
  std::vector<Tet> cells(tets.size() / 4);
  std::vector<bool> used(infinite, false);
  long double six = 0;
  for (std::size_t t = 0; t < cells.size(); ++t) {
    Point p[4];
    for (std::size_t k = 0; k < 4; ++k) {
      cells[t][k] = tets[4 * t + k];
      used[cells[t][k]] = true;
      p[k] = point_at(points, cells[t][k]);
    }
    const CGAL::Orientation orientation = CGAL::orientation(p[0], p[1], p[2], p[3]);
    verdict.inverted += orientation == CGAL::NEGATIVE;
    verdict.flat += orientation == CGAL::COPLANAR;
    six += volume6(p[0], p[1], p[2], p[3]);
  }
  verdict.volume = static_cast<double>(six / 6);
  verdict.unused_nodes = static_cast<std::uint64_t>(std::count(used.begin(), used.end(), false));

  const Adjacency adjacency = join(std::move(cells), infinite);
  verdict.hull_faces = adjacency.hull_faces;
  verdict.overfull_faces = adjacency.overfull_faces;
  // CGAL's check needs a cell at every node, also at the infinite one.
  verdict.valid_topology = adjacency.closed && adjacency.hull_faces > 0 &&
                           verdict.unused_nodes == 0 &&
                           is_valid_topology(adjacency, infinite + std::size_t{1});

  // The volume of the convex hull comes from a triangulation of the nodes on the hull only.
  std::vector<std::uint32_t> hull;
  for (const Tet &c : adjacency.cells) {
    if (std::find(c.begin(), c.end(), infinite) != c.end()) {
      std::copy_if(c.begin(), c.end(), std::back_inserter(hull),
                   [&](std::uint32_t node) { return node != infinite; });
    }
  }
  std::sort(hull.begin(), hull.end());
  hull.erase(std::unique(hull.begin(), hull.end()), hull.end());
  const Delaunay shell = delaunay_of(points, hull);
  long double hull_six = 0;
  if (shell.dimension() == 3) {
    for (const auto &c : shell.finite_cell_handles()) {
      hull_six += volume6(c->vertex(0)->point(), c->vertex(1)->point(), c->vertex(2)->point(),
                          c->vertex(3)->point());
    }
  }
  verdict.hull_volume = static_cast<double>(hull_six / 6);
  return verdict;
}

void cgal_allocate(std::size_t bytes) {
  std::vector<char> memory;
  memory.reserve(bytes);
  // Without a use of the memory, the compiler may remove its allocation.
  char *volatile used = memory.data();
  static_cast<void>(used);
}

} // namespace atomesh
