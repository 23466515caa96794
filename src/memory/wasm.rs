//! Memory of a WebAssembly program, which never shrinks.

/// Returns the number of bytes that may still be allocated: the rest of the 4 GiB that 32-bit
/// addresses reach.
pub fn available_bytes() -> Option<u64> {
    Some((1 << 32) - used_bytes())
}

/// Returns the number of bytes that this program uses.
pub fn used_bytes() -> u64 {
    (std::arch::wasm32::memory_size(0) as u64) << 16
}
