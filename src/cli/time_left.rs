//! How far a job is, and how much longer it takes at most.
//!
//! Stages that have begun tell how long others may take: joining atoms, removing slivers and measuring are
//! work on the atoms that were placed and moved before. Until these are, nothing is known of the time left,
//! and none is given. A bound that was given once only comes nearer.

/// A stage of a mesh job: its name, its usual share of the work, and the longest that it was seen to take in
/// units of the time in which atoms were placed and moved. It is `None` for that time itself and for what
/// comes before it.
struct StageEstimate {
    name: &'static str,
    share: f64,
    max_ratio: Option<f64>,
}

const fn stage(name: &'static str, share: f64, longest: Option<f64>) -> StageEstimate {
    StageEstimate {
        name,
        share,
        max_ratio: longest,
    }
}

/// Measured on images of ridges, edges, labels, faults and horizons of 80 to 200 samples a side; the longest
/// times are twice those that were seen. Stages that few jobs have are not shares of others.
const STAGES: [StageEstimate; 11] = [
    stage("reading", 0.02, None),
    stage("finding features", 0.43, None),
    stage("placing atoms", 0.04, None),
    stage("moving atoms onto features", 0.15, None),
    stage("joining atoms", 0.03, Some(1.0)),
    stage("smoothing", 0.0, Some(1.0)),
    stage("removing slivers", 0.27, Some(10.0)),
    stage("putting sites beside features", 0.0, Some(4.0)),
    stage("cutting cells", 0.0, Some(15.0)),
    stage("measuring the mesh", 0.04, Some(2.0)),
    stage("writing", 0.02, Some(1.0)),
];

/// Stages that only Voronoi cells have, and one that only some triangles have: others do not wait for them.
const OPTIONAL_STAGES: [&str; 3] = [
    "smoothing",
    "putting sites beside features",
    "cutting cells",
];

/// The place of the first stage in which atoms are placed or moved, and of the one in which they are moved.
const PLACING_STAGE: usize = 2;
const MOVING_STAGE: usize = 3;

/// What is left of a stage may take longer than its share says, by this factor.
const SLOWDOWN_FACTOR: f64 = 2.0;

/// Smaller shares of a stage tell nothing of the rest.
const MIN_SHARE: f64 = 0.3;

/// How far a job is. Times are in seconds since it began.
#[derive(Debug, Clone, Default)]
pub struct TimeLeft {
    /// The stage at work, and when it began.
    stage: usize,
    stage_start: f64,
    /// How long each stage before it took.
    stage_seconds: [f64; STAGES.len()],
    /// The share of the job that was shown last.
    shown_share: f64,
    /// When the job ends at the latest.
    latest_end: Option<f64>,
}

impl TimeLeft {
    /// Returns the job as it stands when the stage of this name begins first; `None` if no mesh job has it.
    pub fn new(name: &str) -> Option<Self> {
        let stage = stage_index(name)?;
        Some(Self {
            stage,
            ..Self::default()
        })
    }

    /// Begins the next stage at `now`; returns `false` if this job has none of that name any more.
    pub fn begin_stage(&mut self, name: &str, now: f64) -> bool {
        let Some(stage) = stage_index(name).filter(|&stage| stage >= self.stage) else {
            return false;
        };
        self.stage_seconds[self.stage] += now - self.stage_start;
        (self.stage, self.stage_start) = (stage, now);
        self.update(0.0, now);
        true
    }

    /// Takes note that a share of the stage is done.
    pub fn update(&mut self, share: f64, now: f64) {
        let share = share.clamp(0.0, 1.0);
        let before: f64 = STAGES[..self.stage].iter().map(|stage| stage.share).sum();
        self.shown_share = self
            .shown_share
            .max(before + share * STAGES[self.stage].share);
        if let Some(left) = self.max_seconds_left(share, now) {
            let end = now + left;
            self.latest_end = Some(self.latest_end.map_or(end, |before| before.min(end)));
        }
    }

    /// Returns the share of the job that is done.
    pub fn share_done(&self) -> f64 {
        self.shown_share
    }

    /// Returns how many seconds the job takes from `now` on at most, as soon as that is known.
    pub fn seconds_left(&self, now: f64) -> Option<f64> {
        self.latest_end.map(|end| (end - now).max(0.0))
    }

