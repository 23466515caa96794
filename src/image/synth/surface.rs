//! Implicit surfaces with exact closest points.

use crate::geometry::{cross, dot, hypot, sub};

/// A point of a surface, and the unit normal of the surface there.
#[derive(Debug, Clone, Copy)]
pub(super) struct SurfacePoint {
    pub point: [f64; 3],
    pub normal: [f64; 3],
}

/// A plane wave in the height of a sheet: `amplitude * sin(wave . (s, t) + phase)`.
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

/// A rim inside the volume, at which a sheet has tapered to a tenth of its strength: an ellipse
/// about the centre in the plane coordinates of the sheet.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rim {
    pub radii: [f64; 2],
    /// Distance, in samples, over which the strength falls from 1 inside the rim to 0 outside.
    pub taper: f64,
}

impl Rim {
    /// Returns the distance from a position to the rim, in samples, positive inside and negative
    /// outside. It is exact on the rim and correct to first order near it.
    fn distance_inside(&self, [s, t]: [f64; 2]) -> f64 {
        let [a, b] = self.radii;
        let level = hypot(s / a, t / b);
        let slope = hypot(s / (a * a), t / (b * b));
        if slope > 0.0 {
            (1.0 - level) * level / slope
        } else {
            a.min(b)
        }
    }

    /// Returns the strength at a position, from 1 well inside the rim to 0 well outside, with a
    /// smooth (cubic) transition.
    pub fn strength(&self, coordinates: [f64; 2]) -> f64 {
        // At a fifth of the transition the cubic is about a tenth.
        let u = (0.2 + self.distance_inside(coordinates) / self.taper).clamp(0.0, 1.0);
        u * u * (3.0 - 2.0 * u)
    }

    /// Returns the angle of the point of the rim on the ray from the centre through a position.
    fn angle(&self, [s, t]: [f64; 2]) -> f64 {
        (t / self.radii[1]).atan2(s / self.radii[0])
    }

    fn point_at(&self, angle: f64) -> [f64; 2] {
        [self.radii[0] * angle.cos(), self.radii[1] * angle.sin()]
    }
}

#[derive(Debug, Clone)]
enum SurfaceShape {
    /// `u = height(s, t) - height(0, 0)`, where (u, s, t) are the coordinates along `frame`, whose
    /// rows are orthonormal.
    Sheet {
        centre: [f64; 3],
        frame: [[f64; 3]; 3],
        waves: Vec<Wave>,
        base_height: f64,
    },
    /// A sphere.
    Ball { centre: [f64; 3], radius: f64 },
}

/// The zero set of a smooth function, the *level*.
#[derive(Debug, Clone)]
pub(super) struct ImplicitSurface {
    shape: SurfaceShape,
    /// Upper bound of the gradient of the level: |level| / max_gradient never exceeds the distance.
    pub max_gradient: f64,
    /// Other surface at which this one ends, if it does not extend through the whole volume.
    pub end: Option<Termination>,
    /// Rim at which the surface tapers out, if it does. Only sheets have one.
    pub rim: Option<Rim>,
}

/// Returns the unit vector along `v`, or that along x if `v` is zero.
fn unit_vector(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    if length > 0.0 {
        v.map(|c| c / length)
    } else {
        [1.0, 0.0, 0.0]
    }
}

