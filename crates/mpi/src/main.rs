//! The `atomesh-mpi` binary: the command line of `atomesh`, whose `mesh` several processes share when `mpirun`
//! starts it.

mod world;

use std::process::ExitCode;

use atomesh::cli::allocator::Careful;

#[global_allocator]
static ALLOCATOR: Careful = Careful;

fn main() -> ExitCode {
    atomesh::cli::main_among(Some(world::join))
}
