//! Surfaces with exact closest points.

use crate::geometry::{cross, dot, sub};

/// A point of a surface and the surface's unit normal there.
#[derive(Debug, Clone, Copy)]
pub(super) struct SurfacePoint {
    pub point: [f64; 3],
    pub normal: [f64; 3],
}

/// A plane wave of a sheet's height: `amplitude * sin(wave . (s, t) + phase)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wave {
    pub amplitude: f64,
    pub wave: [f64; 2],
    pub phase: f64,
}

/// The part of space in which a sheet exists: one side of another surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Termination {
    pub surface: usize,
    pub side: f64,
}

/// A rim inside the volume, at which a sheet has tapered to a tenth of its strength: an ellipse in the
/// sheet's plane coordinates about its centre.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rim {
    pub radii: [f64; 2],
    /// Over this many samples the strength falls from 1 inside of the rim to 0 outside.
    pub taper: f64,
}

impl Rim {
    /// How far inside the rim a place is, in samples (negative outside): exact on the rim, to first
    /// order next to it.
    fn distance_inside(&self, [s, t]: [f64; 2]) -> f64 {
        let [a, b] = self.radii;
        let level = (s / a).hypot(t / b);
        let slope = (s / (a * a)).hypot(t / (b * b));
        if slope > 0.0 {
            (1.0 - level) * level / slope
        } else {
            a.min(b)
        }
    }

    /// Strength there, from 1 well inside to 0 well outside, smooth (cubic) in between.
    pub fn strength(&self, at: [f64; 2]) -> f64 {
        // A fifth of the way the cubic is a tenth high.
        let u = (0.2 + self.distance_inside(at) / self.taper).clamp(0.0, 1.0);
        u * u * (3.0 - 2.0 * u)
    }

    /// The angle along the rim of the place where rays from the centre through `at` meet it.
    fn angle(&self, [s, t]: [f64; 2]) -> f64 {
        (t / self.radii[1]).atan2(s / self.radii[0])
    }

    fn point_at(&self, angle: f64) -> [f64; 2] {
        [self.radii[0] * angle.cos(), self.radii[1] * angle.sin()]
    }
}

#[derive(Debug, Clone)]
enum SurfaceShape {
    /// `u = height(s, t) - height(0, 0)` with (u, s, t) the coordinates along `frame`, whose rows
    /// are orthonormal.
    Sheet {
        centre: [f64; 3],
        frame: [[f64; 3]; 3],
        waves: Vec<Wave>,
        base_height: f64,
    },
    /// A sphere.
    Ball { centre: [f64; 3], radius: f64 },
}

/// The zero set of a smooth function, its *level*.
#[derive(Debug, Clone)]
pub(super) struct ImplicitSurface {
    shape: SurfaceShape,
    /// Upper bound of the level's gradient: |level| / steepness never exceeds the distance.
    pub max_gradient: f64,
    /// Where the surface ends, if it does not go through the whole volume.
    pub end: Option<Termination>,
    /// Where it tapers out, if it does. Only sheets do.
    pub rim: Option<Rim>,
}

/// The unit vector along `v`; that of x for zero.
fn unit_vector(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    if length > 0.0 {
        v.map(|c| c / length)
    } else {
        [1.0, 0.0, 0.0]
    }
}

/// Height, gradient and second derivatives (ss, st, tt).
fn height(waves: &[Wave], s: f64, t: f64) -> (f64, [f64; 2], [f64; 3]) {
    let (mut h, mut g, mut k) = (0.0, [0.0; 2], [0.0; 3]);
    for w in waves {
        let [p, q] = w.wave;
        let (sin, cos) = (p * s + q * t + w.phase).sin_cos();
        let (value, slope) = (w.amplitude * sin, w.amplitude * cos);
        h += value;
        g[0] += slope * p;
        g[1] += slope * q;
        k[0] -= value * p * p;
        k[1] -= value * p * q;
        k[2] -= value * q * q;
    }
    (h, g, k)
}

