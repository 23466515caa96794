//! Finds the tetrahedra that share a face.

use super::NONE;
use crate::geometry::counting_sort::sort_by_group;
use crate::mesh::FACES;

/// Returns three node numbers in ascending order, which identify a face.
#[inline]
pub(super) fn face_key(mut f: [u32; 3]) -> [u32; 3] {
    if f[0] > f[1] {
        f.swap(0, 1);
    }
    if f[1] > f[2] {
        f.swap(1, 2);
    }
    if f[0] > f[1] {
        f.swap(0, 1);
    }
    f
}

/// Returns the neighbours of every tetrahedron, found by matching faces, in time linear in the
/// number of tetrahedra.
///
/// # Errors
/// Returns the first face that more than two tetrahedra share.
pub fn neighbours(node_count: usize, tets: &[[u32; 4]]) -> Result<Vec<[u32; 4]>, [u32; 3]> {
    // A counting sort by the smallest node leaves only a few faces in each group.
    let face_of = |t: usize, k: usize| face_key(FACES[k].map(|i| tets[t][i]));
    let smallest_nodes = (0..4 * tets.len()).map(|code| face_of(code / 4, code % 4)[0] as usize);
    let (start, bucket) = sort_by_group(node_count, smallest_nodes);
    let mut result = vec![[NONE; 4]; tets.len()];
    // The other two nodes of a face and its position as one number, which sorts quickly.
    let mut keys: Vec<u128> = Vec::new();
    for i in 0..node_count {
        keys.clear();
        for &code in &bucket[start[i] as usize..start[i + 1] as usize] {
            let [_, b, c] = face_of((code / 4) as usize, (code % 4) as usize);
            keys.push(u128::from(b) << 64 | u128::from(c) << 32 | u128::from(code));
        }
        keys.sort_unstable();
        let mut j = 0;
        while j < keys.len() {
            let key = keys[j] >> 32;
            let count = keys[j..].iter().take_while(|n| *n >> 32 == key).count();
            if count > 2 {
                return Err([i as u32, (key >> 32) as u32, key as u32]);
            }
            if count == 2 {
                let (p, q) = (keys[j] as u32, keys[j + 1] as u32);
                result[(p / 4) as usize][(p % 4) as usize] = q / 4;
                result[(q / 4) as usize][(q % 4) as usize] = p / 4;
            }
            j += count;
        }
    }
    Ok(result)
}
