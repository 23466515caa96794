//! The `atomesh` binary: parse, run, exit code.

fn main() {}
