//! Memory from the operating system: given back as soon as nobody needs it; and what happens where there is none: one
//! line, no file left half written, exit code 1. Without that the process would be aborted.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::panic;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};

use crate::files::remove_unfinished;

/// Bytes of the stack on which a thread handles the overflow of its own.
const SIGNAL_STACK_BYTES: usize = 8192;

/// Bytes from which on an array is large. Left to itself, the C library takes larger and larger ones for small, and
/// keeps what they took: a sixth of the memory of a job of 256^3 samples. (Large pages were tried as well: 4 % faster
/// where memory is fresh, 4 % slower where it is in pieces.)
const MMAP_THRESHOLD_BYTES: usize = 4 << 20;
/// Bytes that are kept for later of what small things took that are gone.
const TRIM_THRESHOLD_BYTES: usize = 64 << 20;

/// The system's allocator, which ends the process where it would give nothing.
pub struct OomExitAllocator;

// SAFETY: all is left to the system's allocator; where that returns null, nothing returns.
unsafe impl GlobalAlloc for OomExitAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        check_allocation(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        check_allocation(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as the caller promises.
        check_allocation(unsafe { System.realloc(memory, layout, size) }, size)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[inline]
fn check_allocation(memory: *mut u8, size: usize) -> *mut u8 {
    if memory.is_null() {
        exit_out_of_memory(size);
    }
    memory
}

/// From now on large arrays come straight from the operating system, and go straight back.
pub fn configure() {
    // SAFETY: sets two figures of the C library.
    #[cfg(target_env = "gnu")]
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES as libc::c_int);
        libc::mallopt(libc::M_TRIM_THRESHOLD, TRIM_THRESHOLD_BYTES as libc::c_int);
    }
}

/// Gives the operating system what small things took that are gone: the C library would keep it, for each
/// thread apart, where large arrays find no room in it.
pub fn trim() {
    // SAFETY: looks for pages in which nothing is left, and changes nothing else.
    #[cfg(target_env = "gnu")]
    unsafe {
        libc::malloc_trim(0);
    }
}

/// From now on a thread that finds no memory to start with ends the process in the same way. The standard
/// library panics there, where no panic can be caught.
pub fn exit_on_thread_oom() {
    let usual = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        let said = info.payload().downcast_ref::<String>();
        if said.is_some_and(|said| said.starts_with("failed to allocate an alternative stack")) {
            exit_out_of_memory(SIGNAL_STACK_BYTES);
        }
        usual(info);
    }));
}

#[cold]
fn exit_out_of_memory(size: usize) -> ! {
    static IS_EXITING: AtomicBool = AtomicBool::new(false);
    if IS_EXITING.swap(true, SeqCst) {
        // Another thread is at it, or this one, within what follows.
        wait_for_exit();
    }
    // Nothing here may take memory, nor wait for a lock that a thread without memory holds.
    let mut digits = [0; 20];
    write_stderr(b"error: memory: the operating system has none left for ");
    write_stderr(decimal(size, &mut digits));
    write_stderr(b" bytes more; give a larger distance or a part of the image, or use a machine with more memory\n");
    remove_unfinished();
    // SAFETY: ends the process, without handlers that might need memory.
    unsafe { libc::_exit(1) }
}

/// Waits for the thread that ends the process, but not for ever.
fn wait_for_exit() -> ! {
    for _ in 0..100 {
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    // SAFETY: as above.
    unsafe { libc::_exit(1) }
}

fn write_stderr(text: &[u8]) {
    // SAFETY: the bytes are there; a failure to write is no matter.
    let _ = unsafe { libc::write(2, text.as_ptr().cast(), text.len() as _) };
}

fn decimal(mut number: usize, digits: &mut [u8; 20]) -> &[u8] {
    let mut at = digits.len();
    loop {
        at -= 1;
        digits[at] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            return &digits[at..];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_without_memory() {
        for number in [0, 7, 10, 123_456, usize::MAX] {
            assert_eq!(decimal(number, &mut [0; 20]), number.to_string().as_bytes());
        }
    }
}
