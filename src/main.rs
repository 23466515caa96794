//! The `atomesh` program: parses the command line, runs the verb and returns its exit code.

use std::process::ExitCode;

use atomesh::cli::allocator::OomExitAllocator;

#[global_allocator]
static ALLOCATOR: OomExitAllocator = OomExitAllocator;

fn main() -> ExitCode {
    atomesh::cli::main()
}
