// Runs TetGen once in its own process: reads points from standard input, writes tetrahedra to standard
// output, and exits.
//
// A program uses this worker if it cannot contain TetGen itself (a shared library hides terminatetetgen,
// see tetgen_shim.cpp), if it must survive a crash of TetGen, or if it runs several triangulations at the
// same time. Numbers are in the byte order of this machine:
//
//   in   uint64 number of points, uint64 1 if neighbours are requested, else 0; 3 doubles for each point
//   out  int64 status (tetgen_shim.h), uint64 number of tetrahedra; 4 int32 nodes for each tetrahedron,
//        and 4 int32 neighbours for each if requested

#include <csignal>
#include <cstdio>
#include <fcntl.h>
#include <unistd.h>
#include <vector>
#ifdef __linux__
#include <sys/prctl.h>
#endif

#include "tetgen_shim.h"

namespace {

bool read_all(void *to, size_t bytes) {
  char *at = static_cast<char *>(to);
  while (bytes > 0) {
    const ssize_t got = read(STDIN_FILENO, at, bytes);
    if (got <= 0) {
      return false;
    }
    at += got;
    bytes -= static_cast<size_t>(got);
  }
  return true;
}

bool write_all(int to, const void *from, size_t bytes) {
  const char *at = static_cast<const char *>(from);
  while (bytes > 0) {
    const ssize_t put = write(to, at, bytes);
    if (put <= 0) {
      return false;
    }
    at += put;
    bytes -= static_cast<size_t>(put);
  }
  return true;
}

} // namespace

extern "C" int tetgen_shim_serve(void) {
#ifdef __linux__
  // The worker ends when its parent process ends.
  prctl(PR_SET_PDEATHSIG, SIGKILL);
#endif
  // Ctrl-C is handled by the parent process, which may still need the result.
  signal(SIGINT, SIG_IGN);
  // TetGen itself prints to standard output, so the result uses a copy of that descriptor.
  const int out = dup(STDOUT_FILENO);
  const int nowhere = open("/dev/null", O_WRONLY);
  if (out < 0 || nowhere < 0 || dup2(nowhere, STDOUT_FILENO) < 0) {
    return 3;
  }
  uint64_t asked[2];
  if (!read_all(asked, sizeof asked) || asked[0] > INT32_MAX / 8) {
    return 4;
  }
  std::vector<double> points;
  try {
    points.resize(3 * asked[0]);
  } catch (...) {
    const int64_t answer[2] = {TETGEN_SHIM_OUT_OF_MEMORY, 0};
    return write_all(out, answer, sizeof answer) ? 0 : 5;
  }
  if (!read_all(points.data(), points.size() * sizeof(double))) {
    return 4;
  }
  tetgen_shim_mesh mesh;
  const int64_t status = tetgen_shim_run(points.data(), static_cast<int32_t>(asked[0]),
                                         tetgen_shim_switches(asked[1] != 0), &mesh);
  const int64_t answer[2] = {status, mesh.count};
  const size_t bytes = 4 * sizeof(int32_t) * static_cast<size_t>(mesh.count);
  const bool told = write_all(out, answer, sizeof answer) &&
                    (mesh.tetrahedra == nullptr || write_all(out, mesh.tetrahedra, bytes)) &&
                    (mesh.neighbors == nullptr || write_all(out, mesh.neighbors, bytes));
  // Exiting is faster than freeing all memory.
  _exit(told ? 0 : 5);
}

#ifdef ATOMESH_TETGEN_PROGRAM
int main() { return tetgen_shim_serve(); }
#endif
