// Delaunay refinement in 3-D, by CGAL. The Rust side is src/mesh/delaunay/refine.rs.
#pragma once

#include <cstddef>
#include <cstdint>

#include "rust/cxx.h"

namespace atomesh {

// Adds circumcentres of tetrahedra to `points` (x, y, z of each point, all finite), the one with the
// largest ratio of circumradius to d first, until no tetrahedron with its circumcentre in the box from
// the origin to `extent` has a ratio above `limit`. d is interpolated linearly between `samples` on a
// grid of `dims` points (x fastest) that covers the box. Returns the added points.
rust::Vec<double> cgal_refine(rust::Slice<const double> points, rust::Slice<const double> extent,
                              rust::Slice<const float> samples, rust::Slice<const std::size_t> dims,
                              double limit);

} // namespace atomesh