impl ImplicitSurface {
    /// A sheet through `centre`, normal to `normal` but for its waves.
    pub(super) fn sheet(centre: [f64; 3], normal: [f64; 3], waves: Vec<Wave>) -> Self {
        let n = unit_vector(normal);
        // Any direction not along the normal spans the rest of the frame.
        let k = (0..3).fold(
            0,
            |best, k| if n[k].abs() < n[best].abs() { k } else { best },
        );
        let mut other = [0.0; 3];
        other[k] = 1.0;
        let s = unit_vector(cross(n, other));
        let max_gradient = waves
            .iter()
            .map(|w| w.amplitude.abs() * w.wave[0].hypot(w.wave[1]))
            .sum::<f64>()
            .hypot(1.0);
        let base = height(&waves, 0.0, 0.0).0;
        let shape = SurfaceShape::Sheet {
            centre,
            frame: [n, s, cross(n, s)],
            waves,
            base_height: base,
        };
        Self {
            shape,
            max_gradient,
            end: None,
            rim: None,
        }
    }

    /// A sphere.
    pub(super) fn ball(centre: [f64; 3], radius: f64) -> Self {
        Self {
            shape: SurfaceShape::Ball { centre, radius },
            max_gradient: 1.0,
            end: None,
            rim: None,
        }
    }

    /// The function whose zero set is the surface (ignoring its end).
    pub(super) fn level(&self, p: [f64; 3]) -> f64 {
        match &self.shape {
            SurfaceShape::Sheet {
                centre,
                frame,
                waves,
                base_height: base,
            } => {
                let [u, s, t] = frame.map(|axis| dot(axis, sub(p, *centre)));
                u - height(waves, s, t).0 + base
            }
            SurfaceShape::Ball { centre, radius } => {
                let r = sub(p, *centre);
                dot(r, r).sqrt() - radius
            }
        }
    }

    /// The closest point of the surface (ignoring its end). For a sheet: Newton's method on the
    /// two coordinates in the sheet, which finds the global minimum for any point closer than the
    /// smallest radius of curvature.
    pub(super) fn closest_point(&self, p: [f64; 3]) -> SurfacePoint {
        match &self.shape {
            SurfaceShape::Sheet {
                centre,
                frame,
                waves,
                base_height: base,
            } => {
                let [u, s, t] = frame.map(|axis| dot(axis, sub(p, *centre)));
                let (mut a, mut b) = (s, t);
                let (mut h, mut g, mut k) = height(waves, a, b);
                for _ in 0..20 {
                    let gap = h - base - u;
                    let r = [a - s + gap * g[0], b - t + gap * g[1]];
                    let m = [
                        1.0 + g[0] * g[0] + gap * k[0],
                        g[0] * g[1] + gap * k[1],
                        1.0 + g[1] * g[1] + gap * k[2],
                    ];
                    let det = m[0] * m[2] - m[1] * m[1];
                    let step = [
                        (m[2] * r[0] - m[1] * r[1]) / det,
                        (m[0] * r[1] - m[1] * r[0]) / det,
                    ];
                    a -= step[0];
                    b -= step[1];
                    (h, g, k) = height(waves, a, b);
                    // Convergence is quadratic: the error left is of the order of 1e-10.
                    if step[0] * step[0] + step[1] * step[1] < 1e-9 {
                        break;
                    }
                }
                self.point_at([a, b])
            }
            SurfaceShape::Ball { centre, radius } => {
                let normal = unit_vector(sub(p, *centre));
                SurfacePoint {
                    point: std::array::from_fn(|c| centre[c] + radius * normal[c]),
                    normal,
                }
            }
        }
    }

    /// A sheet's plane coordinates of a place.
    pub(super) fn plane_coordinates(&self, p: [f64; 3]) -> [f64; 2] {
        match &self.shape {
            SurfaceShape::Sheet { centre, frame, .. } => {
                [1, 2].map(|k: usize| dot(frame[k], sub(p, *centre)))
            }
            SurfaceShape::Ball { .. } => [0.0; 2],
        }
    }

