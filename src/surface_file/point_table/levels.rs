//! Recognises points of several surfaces that lie above each other.

/// Largest share of places with several z in one surface.
const MAX_SHARE: f64 = 0.2;

/// Smallest number of places with several z that are taken as surfaces above each other.
const MIN_PLACES: usize = 64;

/// Smallest difference between two z at one place, as a share of the range of all z.
const MIN_DIFFERENCE: f64 = 0.01;

/// Largest difference between coordinates of one place, as a share of the mean distance of points.
const PLACE_SIZE: f64 = 0.01;

/// Magnitudes from this on are null values.
const MIN_NULL: f64 = 1e29;

/// Returns `true` if points have clearly different z at many places in the plane, and these places
/// cover an area. Places of an upright fault lie along a curve.
pub(super) fn has_several_levels(points: &[[f64; 3]]) -> bool {
    let is_value = |p: &&[f64; 3]| p.iter().all(|c| c.abs() < MIN_NULL);
    let points: Vec<[f64; 3]> = points.iter().filter(is_value).copied().collect();
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for point in &points {
        for k in 0..3 {
            low[k] = low[k].min(point[k]);
            high[k] = high[k].max(point[k]);
        }
    }
    let size: [f64; 3] = std::array::from_fn(|k| high[k] - low[k]);
    let spacing = (size[0] * size[1] / points.len().max(1) as f64).sqrt();
    if points.len() < 2 * MIN_PLACES || !spacing.is_finite() || spacing <= 0.0 {
        return false;
    }
    let index = |p: &[f64; 3], k: usize| ((p[k] - low[k]) / (PLACE_SIZE * spacing)).round() as i64;
    let mut places: Vec<([i64; 2], f64)> = points
        .iter()
        .map(|p| ([index(p, 0), index(p, 1)], p[2]))
        .collect();
    places.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let (mut count, mut repeated) = (0u32, Vec::new());
    for place in places.chunk_by(|a, b| a.0 == b.0) {
        count += 1;
        if place[place.len() - 1].1 - place[0].1 > MIN_DIFFERENCE * size[2] {
            repeated.push(place[0].0);
        }
    }
    repeated.len() >= MIN_PLACES
        && repeated.len() as f64 > MAX_SHARE * f64::from(count)
        && cover_area(&repeated)
}

/// Returns `true` if places lie in more cells of a coarse grid than a curve crosses.
fn cover_area(places: &[[i64; 2]]) -> bool {
    let steps = (0.5 * (places.len() as f64).sqrt()) as i64;
    let bounds = [0, 1].map(|k| {
        let values = places.iter().map(|place| place[k]);
        (values.clone().min().unwrap_or(0), values.max().unwrap_or(0))
    });
    let cell = |place: &[i64; 2]| {
        [0, 1].map(|k| {
            let (low, high) = bounds[k];
            (place[k] - low) * steps / (high - low + 1)
        })
    };
    let mut cells: Vec<[i64; 2]> = places.iter().map(cell).collect();
    cells.sort_unstable();
    cells.dedup();
    cells.len() as i64 > 3 * steps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(z: impl Fn(f64, f64) -> Vec<f64>) -> Vec<[f64; 3]> {
        let mut points = Vec::new();
        for n in 0..400 {
            let [x, y] = [f64::from(n % 20) * 25.0, f64::from(n / 20) * 12.5];
            points.extend(z(x, y).into_iter().map(|z| [x + 0.5 * y, y - 0.5 * x, z]));
        }
        points
    }

    #[test]
    fn surfaces_above_each_other_are_told_from_one() {
        assert!(has_several_levels(&grid(|x, _| vec![x, x + 300.0])));
        assert!(has_several_levels(&grid(|x, y| vec![x, y, x + y + 90.0])));
        assert!(!has_several_levels(&grid(|x, y| vec![x + y])));
        assert!(!has_several_levels(&grid(|x, _| vec![x, x + 0.1])));
        // Lines that cross have few places in common.
        assert!(!has_several_levels(&grid(|x, y| {
            if x == y { vec![x, x + 90.0] } else { vec![x] }
        })));
        // An upright fault.
        let fault = (0..400usize).map(|k| {
            let (along, z) = ((k % 100) as f64, (k / 100) as f64);
            [along * 10.0, along * 7.0 + 0.02 * along * along, 50.0 * z]
        });
        assert!(!has_several_levels(&fault.collect::<Vec<_>>()));
    }
}
