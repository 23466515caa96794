//! Measures the cost of each stage: seconds, processor seconds, memory.

use std::time::Instant;

use serde::Serialize;

use super::Stage;

/// Cost of one stage of a job.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageCost {
    /// Stage.
    pub stage: Stage,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// User-mode processor seconds of all threads, with a resolution of 0.01 s.
    pub cpu_seconds: f64,
    /// Peak memory of the process and its helper processes up to the end of the stage, in MB (10^6
    /// bytes). 0 if the system does not report it.
    pub peak_mb: f64,
}

/// Clock that measures stages one after the other.
#[derive(Debug)]
pub struct Clock {
    start: Instant,
    cpu_start: f64,
    current: Option<Stage>,
    finished_stages: Vec<StageCost>,
}

impl Clock {
    /// Creates a clock that measures nothing yet.
    pub fn new() -> Self {
        Self {
            start: Instant::now(),
            cpu_start: 0.0,
            current: None,
            finished_stages: Vec::new(),
        }
    }

    /// Ends the current stage, if there is one, and begins another.
    pub fn begin(&mut self, stage: Stage) {
        self.end();
        self.current = Some(stage);
        self.start = Instant::now();
        self.cpu_start = cpu_seconds();
    }

    /// Ends the current stage.
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

    /// Returns the costs of all stages that have ended.
    pub fn costs(&self) -> &[StageCost] {
        &self.finished_stages
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::new()
    }
}

/// Returns the user-mode processor seconds of this process, and of its helper processes that have
/// ended. Returns 0 if the system does not report them. Linux counts in ticks, 100 per second for
/// programs on every architecture.
pub fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The process name in parentheses may contain spaces. utime is the 12th field after it, cutime
    // the 14th.
    let fields = stat
        .rsplit(')')
        .next()
        .unwrap_or_default()
        .split_whitespace();
    let ticks = fields
        .enumerate()
        .filter(|(index, _)| [11, 13].contains(index));
    ticks
        .filter_map(|(_, word)| word.parse::<f64>().ok())
        .sum::<f64>()
        / 100.0
}

/// Returns the peak resident memory of this process so far, in MB. Returns 0 if the system does not report it.
pub fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|value| value.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.unwrap_or(0.0) * 1024.0 / 1e6
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn work_and_memory_are_seen() {
        let mut clock = Clock::new();
        clock.begin(Stage::Features);
        // Works until processor time has passed, however busy the machine is, but for 20 s at most.
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