    /// The point of a sheet at plane coordinates, and its normal there.
    pub(super) fn point_at(&self, [s, t]: [f64; 2]) -> SurfacePoint {
        match &self.shape {
            SurfaceShape::Sheet {
                centre,
                frame,
                waves,
                base_height: base,
            } => {
                let (h, g, _) = height(waves, s, t);
                let world = |v: [f64; 3]| -> [f64; 3] {
                    std::array::from_fn(|c| (0..3).map(|k| v[k] * frame[k][c]).sum())
                };
                let offset = world([h - base, s, t]);
                SurfacePoint {
                    point: std::array::from_fn(|c| centre[c] + offset[c]),
                    normal: world(unit_vector([1.0, -g[0], -g[1]])),
                }
            }
            SurfaceShape::Ball { centre, radius } => SurfacePoint {
                point: [centre[0] + radius, centre[1], centre[2]],
                normal: [1.0, 0.0, 0.0],
            },
        }
    }

    /// Whether it exists at a point of it: on its side of the one of `all` at which it ends.
    pub(super) fn exists_at<'a>(
        &self,
        all: impl Fn(usize) -> &'a ImplicitSurface,
        at: [f64; 3],
    ) -> bool {
        self.end
            .is_none_or(|end| all(end.surface).level(at) * end.side >= 0.0)
    }

    /// Strength of a sheet's ridge or likelihood near a place: 1, but for its rim.
    pub(super) fn strength(&self, p: [f64; 3]) -> f64 {
        self.rim
            .map_or(1.0, |rim| rim.strength(self.plane_coordinates(p)))
    }

    /// The normal of a sheet without its waves; x of a ball.
    pub(super) fn mean_normal(&self) -> [f64; 3] {
        match &self.shape {
            SurfaceShape::Sheet { frame, .. } => frame[0],
            SurfaceShape::Ball { .. } => [1.0, 0.0, 0.0],
        }
    }

    /// The share of its throw by which a fault displaces a place: 1, but within a rim it falls as an ellipse
    /// does from the middle outwards, and away from the sheet over the lesser radius.
    pub(super) fn throw_share(&self, p: [f64; 3]) -> f64 {
        self.rim.map_or(1.0, |rim| {
            let [s, t] = self.plane_coordinates(p);
            let [a, b] = rim.radii;
            let inside = 1.0 - (s / a).powi(2) - (t / b).powi(2);
            let near = 1.0 - (self.level(p) / a.min(b)).powi(2);
            inside.max(0.0).sqrt() * near.max(0.0).powi(2)
        })
    }

    /// The closest point inside the rim, if there is one; on the rim the normal is still the sheet's.
    pub(super) fn closest_point_in_rim(&self, p: [f64; 3]) -> SurfacePoint {
        let foot = self.closest_point(p);
        let Some(rim) = self.rim else { return foot };
        let at = self.plane_coordinates(foot.point);
        if rim.distance_inside(at) >= 0.0 {
            return foot;
        }
        // Along the rim, from where the ray through the foot meets it, by golden sections: the rim is
        // wide against its distance, so the minimum near there is the only one.
        let square = |angle: f64| {
            let r = sub(self.point_at(rim.point_at(angle)).point, p);
            dot(r, r)
        };
        let middle = rim.angle(at);
        let (mut low, mut high) = (middle - 0.6, middle + 0.6);
        let golden = 0.618_033_988_749_895;
        for _ in 0..40 {
            let (a, b) = (high - golden * (high - low), low + golden * (high - low));
            if square(a) < square(b) {
                high = b;
            } else {
                low = a;
            }
        }
        self.point_at(rim.point_at(0.5 * (low + high)))
    }

    /// Unit gradient of the level.
    pub(super) fn unit_gradient(&self, p: [f64; 3]) -> [f64; 3] {
        match &self.shape {
            SurfaceShape::Sheet {
                centre,
                frame,
                waves,
                ..
            } => {
                let [_, s, t] = frame.map(|axis| dot(axis, sub(p, *centre)));
                let (_, g, _) = height(waves, s, t);
                unit_vector(std::array::from_fn(|c| {
                    frame[0][c] - g[0] * frame[1][c] - g[1] * frame[2][c]
                }))
            }
            SurfaceShape::Ball { centre, .. } => unit_vector(sub(p, *centre)),
        }
    }
}
