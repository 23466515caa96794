//! The `atomesh` binary: parse, run, exit code.

use std::process::ExitCode;

use atomesh::cli::allocator::OomExitAllocator;

#[global_allocator]
static ALLOCATOR: OomExitAllocator = OomExitAllocator;

fn main() -> ExitCode {
    atomesh::cli::main()
}
