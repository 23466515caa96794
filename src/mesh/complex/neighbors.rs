//! Which tetrahedra share a face.

use super::NONE;
use crate::mesh::FACES;

/// Three node numbers in rising order: a face's name.
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

/// Neighbours of every tetrahedron by matching faces, in time linear in their number.
///
/// Returns the first face that more than two tetrahedra share as the error.
pub fn neighbors(node_count: usize, tets: &[[u32; 4]]) -> Result<Vec<[u32; 4]>, [u32; 3]> {
    // Faces in buckets by their smallest node: a counting sort, then tiny lists.
    let face_of = |t: usize, k: usize| face_key(FACES[k].map(|i| tets[t][i]));
    let mut start = vec![0u32; node_count + 1];
    for t in 0..tets.len() {
        for k in 0..4 {
            start[face_of(t, k)[0] as usize + 1] += 1;
        }
    }
    for i in 0..node_count {
        start[i + 1] += start[i];
    }
    let mut bucket = vec![0u32; 4 * tets.len()];
    let mut next = start.clone();
    for t in 0..tets.len() {
        for k in 0..4 {
            let at = &mut next[face_of(t, k)[0] as usize];
            bucket[*at as usize] = (4 * t + k) as u32;
            *at += 1;
        }
    }
    let mut result = vec![[NONE; 4]; tets.len()];
    // A face by its other two nodes, then its place: one number, quick to sort.
    let mut names: Vec<u128> = Vec::new();
    for i in 0..node_count {
        names.clear();
        for &code in &bucket[start[i] as usize..start[i + 1] as usize] {
            let [_, b, c] = face_of((code / 4) as usize, (code % 4) as usize);
            names.push(u128::from(b) << 64 | u128::from(c) << 32 | u128::from(code));
        }
        names.sort_unstable();
        let mut j = 0;
        while j < names.len() {
            let name = names[j] >> 32;
            let same = names[j..].iter().take_while(|n| *n >> 32 == name).count();
            if same > 2 {
                return Err([i as u32, (name >> 32) as u32, name as u32]);
            }
            if same == 2 {
                let (p, q) = (names[j] as u32, names[j + 1] as u32);
                result[(p / 4) as usize][(p % 4) as usize] = q / 4;
                result[(q / 4) as usize][(q % 4) as usize] = p / 4;
            }
            j += same;
        }
    }
    Ok(result)
}
