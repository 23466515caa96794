//! Moves single nodes so that the smallest angles around them become larger, by a pattern search.

use super::regions::directions;
use crate::geometry::add_scaled;
use crate::mesh::Simplices;

/// Rounds in which each node moves.
const ROUNDS: usize = 12;
/// Length of the moves of the first round, as a share of the shortest edge.
const FIRST_STEP: f64 = 0.3;
/// Factor by which moves become shorter from round to round.
const STEP_DECAY: f64 = 0.75;

/// Moves nodes so that the smallest sine of an angle around each becomes larger. Nodes in sides of the box
/// `[0, extent]` stay in them. `shortest` is the length of the shortest edge around.
pub fn enlarge_angles<const D: usize, M: Simplices<D>>(
    mesh: &mut M,
    moving: &[u32],
    shortest: f64,
    extent: [f64; D],
) {
    let mut place = vec![usize::MAX; mesh.nodes().len()];
    for (at, &n) in moving.iter().enumerate() {
        place[n as usize] = at;
    }
    let mut stars: Vec<Vec<usize>> = vec![Vec::new(); moving.len()];
    for c in 0..mesh.len() {
        for &n in mesh.cell(c) {
            if let Some(star) = stars.get_mut(place[n as usize]) {
                star.push(c);
            }
        }
    }
    let directions = directions::<D>();
    let mut step = FIRST_STEP * shortest;
    for _ in 0..ROUNDS {
        for (&n, star) in moving.iter().zip(&stars) {
            let n = n as usize;
            let star_sine = |mesh: &M| {
                let sines = star.iter().map(|&c| mesh.min_sine(c));
                sines.fold(f64::INFINITY, f64::min)
            };
            let x = mesh.nodes()[n];
            let (mut best, mut position) = (star_sine(mesh), x);
            for &direction in &directions {
                let mut trial = add_scaled(x, step, direction);
                for k in 0..D {
                    let is_on_side = x[k] <= 0.0 || x[k] >= extent[k];
                    trial[k] = if is_on_side {
                        x[k]
                    } else {
                        trial[k].clamp(0.0, extent[k])
                    };
                }
                mesh.parts_mut().0[n] = trial;
                let sine = star_sine(mesh);
                if sine > best {
                    (best, position) = (sine, trial);
                }
            }
            mesh.parts_mut().0[n] = position;
        }
        step *= STEP_DECAY;
    }
}