/// Returns the height, its gradient, and its second derivatives (ss, st, tt).
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
    /// Creates a sheet through `centre` with mean normal `normal` and these waves.
    pub(super) fn sheet(centre: [f64; 3], normal: [f64; 3], waves: Vec<Wave>) -> Self {
        let n = unit_vector(normal);
        // Any direction that is not along the normal completes the frame.
        let k = (0..3).fold(
            0,
            |best, k| if n[k].abs() < n[best].abs() { k } else { best },
        );
        let mut other = [0.0; 3];
        other[k] = 1.0;
        let s = unit_vector(cross(n, other));
        let max_rise = waves
            .iter()
            .map(|w| w.amplitude.abs() * hypot(w.wave[0], w.wave[1]))
            .sum::<f64>();
        let max_gradient = hypot(max_rise, 1.0);
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

    /// Creates a sphere.
    pub(super) fn ball(centre: [f64; 3], radius: f64) -> Self {
        Self {
            shape: SurfaceShape::Ball { centre, radius },
            max_gradient: 1.0,
            end: None,
            rim: None,
        }
    }

    /// Returns the level: the function whose zero set is the surface (ignoring its end).
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

    /// Returns the closest point of the surface (ignoring its end). For a sheet, Newton's method on
    /// the two coordinates in the sheet finds the global minimum for any point closer than the
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
                    // Convergence is quadratic: the remaining error is about 1e-10.
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

    /// Returns the plane coordinates of a position in a sheet.
    pub(super) fn plane_coordinates(&self, p: [f64; 3]) -> [f64; 2] {
        match &self.shape {
            SurfaceShape::Sheet { centre, frame, .. } => {
                [1, 2].map(|k: usize| dot(frame[k], sub(p, *centre)))
            }
            SurfaceShape::Ball { .. } => [0.0; 2],
        }
    }

    /// Returns the point of a sheet at plane coordinates, and its normal there.
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

    /// Returns `true` if the surface exists at a point of its level set: the point is on the valid
    /// side of the surface at which it ends, which `surfaces` returns for an index.
    pub(super) fn exists_at<'a>(
        &self,
        surfaces: impl Fn(usize) -> &'a ImplicitSurface,
        point: [f64; 3],
    ) -> bool {
        self.end
            .is_none_or(|end| surfaces(end.surface).level(point) * end.side >= 0.0)
    }

    /// Returns the strength of the ridge or likelihood of a sheet near a position. It is 1 unless
    /// the sheet has a rim.
    pub(super) fn strength(&self, p: [f64; 3]) -> f64 {
        self.rim
            .map_or(1.0, |rim| rim.strength(self.plane_coordinates(p)))
    }

    /// Returns the normal of a sheet without its waves, or x for a ball.
    pub(super) fn mean_normal(&self) -> [f64; 3] {
        match &self.shape {
            SurfaceShape::Sheet { frame, .. } => frame[0],
            SurfaceShape::Ball { .. } => [1.0, 0.0, 0.0],
        }
    }

    /// Returns the share of its throw by which a fault displaces a position. It is 1 without a rim.
    /// Within a rim it falls elliptically from the centre outwards, and decreases away from the
    /// sheet over the smaller radius.
    pub(super) fn throw_share(&self, p: [f64; 3]) -> f64 {
        self.rim.map_or(1.0, |rim| {
            let [s, t] = self.plane_coordinates(p);
            let [a, b] = rim.radii;
            let ellipse = 1.0 - (s / a).powi(2) - (t / b).powi(2);
            let taper = 1.0 - (self.level(p) / a.min(b)).powi(2);
            ellipse.max(0.0).sqrt() * taper.max(0.0).powi(2)
        })
    }

    /// Returns the closest point within the rim, if there is a rim. On the rim the normal is still
    /// that of the sheet.
    pub(super) fn closest_point_in_rim(&self, p: [f64; 3]) -> SurfacePoint {
        let foot = self.closest_point(p);
        let Some(rim) = self.rim else { return foot };
        let coordinates = self.plane_coordinates(foot.point);
        if rim.distance_inside(coordinates) >= 0.0 {
            return foot;
        }
        // Golden-section search along the rim, starting where the ray through the foot point meets
        // it. The radii of the rim are large against the distance to it, so the minimum near the
        // start is the only one.
        let square = |angle: f64| {
            let r = sub(self.point_at(rim.point_at(angle)).point, p);
            dot(r, r)
        };
        let middle = rim.angle(coordinates);
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

    /// Returns the unit gradient of the level.
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
