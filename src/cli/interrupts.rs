//! Ctrl-C.
//!
//! It ends the process at once, with no file half written, while there is nothing worth keeping: in
//! every verb but `mesh`, and in `mesh` before atoms move. Then atoms stop, and what there is becomes a
//! mesh and is written, if that takes no longer than [`QUICK`]. Once more, it always ends the process at
//! once.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use crate::cli::console::Console;
use crate::error::cause;
use crate::files::exit_without_unfinished;
use crate::observer::{Patience, Stage};
use crate::{Error, Result, ranks};

/// The exit code of an interrupted process.
pub const INTERRUPTED: u8 = 130;

/// The longest that an interrupted job goes on.
const QUICK: Duration = Duration::from_millis(1500);

/// What the interrupt handler and a job tell each other.
#[derive(Debug, Clone, Default)]
pub struct Interrupts(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    /// There is a lattice worth keeping.
    lattice: AtomicBool,
    /// The user wants to stop.
    wanted: AtomicBool,
}

impl Interrupts {
    /// From now on Ctrl-C is handled.
    ///
    /// # Errors
    /// [`Error::Job`] if it cannot be.
    pub fn watch() -> Result<Self> {
        let state = Self::default();
        let shared = Arc::clone(&state.0);
        let installed = ctrlc::set_handler(move || {
            let again = shared.wanted.swap(true, Ordering::SeqCst);
            if again || !shared.lattice.load(Ordering::SeqCst) {
                end();
            }
            // Beside the handler, which a second Ctrl-C must reach.
            thread::spawn(|| {
                thread::sleep(QUICK);
                end();
            });
        });
        installed.map_err(|e| {
            Error::Job(cause("interrupt handler", &e, "start the job again")).because(e)
        })?;
        Ok(state)
    }

    /// A stage of `mesh` begins.
    pub fn stage(&self, stage: Stage) {
        // Ranks would not stop at the same place.
        let kept = stage.has_lattice() && ranks::count() == 1;
        self.0.lattice.store(kept, Ordering::SeqCst);
    }

    /// What `work` gives, which ends soon once the user wants to stop; a console is told how far it is.
    pub fn until_wanted<T>(
        &self,
        console: &mut Console,
        work: impl FnOnce(&Patience<'_>) -> T,
    ) -> T {
        let ask = &mut move |share: Option<f64>| {
            if let Some(share) = share {
                console.progress(share, "");
            }
            !self.wanted()
        };
        Patience::telling(ask, work)
    }

    /// The user wants to stop.
    pub fn want(&self) {
        self.0.wanted.store(true, Ordering::SeqCst);
    }

    /// Whether the user wants to stop.
    pub fn wanted(&self) -> bool {
        self.0.wanted.load(Ordering::SeqCst)
    }
}

/// Ends the process with no file half written.
fn end() -> ! {
    exit_without_unfinished(INTERRUPTED.into())
}
