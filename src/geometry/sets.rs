//! Sets that are united pair by pair.

/// Sets of numbers that are united pair by pair; the smallest member names a set.
#[derive(Debug, Clone)]
pub struct Sets(Vec<u32>);

impl Sets {
    /// `count` sets of one number each.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// The name of the set that holds `i`.
    pub fn find(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    /// Unites the sets of `i` and `j`.
    pub fn unite(&mut self, i: u32, j: u32) {
        let (i, j) = (self.find(i), self.find(j));
        self.0[i.max(j) as usize] = i.min(j);
    }

    /// For each number the number of its set, sets being numbered in the order of their names; and
    /// how many sets there are.
    pub fn numbered(mut self) -> (Vec<u32>, usize) {
        let mut count = 0;
        let mut number = vec![u32::MAX; self.0.len()];
        for i in 0..self.0.len() as u32 {
            let name = self.find(i) as usize;
            // A name is the smallest of its set, so it comes first.
            if name as u32 == i {
                number[name] = count;
                count += 1;
            } else {
                number[i as usize] = number[name];
            }
        }
        (number, count as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_numbered_in_order() {
        let mut sets = Sets::new(6);
        sets.unite(5, 1);
        sets.unite(4, 2);
        sets.unite(4, 5);
        assert_eq!(sets.numbered(), (vec![0, 1, 1, 2, 1, 1], 3));
    }
}
