//! The progress of a verb as events.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

use atomesh::progress::{OptimiseStatus, Progress, SizeEstimate, Stage};

/// An event while a verb runs.
pub enum Event {
    Stage(String),
    Progress(f64, String),
    Note(String),
    /// A line that is shown next to the progress.
    Line(String),
}

/// Sends the progress of a verb as events to a thread that may no longer receive them, and stops the
/// verb when it is asked to.
pub struct EventProgress {
    pub events: Sender<Event>,
    pub is_stopped: Arc<AtomicBool>,
}

impl EventProgress {
    fn send(&self, event: Event) {
        let _ = self.events.send(event);
    }
}

impl Progress for EventProgress {
    fn stage(&mut self, stage: Stage) {
        self.send(Event::Stage(stage.to_string()));
    }

    fn note(&mut self, line: &str) {
        self.send(Event::Note(line.to_string()));
    }

    fn estimate(&mut self, estimate: &SizeEstimate) {
        self.send(Event::Line(estimate.to_string()));
    }

    fn optimise_step(&mut self, status: &OptimiseStatus) {
        self.send(Event::Progress(status.fraction(), status.to_string()));
    }

    fn fraction_done(&mut self, fraction: f64) {
        self.send(Event::Progress(fraction, String::new()));
    }

    fn keep_going(&mut self) -> bool {
        !self.is_stopped.load(Ordering::SeqCst)
    }
}
