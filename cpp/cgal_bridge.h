// The interface of CGAL for Rust: functions on slices, and how their exceptions reach Rust. Only the
// sources include CGAL's headers. The Rust side is src/mesh/delaunay/bridge.rs.
#pragma once

#include <cstddef>
#include <cstdint>
#include <exception>
#include <new>
#include <stdexcept>
#include <string>

#include "rust/cxx.h"

// cxx calls this function instead of its own handler of exceptions. The text that Rust receives begins
// with the kind of the exception:
//
//   memory                     an allocation failed
//   input: PROBLEM; REMEDY     std::invalid_argument, which only atomesh throws
//   internal: TEXT             any other exception
namespace rust::behavior {

template <typename Try, typename Fail>
static void trycatch(Try &&function, Fail &&fail) noexcept try {
  function();
} catch (const std::bad_alloc &) {
  fail("memory");
} catch (const std::length_error &) {
  fail("memory"); // a container cannot have so many elements
} catch (const std::invalid_argument &e) {
  fail(std::string("input: ") + e.what());
} catch (const std::exception &e) {
  fail(std::string("internal: ") + e.what());
} catch (...) {
  fail("internal: an exception of unknown type");
}

} // namespace rust::behavior

namespace atomesh {

struct CgalVerdict; // shared with Rust

// Returns the finite cells of the Delaunay triangulation, four point numbers each, positively
// oriented. `points` has x, y, z of each point, all finite. Throws if two points coincide.
rust::Vec<std::uint32_t> cgal_triangulate(rust::Slice<const double> points);

// Checks that tetrahedra (four point numbers each, all in range) are a triangulation.
CgalVerdict cgal_validate(rust::Slice<const double> points, rust::Slice<const std::uint32_t> tets);

// Returns the Delaunay triangulation after the points' weights are raised so that as few dihedral
// angles as possible are below `angle` degrees. The hull and `faces` (three point numbers each) are
// kept, except at the rim of a surface of `faces`; those that are no faces of the Delaunay
// triangulation are ignored.
rust::Vec<std::uint32_t> cgal_exude(rust::Slice<const double> points,
                                    rust::Slice<const std::uint32_t> faces, double angle);

// Allocates and frees memory. Tests use it to make an allocation fail.
void cgal_allocate(std::size_t bytes);

// Throws if a triangulation of `points` points has fewer vertices.
inline void check_distinct(std::size_t points, std::size_t vertices) {
  if (vertices != points) {
    throw std::invalid_argument(std::to_string(points - vertices) + " of " + std::to_string(points) +
                                " points coincide with others; give distinct points");
  }
}

} // namespace atomesh
