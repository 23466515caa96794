//! The progress of a mesh job, and an upper bound of its time left.
//!
//! The duration of finished stages bounds that of later ones: the work of joining atoms, removing
//! slivers and measuring depends on the atoms that were placed and moved before. Until the atoms
//! have been placed and moved, no bound is given. A bound that was given never grows: the end of
//! the job that it predicts only moves closer.

/// A stage of a mesh job: its name, its usual share of the work, and the largest ratio of its
/// duration to that of placing and moving atoms. The ratio is `None` for these two stages and for
/// those before them.
struct StageEstimate {
    name: &'static str,
    share: f64,
    max_ratio: Option<f64>,
}

const fn stage(name: &'static str, share: f64, max_ratio: Option<f64>) -> StageEstimate {
    StageEstimate {
        name,
        share,
        max_ratio,
    }
}

/// The stages of mesh jobs, measured on images of ridges, edges, labels, faults and horizons of 80
/// to 200 samples a side. The largest ratios are twice the measured ones. Stages that few jobs
/// have, have a share of 0.
const STAGES: [StageEstimate; 11] = [
    stage("reading", 0.02, None),
    stage("finding features", 0.43, None),
    stage("placing atoms", 0.04, None),
    stage("moving atoms onto features", 0.15, None),
    stage("joining atoms", 0.03, Some(1.0)),
    stage("smoothing", 0.0, Some(1.0)),
    stage("removing slivers", 0.27, Some(10.0)),
    stage("placing sites along features", 0.0, Some(4.0)),
    stage("cutting cells", 0.0, Some(15.0)),
    stage("measuring the mesh", 0.04, Some(2.0)),
    stage("writing", 0.02, Some(1.0)),
];

/// Stages that only Voronoi cells, or only some triangles, have. The bound of a job does not
/// include them until they begin.
const OPTIONAL_STAGES: [&str; 3] = ["smoothing", "placing sites along features", "cutting cells"];

/// Index of the stage in which atoms are placed, and of the one in which they move.
const PLACING_STAGE: usize = 2;
const MOVING_STAGE: usize = 3;

/// Factor by which the rest of a stage may take longer than its finished part suggests.
const SLOWDOWN_FACTOR: f64 = 2.0;

/// Smallest finished fraction of a stage from which the duration of its rest can be estimated.
const MIN_SHARE: f64 = 0.3;

/// The progress of a job. Times are in seconds since the job began.
#[derive(Debug, Clone, Default)]
pub struct TimeLeft {
    /// Index of the current stage, and its start time.
    stage: usize,
    stage_start: f64,
    /// Durations of the finished stages.
    stage_seconds: [f64; STAGES.len()],
    /// The fraction of the job that was shown last.
    shown_share: f64,
    /// Latest time at which the job ends, if it is known.
    latest_end: Option<f64>,
}

impl TimeLeft {
    /// Returns the progress of a job whose first stage has this name; `None` if no mesh job has
    /// such a stage.
    pub fn new(name: &str) -> Option<Self> {
        let stage = stage_index(name)?;
        Some(Self {
            stage,
            ..Self::default()
        })
    }

    /// Begins the next stage at `now`. Returns `false` if no later stage of the job has this name.
    pub fn begin_stage(&mut self, name: &str, now: f64) -> bool {
        let Some(stage) = stage_index(name).filter(|&stage| stage >= self.stage) else {
            return false;
        };
        self.stage_seconds[self.stage] += now - self.stage_start;
        (self.stage, self.stage_start) = (stage, now);
        self.update(0.0, now);
        true
    }

    /// Records that a fraction of the stage is done.
    pub fn update(&mut self, share: f64, now: f64) {
        let share = share.clamp(0.0, 1.0);
        let previous: f64 = STAGES[..self.stage].iter().map(|stage| stage.share).sum();
        self.shown_share = self
            .shown_share
            .max(previous + share * STAGES[self.stage].share);
        if let Some(left) = self.max_seconds_left(share, now) {
            let end = now + left;
            self.latest_end = Some(self.latest_end.map_or(end, |latest| latest.min(end)));
        }
    }

    /// Returns the fraction of the job that is done.
    pub fn share_done(&self) -> f64 {
        self.shown_share
    }

    /// Returns an upper bound of the seconds that the job takes from `now`, as soon as it is known.
    pub fn seconds_left(&self, now: f64) -> Option<f64> {
        self.latest_end.map(|end| (end - now).max(0.0))
    }