    /// Returns how long all that is left takes at most.
    fn max_seconds_left(&self, share: f64, now: f64) -> Option<f64> {
        let elapsed = now - self.stage_start;
        let of_this = (share >= MIN_SHARE).then(|| SLOWDOWN_FACTOR * elapsed * (1.0 / share - 1.0));
        let atoms: f64 = self.stage_seconds[PLACING_STAGE..=MOVING_STAGE]
            .iter()
            .sum();
        let atoms = match self.stage {
            ..MOVING_STAGE => return None,
            MOVING_STAGE => atoms + elapsed + of_this?,
            _ => atoms,
        };
        let this = match STAGES[self.stage].max_ratio {
            None => of_this?,
            Some(longest) => of_this.unwrap_or((longest * atoms - elapsed).max(0.0)),
        };
        let expected = |stage: &&StageEstimate| !OPTIONAL_STAGES.contains(&stage.name);
        let later = STAGES[self.stage + 1..].iter().filter(expected);
        let later: f64 = later.filter_map(|stage| stage.max_ratio).sum();
        Some(this + later * atoms)
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
    fn stages_are_those_of_jobs() {
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
        for (stage, known) in stages.iter().zip(&STAGES) {
            assert_eq!(stage.to_string(), known.name);
        }
        let all: f64 = STAGES.iter().map(|stage| stage.share).sum();
        assert!((all - 1.0).abs() < 1e-9, "{all}");
    }

    /// Seconds of the stages of jobs, as measured: ridges, edges, labels, horizons, faults.
    const MEASURED_SECONDS: [[f64; 8]; 6] = [
        [0.01, 1.18, 0.12, 0.43, 0.05, 0.69, 0.04, 0.03],
        [0.01, 1.12, 0.01, 0.16, 0.10, 0.31, 0.06, 0.03],
        [0.01, 0.10, 0.01, 0.21, 0.10, 0.46, 0.06, 0.03],
        [0.01, 0.09, 0.09, 0.29, 0.03, 0.76, 0.10, 0.02],
        [0.01, 0.37, 0.12, 0.39, 0.06, 2.02, 0.10, 0.03],
        [0.01, 2.35, 0.12, 0.42, 0.06, 1.16, 0.07, 0.02],
    ];

    #[test]
    fn time_left_is_a_bound_that_holds() {
        let tetrahedra: Vec<&StageEstimate> = STAGES
            .iter()
            .filter(|stage| !OPTIONAL_STAGES.contains(&stage.name))
            .collect();
        // Work may come evenly, late in a stage, or early.
        for power in [1.0, 1.5, 0.7] {
            for seconds in MEASURED_SECONDS {
                let total: f64 = seconds.iter().sum();
                let mut job = TimeLeft::new("reading").unwrap();
                let (mut now, mut before, mut given, mut last) = (0.0, 0.0, 0, f64::INFINITY);
                for (stage, seconds) in tetrahedra.iter().zip(seconds) {
                    assert!(stage.name == "reading" || job.begin_stage(stage.name, now));
                    for step in 0..=50 {
                        let at = f64::from(step) / 50.0;
                        job.update(at.powf(power), now + at * seconds);
                        assert!(job.share_done() >= before && job.share_done() <= 1.0);
                        before = job.share_done();
                        if let Some(left) = job.seconds_left(now + at * seconds) {
                            let true_left = total - now - at * seconds;
                            assert!(left >= true_left - 1e-9, "{power} {left} {true_left}");
                            assert!(now + at * seconds + left <= last + 1e-9, "it moves away");
                            last = now + at * seconds + left;
                            given += 1;
                        }
                    }
                    now += seconds;
                }
                assert!(given > 150, "{given}");
                assert!(before > 0.99);
            }
        }
    }

    #[test]
    fn other_work_is_no_stage_of_a_mesh_job() {
        assert!(TimeLeft::new("grouping faces").is_none());
        let mut job = TimeLeft::new("measuring the mesh").unwrap();
        assert!(!job.begin_stage("finding features", 1.0));
        assert!(job.begin_stage("writing", 1.0));
        assert_eq!(job.seconds_left(2.0), Some(0.0));
    }
}
