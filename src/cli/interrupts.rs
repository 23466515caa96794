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
use crate::progress::{CancelToken, Stage};
use crate::{Error, Result, comm};

/// The exit code of an interrupted process.
pub const INTERRUPTED_EXIT_CODE: u8 = 130;

/// The longest that an interrupted job goes on.
const GRACE_PERIOD: Duration = Duration::from_millis(1500);

/// What the interrupt handler and a job tell each other.
#[derive(Debug, Clone, Default)]
pub struct Interrupts(Arc<InterruptState>);

#[derive(Debug, Default)]
struct InterruptState {
    /// There is a lattice worth keeping.
    has_lattice: AtomicBool,
    /// The user wants to stop.
    is_requested: AtomicBool,
}

impl Interrupts {
    /// From now on Ctrl-C is handled.
    ///
    /// # Errors
    /// [`Error::Job`] if it cannot be.
    pub fn install() -> Result<Self> {
        let state = Self::default();
        let shared = Arc::clone(&state.0);
        let installed = ctrlc::set_handler(move || {
            let again = shared.is_requested.swap(true, Ordering::SeqCst);
            if again || !shared.has_lattice.load(Ordering::SeqCst) {
                exit_now();
            }
            // Beside the handler, which a second Ctrl-C must reach.
            thread::spawn(|| {
                thread::sleep(GRACE_PERIOD);
                exit_now();
            });
        });
        installed.map_err(|e| {
            Error::Job(cause("interrupt handler", &e, "start the job again")).with_source(e)
        })?;
        Ok(state)
    }

    /// A stage of `mesh` begins.
    pub fn set_stage(&self, stage: Stage) {
        // Ranks would not stop at the same place.
        let kept = stage.has_lattice() && comm::size() == 1;
        self.0.has_lattice.store(kept, Ordering::SeqCst);
    }

    /// What `work` gives, which ends soon once the user wants to stop; a console is told how far it is.
    pub fn run_until_interrupted<T>(
        &self,
        console: &mut Console,
        work: impl FnOnce(&CancelToken<'_>) -> T,
    ) -> T {
        let ask = &mut move |share: Option<f64>| {
            if let Some(share) = share {
                console.progress(share, "");
            }
            !self.is_requested()
        };
        CancelToken::run_with_progress(ask, work)
    }

    /// The user wants to stop.
    pub fn request(&self) {
        self.0.is_requested.store(true, Ordering::SeqCst);
    }

    /// Whether the user wants to stop.
    pub fn is_requested(&self) -> bool {
        self.0.is_requested.load(Ordering::SeqCst)
    }
}

/// Ends the process with no file half written.
fn exit_now() -> ! {
    exit_without_unfinished(INTERRUPTED_EXIT_CODE.into())
}
