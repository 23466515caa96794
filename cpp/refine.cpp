// Delaunay refinement; see cgal_bridge.h.

#include <algorithm>
#include <array>
#include <cmath>
#include <queue>
#include <stdexcept>
#include <vector>

#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Delaunay_triangulation_cell_base_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_cell_base_with_info_3.h>
#include <CGAL/Triangulation_data_structure_3.h>

#include "atomesh/cpp/cgal_bridge.h"

namespace atomesh {
namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Vertex = CGAL::Triangulation_vertex_base_3<Kernel>;
// A cell stores the number of its entry in the queue, or 0 for none.
using Cell = CGAL::Triangulation_cell_base_with_info_3<std::uint64_t, Kernel,
                                                       CGAL::Delaunay_triangulation_cell_base_3<Kernel>>;
using Delaunay =
    CGAL::Delaunay_triangulation_3<Kernel, CGAL::Triangulation_data_structure_3<Vertex, Cell>>;

struct Distance {
  std::array<double, 3> extent;
  rust::Slice<const float> samples;
  std::array<std::size_t, 3> dims;

  bool inside(const Point &x) const {
    for (int k = 0; k < 3; ++k) {
      if (!(x[k] > 0 && x[k] < extent[k])) {
        return false;
      }
    }
    return true;
  }

  double at(const Point &x) const {
    std::size_t corner = 0, stride = 1, steps[3];
    double share[3];
    for (int k = 0; k < 3; ++k) {
      const std::size_t cells = dims[k] - 1;
      const double u = cells == 0 ? 0 : x[k] / extent[k] * static_cast<double>(cells);
      const std::size_t low = cells == 0 ? 0 : std::min(static_cast<std::size_t>(u), cells - 1);
      share[k] = u - static_cast<double>(low);
      steps[k] = cells == 0 ? 0 : stride;
      corner += low * stride;
      stride *= dims[k];
    }
    double sum = 0;
    for (unsigned c = 0; c < 8; ++c) {
      double weight = 1;
      std::size_t place = corner;
      for (unsigned k = 0; k < 3; ++k) {
        weight *= c >> k & 1 ? share[k] : 1 - share[k];
        place += c >> k & 1 ? steps[k] : 0;
      }
      sum += weight * samples[place];
    }
    return sum;
  }
};

struct Entry {
  double ratio;
  std::uint64_t number;
  Delaunay::Cell_handle cell;
  Point centre;

  // The largest ratio comes first; of equal ratios the oldest entry.
  bool operator<(const Entry &other) const {
    return ratio != other.ratio ? ratio < other.ratio : number > other.number;
  }
};

} // namespace

rust::Vec<double> cgal_refine(rust::Slice<const double> points, rust::Slice<const double> extent,
                              rust::Slice<const float> samples, rust::Slice<const std::size_t> dims,
                              double limit) {
  const Distance distance{{extent[0], extent[1], extent[2]}, samples, {dims[0], dims[1], dims[2]}};
  Delaunay delaunay;
  Delaunay::Cell_handle near;
  for (std::size_t i = 0; i + 2 < points.size(); i += 3) {
    near = delaunay.insert(Point(points[i], points[i + 1], points[i + 2]), near)->cell();
  }
  if (delaunay.dimension() != 3) {
    throw std::invalid_argument(
        "all points lie in one plane or on one line; give points that span a volume");
  }
  std::priority_queue<Entry> queue;
  std::uint64_t number = 0;
  const auto consider = [&](Delaunay::Cell_handle cell) {
    // A new cell may reuse the memory of an old one, and then still has its number.
    cell->info() = 0;
    if (delaunay.is_infinite(cell)) {
      return;
    }
    const Point centre = CGAL::circumcenter(cell->vertex(0)->point(), cell->vertex(1)->point(),
                                            cell->vertex(2)->point(), cell->vertex(3)->point());
    if (!distance.inside(centre)) {
      return;
    }
    const double radius = std::sqrt(CGAL::squared_distance(centre, cell->vertex(0)->point()));
    const double ratio = radius / distance.at(centre);
    if (ratio > limit) {
      cell->info() = ++number;
      queue.push({ratio, number, cell, centre});
    }
  };
  for (auto cell : delaunay.all_cell_handles()) {
    consider(cell);
  }
  rust::Vec<double> added;
  std::vector<Delaunay::Cell_handle> cells;
  while (!queue.empty()) {
    const Entry worst = queue.top();
    queue.pop();
    if (!delaunay.tds().cells().is_used(worst.cell) || worst.cell->info() != worst.number) {
      continue; // the cell no longer exists
    }
    const std::size_t before = delaunay.number_of_vertices();
    const auto vertex = delaunay.insert(worst.centre, worst.cell);
    if (delaunay.number_of_vertices() == before) {
      worst.cell->info() = 0; // a point already exists at this position
      continue;
    }
    for (int k = 0; k < 3; ++k) {
      added.push_back(worst.centre[k]);
    }
    cells.clear();
    delaunay.incident_cells(vertex, std::back_inserter(cells));
    for (auto cell : cells) {
      consider(cell);
    }
  }
  return added;
}

} // namespace atomesh
