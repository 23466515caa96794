// The interface of CGAL for Rust: two functions on slices. Only cgal_bridge.cpp includes CGAL's
// headers. The Rust side is src/mesh/delaunay/cgal.rs.
#pragma once

#include <cstdint>

#include "rust/cxx.h"

namespace atomesh {

struct CgalVerdict; // shared with Rust

// Returns the finite cells of the Delaunay triangulation, four point numbers each, positively
// oriented. `points` has x, y, z of each point, all finite. Throws if two points coincide.
rust::Vec<std::uint32_t> cgal_triangulate(rust::Slice<const double> points);

// Checks that tetrahedra (four point numbers each, all in range) are a triangulation.
CgalVerdict cgal_validate(rust::Slice<const double> points, rust::Slice<const std::uint32_t> tets);

} // namespace atomesh
