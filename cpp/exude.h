// Sliver exudation by CGAL. The Rust side is src/mesh/delaunay/exude.rs.
#pragma once

#include <cstdint>

#include "rust/cxx.h"

namespace atomesh {

// Returns CGAL's regular triangulation of `points` (x, y, z of each point, all finite) with all weights
// zero, which is a Delaunay triangulation: four point numbers for each cell, positively oriented.
// Throws if two points coincide.
rust::Vec<std::uint32_t> cgal_unweighted(rust::Slice<const double> points);

// Returns the triangulation of cgal_unweighted after the points' weights are raised so that as few
// dihedral angles as possible are below `angle` degrees. The hull and `faces` (three point numbers
// each) are kept; `faces` that are not in the unweighted triangulation are ignored.
rust::Vec<std::uint32_t> cgal_exude(rust::Slice<const double> points,
                                    rust::Slice<const std::uint32_t> faces, double angle);

} // namespace atomesh
