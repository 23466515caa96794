//! What a stage costs: seconds, processor seconds, memory.

use std::time::Instant;

use serde::Serialize;

use crate::progress::Stage;

/// The cost of one stage of a job.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageCost {
    /// The stage.
    pub stage: Stage,
    /// Seconds by the clock.
    pub seconds: f64,
    /// Seconds of processor time in user mode, over all threads; to a hundredth.
    pub cpu_seconds: f64,
    /// Largest memory of the process, with the processes that work for it, up to the stage's end, in MB (10^6 bytes); 0 where the system
    /// does not tell.
    pub peak_mb: f64,
}

/// Measures stages one after the other.
#[derive(Debug)]
pub struct Clock {
    start: Instant,
    cpu_start: f64,
    current: Option<Stage>,
    finished_stages: Vec<StageCost>,
}

impl Clock {
    /// A clock that measures nothing yet.
    pub fn new() -> Self {
        Self {
            start: Instant::now(),
            cpu_start: 0.0,
            current: None,
            finished_stages: Vec::new(),
        }
    }

    /// Ends the stage that is being measured, if any, and begins another.
    pub fn begin(&mut self, stage: Stage) {
        self.end();
        self.current = Some(stage);
        self.start = Instant::now();
        self.cpu_start = cpu_seconds();
    }

    /// Ends the stage that is being measured.
    pub fn end(&mut self) {
        if let Some(stage) = self.current.take() {
            self.finished_stages.push(StageCost {
                stage,
                seconds: self.start.elapsed().as_secs_f64(),
                cpu_seconds: cpu_seconds() - self.cpu_start,
                peak_mb: peak_mb(),
            });
        }
    }

    /// All stages measured so far.
    pub fn costs(&self) -> &[StageCost] {
        &self.finished_stages
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::new()
    }
}

/// User-mode processor seconds of this process, and of those that worked for it and have ended, so far; 0 where the system does not tell. Linux
/// counts in ticks, of which it shows programs a hundred a second on every architecture.
pub fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name in parentheses may hold spaces; utime is the 12th field after it, cutime the 14th.
    let fields = stat
        .rsplit(')')
        .next()
        .unwrap_or_default()
        .split_whitespace();
    let ticks = fields.enumerate().filter(|(at, _)| [11, 13].contains(at));
    ticks
        .filter_map(|(_, word)| word.parse::<f64>().ok())
        .sum::<f64>()
        / 100.0
}

/// Largest resident memory of this process so far, with those that work for it, in MB; 0 where the system does not tell.
pub fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|rest| rest.split_whitespace().next()?.parse::<f64>().ok());
    let own = kilobytes.unwrap_or(0.0) * 1024.0 / 1e6;
    #[cfg(feature = "tetgen")]
    let own = own.max(crate::mesh::delaunay::peak_mb());
    own
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn work_and_memory_are_seen() {
        let mut clock = Clock::new();
        clock.begin(Stage::Features);
        // Until the processor has worked, however busy the machine is; but not for ever.
        let (start, cpu) = (Instant::now(), cpu_seconds());
        let mut memory = vec![0u8; 64 << 20];
        while cpu_seconds() < cpu + 0.05 && start.elapsed().as_secs() < 20 {
            for (k, byte) in memory.iter_mut().enumerate() {
                *byte = byte.wrapping_add(k as u8);
            }
        }
        std::hint::black_box(&memory);
        clock.begin(Stage::Placing);
        clock.end();
        let [busy, idle] = clock.costs() else {
            panic!("two stages")
        };
        assert!(busy.seconds > 0.0 && busy.cpu_seconds >= 0.049, "{busy:?}");
        assert!(
            busy.peak_mb > 64.0 && idle.peak_mb >= busy.peak_mb,
            "{busy:?} {idle:?}"
        );
    }
}
