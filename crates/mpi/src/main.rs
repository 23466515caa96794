//! The `atomesh-mpi` binary: the command line of `atomesh`, whose `mesh` several processes share when `mpirun`
//! starts it.

mod mpi_comm;

use std::process::ExitCode;

use atomesh::cli::allocator::OomExitAllocator;

#[global_allocator]
static ALLOCATOR: OomExitAllocator = OomExitAllocator;

fn main() -> ExitCode {
    atomesh::cli::main_with_join(Some(mpi_comm::join))
}
