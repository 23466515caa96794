//! Points sorted into cells, to find those nearby.

/// Points in cells, to find those nearby.
#[derive(Debug)]
pub struct Buckets<const D: usize> {
    low: [f64; D],
    cell: f64,
    /// Cell and number of each point, in the order of cells.
    points: Vec<([u32; D], u32)>,
}

impl<const D: usize> Buckets<D> {
    /// Sorts points into cells of this size.
    pub fn new(points: &[[f64; D]], cell: f64) -> Self {
        let low = points.iter().fold([f64::INFINITY; D], |low, p| {
            std::array::from_fn(|k| low[k].min(p[k]))
        });
        let mut buckets = Self {
            low,
            cell,
            points: Vec::new(),
        };
        let numbered = points.iter().enumerate();
        buckets.points = numbered
            .map(|(i, &p)| (buckets.cell_of(p), i as u32))
            .collect();
        buckets.points.sort_unstable();
        buckets
    }

    fn cell_of(&self, p: [f64; D]) -> [u32; D] {
        // One cell is left below, so that neighbours need no care.
        std::array::from_fn(|k| ((p[k] - self.low[k]) / self.cell) as u32 + 1)
    }

    /// Every point in the cell of `p` and those around it, always in the same order.
    pub fn visit(&self, p: [f64; D], mut visit: impl FnMut(usize)) {
        let middle = self.cell_of(p);
        for code in 0..3usize.pow(D as u32) {
            let mut rest = code;
            let cell: [u32; D] = std::array::from_fn(|k| {
                let step = (rest % 3) as u32;
                rest /= 3;
                middle[k] + step - 1
            });
            let from = self.points.partition_point(|(c, _)| *c < cell);
            let here = self.points[from..].iter().take_while(|(c, _)| *c == cell);
            here.for_each(|&(_, i)| visit(i as usize));
        }
    }
}
