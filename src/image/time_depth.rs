//! Depth as a function of two-way time at one position, and its inverse.
//!
//! Depth is the integral of v/2 over two-way time, from time 0. The velocity is linear between
//! samples, so depth is quadratic there. Both directions are computed exactly.

/// Depth below one position as a function of two-way time in seconds, and its inverse.
#[derive(Debug, Clone)]
pub struct TimeDepthCurve {
    /// Time of the first velocity, in seconds.
    first_time: f64,
    /// Time from one velocity to the next, in seconds; positive.
    time_step: f64,
    velocities: Vec<f64>,
    /// Depth of each velocity sample below the first one.
    depths: Vec<f64>,
    /// Depth of time 0 below the first velocity sample.
    depth_at_zero: f64,
}

impl TimeDepthCurve {
    /// Creates the curve from velocities in m/s at times `first + i * step` in seconds. There must
    /// be at least one velocity. The step may be negative.
    pub fn new(first: f64, step: f64, mut velocity: Vec<f64>) -> Self {
        let mut curve = Self {
            first_time: first,
            time_step: step.abs(),
            depths: Vec::with_capacity(velocity.len()),
            velocities: Vec::new(),
            depth_at_zero: 0.0,
        };
        if step < 0.0 {
            velocity.reverse();
            curve.first_time += step * (velocity.len() - 1) as f64;
        }
        let mut sum = 0.0;
        for (i, v) in velocity.iter().enumerate() {
            if i > 0 {
                sum += 0.25 * curve.time_step * (velocity[i - 1] + v);
            }
            curve.depths.push(sum);
        }
        curve.velocities = velocity;
        curve.depth_at_zero = curve.depth_below_first(0.0);
        curve
    }

    /// Returns the depth at a time.
    pub fn depth(&self, time: f64) -> f64 {
        self.depth_below_first(time) - self.depth_at_zero
    }

    fn depth_below_first(&self, time: f64) -> f64 {
        let (v, z) = (&self.velocities, &self.depths);
        let last = v.len() - 1;
        let position = (time - self.first_time) / self.time_step;
        if position <= 0.0 || last == 0 {
            return 0.5 * v[0] * (time - self.first_time);
        }
        if position >= last as f64 {
            return z[last] + 0.5 * v[last] * self.time_step * (position - last as f64);
        }
        let i = (position as usize).min(last - 1);
        let s = position - i as f64;
        z[i] + 0.5 * self.time_step * s * (v[i] + 0.5 * s * (v[i + 1] - v[i]))
    }

    /// Returns the time at a depth.
    pub fn time(&self, depth: f64) -> f64 {
        let (v, z) = (&self.velocities, &self.depths);
        let last = v.len() - 1;
        let below = depth + self.depth_at_zero;
        if below <= 0.0 || last == 0 {
            return self.first_time + 2.0 * below / v[0];
        }
        if below >= z[last] {
            let last_time = self.first_time + self.time_step * last as f64;
            return last_time + 2.0 * (below - z[last]) / v[last];
        }
        let i = z.partition_point(|z| *z <= below).clamp(1, last) - 1;
        // The root s of v s + dv s^2 / 2 = rest that lies between the two samples.
        let rest = 2.0 * (below - z[i]) / self.time_step;
        let change = v[i + 1] - v[i];
        let root = (v[i] * v[i] + 2.0 * change * rest).max(0.0).sqrt();
        self.first_time + self.time_step * (i as f64 + 2.0 * rest / (v[i] + root))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_in_a_linear_velocity_is_its_integral_and_back() {
        // v = v0 + k t, so z = v0 t / 2 + k t^2 / 4. The velocities are sampled at times that
        // differ from t.
        let (v0, k) = (1800.0, 700.0);
        let depth = |t: f64| v0 * t / 2.0 + k * t * t / 4.0;
        for (first, step) in [(0.0, 0.25), (4.0, -0.25), (-1.0, 0.3)] {
            let v: Vec<f64> = (0..17)
                .map(|i| v0 + k * (first + step * f64::from(i)))
                .collect();
            let curve = TimeDepthCurve::new(first, step, v);
            for i in 0..=1000 {
                let t = 3.6 * f64::from(i) / 1000.0;
                assert!((curve.depth(t) - depth(t)).abs() < 1e-9, "{t}");
                assert!((curve.time(depth(t)) - t).abs() < 1e-12, "{t}");
            }
        }
    }

    #[test]
    fn beyond_the_samples_velocities_are_those_of_the_nearest() {
        let curve = TimeDepthCurve::new(1.0, 0.5, vec![2000.0, 3000.0]);
        assert_eq!([0.0, 1.0].map(|t| curve.depth(t)), [0.0, 1000.0]);
        assert!((curve.depth(1.5) - 1625.0).abs() < 1e-9);
        assert!((curve.depth(2.5) - 3125.0).abs() < 1e-9);
        for t in [-0.5, 0.3, 1.1, 1.5, 4.0] {
            assert!((curve.time(curve.depth(t)) - t).abs() < 1e-12, "{t}");
        }
        let constant = TimeDepthCurve::new(7.0, 1.0, vec![2000.0]);
        assert!(
            (constant.depth(3.0) - 3000.0).abs() < 1e-9
                && (constant.time(-5.0) + 0.005).abs() < 1e-12
        );
    }
}
