//! Joins fault sticks to surfaces.

use super::sticks::Stick;
use crate::Error;
use crate::error::{Result, cause};
use crate::geometry::{norm, sub};

/// The surface of a fault.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JoinedSticks {
    /// Triangles in the coordinates of the sticks.
    pub triangles: Vec<[[f64; 3]; 3]>,
    /// Notes for the user, each one line.
    pub notes: Vec<String>,
}

/// Joins the sticks of one fault to a surface. `fault` is its name for messages, and
/// `metres_per_unit` the number of metres in a unit of each coordinate.
///
/// # Errors
/// Returns [`Error::Job`] if the sticks span no surface.
pub fn join_sticks(
    fault: &str,
    sticks: &[Stick],
    metres_per_unit: [f64; 3],
) -> Result<JoinedSticks> {
    let mut triangles = Vec::new();
    for pair in sticks.windows(2) {
        join_pair(
            &mut triangles,
            &pair[0].points,
            &pair[1].points,
            metres_per_unit,
        );
    }
    if triangles.is_empty() {
        let problem = "its sticks span no surface";
        let remedy = "give at least two sticks that do not lie on one line";
        return Err(Error::Job(cause(format!("fault {fault}"), problem, remedy)));
    }
    Ok(JoinedSticks {
        triangles,
        notes: Vec::new(),
    })
}

/// Adds triangles between two sticks. Each step takes the shorter of the two edges that continue.
fn join_pair(
    triangles: &mut Vec<[[f64; 3]; 3]>,
    a: &[[f64; 3]],
    b: &[[f64; 3]],
    metres_per_unit: [f64; 3],
) {
    let length = |p: [f64; 3], q: [f64; 3]| {
        let d = sub(p, q);
        norm(std::array::from_fn::<f64, 3, _>(|k| {
            d[k] * metres_per_unit[k]
        }))
    };
    let (mut i, mut j) = (0, 0);
    while i + 1 < a.len() || j + 1 < b.len() {
        let next_a = match (i + 1 < a.len(), j + 1 < b.len()) {
            (true, true) => length(a[i + 1], b[j]) <= length(a[i], b[j + 1]),
            (left, _) => left,
        };
        triangles.push([a[i], b[j], if next_a { a[i + 1] } else { b[j + 1] }]);
        if next_a {
            i += 1;
        } else {
            j += 1;
        }
    }
}
