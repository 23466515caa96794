//! The memory allocator of the program.
//!
//! It returns memory to the operating system as soon as it is free. If there is no memory left, it
//! prints one line, removes unfinished files and exits with code 1. Without it, the process would
//! be aborted.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::panic;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};

use crate::files::remove_unfinished;

/// Size in bytes of the stack on which a thread handles the overflow of its own stack.
const SIGNAL_STACK_BYTES: usize = 8192;

/// The system's allocator; it ends the process if there is no memory left.
pub struct OomExitAllocator;

// SAFETY: all calls go to the system's allocator, and no null pointer is ever returned.
unsafe impl GlobalAlloc for OomExitAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller fulfils the same contract.
        check_allocation(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller fulfils the same contract.
        check_allocation(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller fulfils the same contract.
        check_allocation(unsafe { System.realloc(memory, layout, size) }, size)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller fulfils the same contract.
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

/// Makes the C library allocate large arrays directly from the operating system and return them
/// there.
pub fn configure() {
    // SAFETY: the calls only set two parameters of the C library.
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    unsafe {
        // Size in bytes from which an array is allocated directly from the operating system. By default
        // the C library raises this threshold by itself and keeps the memory of freed arrays: a sixth of
        // the memory of a job of 256^3 samples.
        const MMAP_THRESHOLD_BYTES: libc::c_int = 4 << 20;
        // Number of freed bytes below the threshold that the C library keeps for later allocations.
        const TRIM_THRESHOLD_BYTES: libc::c_int = 64 << 20;
        libc::mallopt(libc::M_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES);
        libc::mallopt(libc::M_TRIM_THRESHOLD, TRIM_THRESHOLD_BYTES);
    }
}

/// Makes a thread that finds no memory to start with end the process in the same way. The standard
/// library panics there, at a place where no panic can be caught.
pub fn exit_on_thread_oom() {
    let default_hook = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        let message = info.payload().downcast_ref::<String>();
        if message
            .is_some_and(|message| message.starts_with("failed to allocate an alternative stack"))
        {
            exit_out_of_memory(SIGNAL_STACK_BYTES);
        }
        default_hook(info);
    }));
}

#[cold]
fn exit_out_of_memory(size: usize) -> ! {
    static IS_EXITING: AtomicBool = AtomicBool::new(false);
    if IS_EXITING.swap(true, SeqCst) {
        // Another thread is already exiting, or this thread failed inside the code below.
        wait_for_exit();
    }
    // The code below may neither allocate memory nor wait for a lock that a thread without memory
    // holds.
    let mut digits = [0; 20];
    write_stderr(b"error: memory: the operating system has none left for ");
    write_stderr(decimal(size, &mut digits));
    write_stderr(b" bytes more; give a larger distance or a part of the image, or use a machine with more memory\n");
    remove_unfinished();
    exit_at_once()
}

/// Ends the process, on Unix without handlers that might need memory.
fn exit_at_once() -> ! {
    // SAFETY: the call only ends the process.
    #[cfg(unix)]
    unsafe {
        libc::_exit(1)
    }
    #[cfg(not(unix))]
    std::process::exit(1)
}

/// Waits up to one second for the thread that ends the process.
fn wait_for_exit() -> ! {
    for _ in 0..100 {
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    exit_at_once()
}

/// Writes to standard error, on Unix without its lock. A failed write is ignored.
fn write_stderr(text: &[u8]) {
    // SAFETY: the pointer and the length are those of a valid slice.
    #[cfg(unix)]
    let _ = unsafe { libc::write(2, text.as_ptr().cast(), text.len()) };
    #[cfg(not(unix))]
    let _ = std::io::Write::write_all(&mut std::io::stderr(), text);
}

fn decimal(mut number: usize, digits: &mut [u8; 20]) -> &[u8] {
    let mut start = digits.len();
    loop {
        start -= 1;
        digits[start] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            return &digits[start..];
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
