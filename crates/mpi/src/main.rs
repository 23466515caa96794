//! The `atomesh-mpi` program: the command line of `atomesh`, with `mesh` on several processes if `mpirun` starts
//! it.

mod mpi_comm;

use std::process::ExitCode;

use atomesh::cli::allocator::OomExitAllocator;

#[global_allocator]
static ALLOCATOR: OomExitAllocator = OomExitAllocator;

fn main() -> ExitCode {
    atomesh::cli::main_with_join(Some(mpi_comm::join))
}
