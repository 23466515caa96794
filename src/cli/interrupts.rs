//! Handling of Ctrl-C.
//!
//! As long as there is nothing worth keeping, Ctrl-C ends the process at once and leaves no
//! unfinished file: in every verb but `mesh`, and in `mesh` before atoms move. After that, atoms
//! stop, and the lattice becomes a mesh that is written if this takes no longer than
//! [`GRACE_PERIOD`]. A second Ctrl-C always ends the process at once.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use crate::Result;
#[cfg(not(target_family = "wasm"))]
use crate::error::cause;
use crate::files::exit_without_unfinished;
use crate::progress::Stage;

/// The exit code of an interrupted process.
pub const INTERRUPTED_EXIT_CODE: u8 = 130;

/// Longest time for which an interrupted job continues.
const GRACE_PERIOD: Duration = Duration::from_millis(1500);

/// State that the interrupt handler and a job share.
#[derive(Debug, Clone, Default)]
pub struct Interrupts(Arc<InterruptState>);

#[derive(Debug, Default)]
struct InterruptState {
    /// `true` if there is a lattice worth keeping.
    has_lattice: AtomicBool,
    /// `true` if the user has asked to stop.
    is_requested: AtomicBool,
}

impl Interrupts {
    /// Installs the handler of Ctrl-C.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if it cannot be installed.
    pub fn install() -> Result<Self> {
        let state = Self::default();
        let shared = Arc::clone(&state.0);
        set_ctrl_c_handler(move || {
            let is_second = shared.is_requested.swap(true, Ordering::SeqCst);
            if is_second || !shared.has_lattice.load(Ordering::SeqCst) {
                exit_now();
            }
            // A thread of its own, as a second Ctrl-C must be able to call the handler.
            thread::spawn(|| {
                thread::sleep(GRACE_PERIOD);
                exit_now();
            });
        })?;
        Ok(state)
    }

    /// Records that a stage of `mesh` begins. Only a process that is alone can stop it early.
    pub(crate) fn set_stage(&self, stage: Stage, is_alone: bool) {
        let can_stop = stage.has_lattice() && is_alone;
        self.0.has_lattice.store(can_stop, Ordering::SeqCst);
    }

    /// Asks the job to stop.
    pub fn request(&self) {
        self.0.is_requested.store(true, Ordering::SeqCst);
    }

    /// Returns `true` if the user has asked to stop.
    pub fn is_requested(&self) -> bool {
        self.0.is_requested.load(Ordering::SeqCst)
    }
}

#[cfg(not(target_family = "wasm"))]
fn set_ctrl_c_handler(handler: impl FnMut() + Send + 'static) -> Result<()> {
    ctrlc::set_handler(handler).map_err(|e| {
        let problem = cause("interrupt handler", &e, "start the job again");
        crate::Error::Job(problem).with_source(e)
    })
}

/// Does nothing: a WebAssembly program receives no signals.
#[cfg(target_family = "wasm")]
fn set_ctrl_c_handler(_: impl FnMut() + Send + 'static) -> Result<()> {
    Ok(())
}

/// Ends the process and removes unfinished files.
fn exit_now() -> ! {
    exit_without_unfinished(INTERRUPTED_EXIT_CODE.into())
}
