// See tetgen_shim.h.
//
// TetGen reports errors by calling terminatetetgen, which frees the mesh and then throws an int.
// Unwinding runs the mesh's destructor, which frees the mesh again and crashes. The symbol is weak
// in libtet and called through the PLT, so the definition in src/lib.rs replaces it: it only throws,
// and only the destructor frees. It is in Rust, because rustc does not export C++ symbols from shared
// libraries such as Python's extension modules. The header has an inline definition of the same name,
// which is renamed here.

#define TETLIBRARY
#define terminatetetgen terminatetetgen_of_the_header
#include <tetgen.h>
#undef terminatetetgen

#include <new>
#include <utility>

#include "tetgen_shim.h"

void terminatetetgen(tetgenmesh *, int);

// The linker includes the definition because this pointer refers to it.
__attribute__((used)) static void (*const terminate)(tetgenmesh *, int) = terminatetetgen;

extern "C" void tetgen_shim_throw(int status) { throw status; }

static_assert(sizeof(int) == sizeof(int32_t), "TetGen's indices are handed over as they are");
static_assert(sizeof(REAL) == sizeof(double), "Debian's libtet computes in double precision");

namespace {

// Lends the caller's points to TetGen, and removes them before tetgenio would delete them.
struct BorrowedPoints {
  tetgenio input;
  BorrowedPoints(const double *points, int count) {
    input.pointlist = const_cast<double *>(points);
    input.numberofpoints = count;
  }
  ~BorrowedPoints() { input.pointlist = nullptr; }
};

} // namespace

extern "C" int tetgen_shim_run(const double *points, int32_t point_count, const char *switches,
                               tetgen_shim_mesh *mesh) {
  *mesh = tetgen_shim_mesh{nullptr, nullptr, 0};
  try {
    tetgenbehavior behavior;
    if (!behavior.parse_commandline(const_cast<char *>(switches))) {
      return TETGEN_SHIM_BAD_SWITCHES;
    }
    BorrowedPoints lent(points, point_count);
    tetgenio output;
    tetrahedralize(&behavior, &lent.input, &output);
    mesh->tetrahedra = std::exchange(output.tetrahedronlist, nullptr);
    mesh->neighbours = std::exchange(output.neighborlist, nullptr);
    mesh->count = output.numberoftetrahedra;
    return TETGEN_SHIM_OK;
  } catch (int status) {
    return status == TETGEN_SHIM_OK ? TETGEN_SHIM_INTERNAL_ERROR : status;
  } catch (const std::bad_alloc &) {
    return TETGEN_SHIM_OUT_OF_MEMORY;
  } catch (...) {
    return TETGEN_SHIM_OTHER_EXCEPTION;
  }
}

extern "C" const char *tetgen_shim_switches(int with_neighbours) {
  return with_neighbours ? "zQNFJn" : "zQNFJ";
}

extern "C" void tetgen_shim_free(tetgen_shim_mesh *mesh) {
  delete[] mesh->tetrahedra;
  delete[] mesh->neighbours;
  *mesh = tetgen_shim_mesh{nullptr, nullptr, 0};
}
