/* The plain-C interface of TetGen: one call makes one mesh. Rust's bindings are generated from this
 * header alone; TetGen's own header (classes, exceptions) stays in tetgen_shim.cpp. */
#ifndef ATOMESH_TETGEN_SHIM_H
#define ATOMESH_TETGEN_SHIM_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Status that tetgen_shim_run returns. Values below 100 are TetGen's own, which it throws. */
enum tetgen_shim_status {
  TETGEN_SHIM_OK = 0,
  TETGEN_SHIM_OUT_OF_MEMORY = 1,
  TETGEN_SHIM_INTERNAL_ERROR = 2,
  TETGEN_SHIM_BAD_INPUT = 10,       /* e.g. all points in one plane */
  TETGEN_SHIM_BAD_SWITCHES = 100,   /* the switches are invalid */
  TETGEN_SHIM_OTHER_EXCEPTION = 101 /* a C++ exception that is not TetGen's */
};

/* Tetrahedra, owned by the C++ side until tetgen_shim_free. */
typedef struct tetgen_shim_mesh {
  int32_t *tetrahedra; /* 4 * count point indices from 0, or NULL */
  int32_t *neighbours;  /* 4 * count tetrahedron indices, -1 outside; NULL without the switch `n` */
  int64_t count;       /* number of tetrahedra */
} tetgen_shim_mesh;

/* Runs TetGen on `point_count` points (x, y, z each), which are only read. On any status other
 * than TETGEN_SHIM_OK nothing is allocated. `switches` must be zero-terminated.
 *
 * The caller guarantees: at least four points, all coordinates finite, extent > 0 along every axis
 * (TetGen asserts otherwise), and no other call running in this process (TetGen keeps its
 * predicates' error bounds in globals). */
int tetgen_shim_run(const double *points, int32_t point_count, const char *switches,
                    tetgen_shim_mesh *mesh);

/* Returns the switches with which atomesh runs TetGen. z: count from zero; Q: quiet; N, F: return no
 * copies of nodes and hull faces; J: do not renumber the nodes if one is left out; n (only with
 * neighbours): return neighbours. The default insertion order is the fastest. */
const char *tetgen_shim_switches(int with_neighbours);

/* Frees what tetgen_shim_run allocated; does nothing on an empty mesh. */
void tetgen_shim_free(tetgen_shim_mesh *mesh);

#ifdef __cplusplus
}
#endif

#endif
