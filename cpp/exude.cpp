// Sliver exudation; see cgal_bridge.h.

#include <algorithm>
#include <array>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Mesh_complex_3_in_triangulation_3.h>
#include <CGAL/Mesh_triangulation_3.h>
#include <CGAL/exude_mesh_3.h>

#include "atomesh/cpp/cgal_bridge.h"

namespace atomesh {
namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;

// The types that CGAL requires of a domain. The index of a vertex is the number of its point.
struct Domain {
  using R = Kernel;
  using Index = int;
  using Subdomain_index = int;
  using Surface_patch_index = int;
  using Corner_index = int;
  using Curve_index = int;
};

using Triangulation = CGAL::Mesh_triangulation_3<Domain, Kernel>::type;
using Complex = CGAL::Mesh_complex_3_in_triangulation_3<Triangulation>;
using Face = std::array<int, 3>;

constexpr int inside = 1;
constexpr int kept = 1;

Triangulation triangulate(rust::Slice<const double> points) {
  using Weighted = Triangulation::Weighted_point;
  const std::size_t count = points.size() / 3;
  std::vector<std::pair<Triangulation::Bare_point, int>> numbered;
  numbered.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    numbered.emplace_back(
        Triangulation::Bare_point(points[3 * i], points[3 * i + 1], points[3 * i + 2]),
        static_cast<int>(i));
  }
  // Points are inserted along a space-filling curve, so that each one is located near its
  // predecessor.
  using Map = CGAL::First_of_pair_property_map<std::pair<Triangulation::Bare_point, int>>;
  using Order = CGAL::Spatial_sort_traits_adapter_3<Kernel, Map>;
  CGAL::spatial_sort(numbered.begin(), numbered.end(), Order());
  Triangulation mesh;
  Triangulation::Vertex_handle last;
  for (const auto &[point, number] : numbered) {
    last = mesh.insert(Weighted(point, 0), last == nullptr ? mesh.infinite_cell() : last->cell());
    if (last == nullptr) {
      throw std::invalid_argument("point " + std::to_string(number) +
                                  " is hidden by another; give distinct points");
    }
    last->set_index(number);
    last->set_dimension(3);
  }
  check_distinct(count, mesh.number_of_vertices());
  return mesh;
}

rust::Vec<std::uint32_t> cells_of(const Triangulation &mesh) {
  rust::Vec<std::uint32_t> tets;
  if (mesh.dimension() == 3) {
    tets.reserve(4 * mesh.number_of_finite_cells());
    for (const auto &cell : mesh.finite_cell_handles()) {
      for (int k = 0; k < 4; ++k) {
        tets.push_back(static_cast<std::uint32_t>(cell->vertex(k)->index()));
      }
    }
  }
  return tets;
}

Face numbers_of(const Triangulation::Facet &facet) {
  Face face;
  for (int k = 0; k < 3; ++k) {
    face[k] = facet.first->vertex((facet.second + 1 + k) & 3)->index();
  }
  std::sort(face.begin(), face.end());
  return face;
}

} // namespace

rust::Vec<std::uint32_t> cgal_exude(rust::Slice<const double> points,
                                    rust::Slice<const std::uint32_t> faces, double angle) {
  Complex complex;
  Triangulation &mesh = complex.triangulation();
  mesh = triangulate(points);
  if (mesh.dimension() < 3) {
    return {};
  }
  std::vector<Face> features(faces.size() / 3);
  for (std::size_t f = 0; f < features.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      features[f][k] = static_cast<int>(faces[3 * f + k]);
    }
    std::sort(features[f].begin(), features[f].end());
  }
  std::sort(features.begin(), features.end());
  for (const auto &cell : mesh.finite_cell_handles()) {
    complex.add_to_complex(cell, inside);
  }
  for (const auto &facet : mesh.finite_facets()) {
    if (mesh.is_infinite(facet.first) || mesh.is_infinite(mesh.mirror_facet(facet).first) ||
        std::binary_search(features.begin(), features.end(), numbers_of(facet))) {
      complex.add_to_complex(facet, kept);
    }
  }
  CGAL::exude_mesh_3(complex, CGAL::parameters::sliver_bound = angle);
  return cells_of(mesh);
}

} // namespace atomesh