    /// Returns an upper bound of the seconds that the rest of the job takes.
    fn max_seconds_left(&self, share: f64, now: f64) -> Option<f64> {
        let elapsed = now - self.stage_start;
        let stage_left =
            (share >= MIN_SHARE).then(|| SLOWDOWN_FACTOR * elapsed * (1.0 / share - 1.0));
        let atom_seconds: f64 = self.stage_seconds[PLACING_STAGE..=MOVING_STAGE]
            .iter()
            .sum();
        let atom_seconds = match self.stage {
            ..MOVING_STAGE => return None,
            MOVING_STAGE => atom_seconds + elapsed + stage_left?,
            _ => atom_seconds,
        };
        let current = match STAGES[self.stage].max_ratio {
            None => stage_left?,
            Some(ratio) => stage_left.unwrap_or((ratio * atom_seconds - elapsed).max(0.0)),
        };
        let is_expected = |stage: &&StageEstimate| !OPTIONAL_STAGES.contains(&stage.name);
        let later = STAGES[self.stage + 1..].iter().filter(is_expected);
        let later_ratio: f64 = later.filter_map(|stage| stage.max_ratio).sum();
        Some(current + later_ratio * atom_seconds)
    }
}

fn stage_index(name: &str) -> Option<usize> {
    STAGES.iter().position(|stage| stage.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Stage;

    #[test]
    fn stages_have_the_names_of_progress_stages() {
        let stages = [
            Stage::Reading,
            Stage::Features,
            Stage::Placing,
            Stage::Optimising,
            Stage::Triangulating,
            Stage::Smoothing,
            Stage::Improving,
            Stage::Conforming,
            Stage::Cutting,
            Stage::Measuring,
            Stage::Writing,
        ];
        for (stage, expected) in stages.iter().zip(&STAGES) {
            assert_eq!(stage.to_string(), expected.name);
        }
        let total: f64 = STAGES.iter().map(|stage| stage.share).sum();
        assert!((total - 1.0).abs() < 1e-9, "{total}");
    }

    /// Measured seconds of the stages of jobs: ridges, edges, labels, horizons, faults.
    const MEASURED_SECONDS: [[f64; 8]; 6] = [
        [0.01, 1.18, 0.12, 0.43, 0.05, 0.69, 0.04, 0.03],
        [0.01, 1.12, 0.01, 0.16, 0.10, 0.31, 0.06, 0.03],
        [0.01, 0.10, 0.01, 0.21, 0.10, 0.46, 0.06, 0.03],
        [0.01, 0.09, 0.09, 0.29, 0.03, 0.76, 0.10, 0.02],
        [0.01, 0.37, 0.12, 0.39, 0.06, 2.02, 0.10, 0.03],
        [0.01, 2.35, 0.12, 0.42, 0.06, 1.16, 0.07, 0.02],
    ];

    #[test]
    fn time_left_is_an_upper_bound() {
        let tetrahedra: Vec<&StageEstimate> = STAGES
            .iter()
            .filter(|stage| !OPTIONAL_STAGES.contains(&stage.name))
            .collect();
        // The work of a stage may be done evenly, mostly late, or mostly early.
        for power in [1.0, 1.5, 0.7] {
            for seconds in MEASURED_SECONDS {
                let total: f64 = seconds.iter().sum();
                let mut job = TimeLeft::new("reading").unwrap();
                let (mut now, mut shown, mut bounds, mut latest) = (0.0, 0.0, 0, f64::INFINITY);
                for (stage, seconds) in tetrahedra.iter().zip(seconds) {
                    assert!(stage.name == "reading" || job.begin_stage(stage.name, now));
                    for step in 0..=50 {
                        let fraction = f64::from(step) / 50.0;
                        job.update(fraction.powf(power), now + fraction * seconds);
                        assert!(job.share_done() >= shown && job.share_done() <= 1.0);
                        shown = job.share_done();
                        if let Some(left) = job.seconds_left(now + fraction * seconds) {
                            let true_left = total - now - fraction * seconds;
                            assert!(left >= true_left - 1e-9, "{power} {left} {true_left}");
                            assert!(
                                now + fraction * seconds + left <= latest + 1e-9,
                                "it moves away"
                            );
                            latest = now + fraction * seconds + left;
                            bounds += 1;
                        }
                    }
                    now += seconds;
                }
                assert!(bounds > 150, "{bounds}");
                assert!(shown > 0.99);
            }
        }
    }

    #[test]
    fn other_work_is_not_a_stage_of_a_mesh_job() {
        assert!(TimeLeft::new("grouping faces").is_none());
        let mut job = TimeLeft::new("measuring the mesh").unwrap();
        assert!(!job.begin_stage("finding features", 1.0));
        assert!(job.begin_stage("writing", 1.0));
        assert_eq!(job.seconds_left(2.0), Some(0.0));
    }
}
