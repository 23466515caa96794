//! Extends the faults of a model beyond their edges.

use super::Model;
use crate::model::surface::SurfaceKind;
use crate::model::surface::fault_extension::{ExtendedFault, Extension, extensions};
use crate::names::append_distinct;

impl Model {
    /// Extends all faults by up to `max_distance` metres. Each extension becomes a fault of its own.
    pub fn extend_faults(&mut self, max_distance: f64) -> Vec<ExtendedFault> {
        let names = self.surfaces.all_names().names;
        let is_fault =
            |surface: &u32| self.surfaces.kinds[*surface as usize - 1] == SurfaceKind::Fault;
        let faults: Vec<u32> = (1..=self.surfaces.kept_count as u32)
            .filter(is_fault)
            .collect();
        let (labels, kinds) = (self.surfaces.merged_labels(), &self.surfaces.kinds);
        let found = extensions(&self.graph, labels, kinds, &faults, max_distance);
        let mut all_names = [super::reserved_names(), names.clone()].concat();
        let known_count = all_names.len();
        let fault_name = |extension: &Extension| names[extension.surface as usize - 1].clone();
        let new_names = found.iter().map(|e| format!("{}_extension", fault_name(e)));
        append_distinct(&mut all_names, new_names);
        let new_names = all_names.split_off(known_count);
        let extended = found
            .iter()
            .zip(&new_names)
            .map(|(extension, name)| extension.extended_fault(&fault_name(extension), name))
            .collect();
        let mut extension_of = vec![None; self.graph.connections.len()];
        for (number, extension) in found.iter().enumerate() {
            for &index in &extension.connections {
                extension_of[index] = Some(number);
                // An extension goes on through horizons.
                self.surfaces.connection_surfaces[index] = 0;
            }
        }
        let first = self.surfaces.kept_count as u32 + 1;
        let faults = found.iter().map(|extension| extension.surface);
        self.surfaces.extensions = (first..).zip(faults).collect();
        let kind = SurfaceKind::Fault;
        (self.surfaces).add_surfaces(new_names, kind, |index| extension_of[index]);
        extended
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::voronoi;
    use crate::model::flow::FaultLaw;
    use crate::model::reservoir::{ModelFrame, SealCheck};
    use crate::progress::CancelToken;

    const EXTENT: [f64; 3] = [12.0, 10.0, 8.0];

    /// Returns a model of jittered cells with a site on each side of the plane x + 0.2 z = 6.4, as far
    /// apart as cells are. `faults` tells which connections that cross the plane are the first fault.
    fn model(faults: impl Fn([f64; 3]) -> bool) -> Model {
        let mut state = 7u64;
        let mut noise = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
        };
        let mut atoms = Vec::new();
        for i in 0..12 * 10 * 8 {
            let index = [i % 12, i / 12 % 10, i / 120];
            let mut x = index.map(|c| c as f64 + 0.5 + 0.2 * noise());
            // Cells lean with the plane.
            x[0] = (x[0] - 0.2 * (x[2] - 4.0)).clamp(0.05, 11.95);
            atoms.push(x);
        }
        let mesh = voronoi::voronoi(&atoms, EXTENT).unwrap();
        let mut model = Model::new(mesh, None);
        let offset = |x: [f64; 3]| x[0] + 0.2 * (x[2] - 4.0) - 6.0;
        let site = &model.graph.site;
        let on_fault = model.graph.connections.iter().map(|c| {
            let [a, b] = c.cells.map(|cell| offset(site[cell as usize]));
            u32::from(a * b < 0.0 && faults(c.point))
        });
        model.surfaces.connection_surfaces = on_fault.collect();
        model.surfaces.kinds = vec![SurfaceKind::Fault];
        model.surfaces.kept_count = 1;
        model
    }

    #[test]
    fn a_fault_is_extended_to_the_sides_and_then_seals() {
        // The fault ends in the middle of the box along y, and below its top.
        let mut model = model(|x| x[1] < 5.0 && x[2] < 5.0);
        let whole = self::model(|_| true);
        let crossing = whole.surfaces.connection_surfaces;
        model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
        let cancel = CancelToken::never();
        let check = SealCheck::new(&model, &ModelFrame::default(), &cancel).unwrap();
        // Five cells along y are a free end, and three below the top a gap.
        let fault = &check.faults[0];
        assert!(fault.through + fault.around > 0.3, "{check:?}");
        assert!(fault.around > 0.3, "{check:?}");
        let causes: Vec<&str> = fault.leaks.iter().map(|leak| &*leak.cause).collect();
        assert_eq!(causes, ["gap to side zmax"]);
        let covered = fault.covered_share;
        assert!((0.25..0.4).contains(&covered), "{covered}");
        assert_eq!(check.compartments.len(), 1);

        let extended = model.extend_faults(100.0);
        let [fault] = &extended[..] else {
            panic!("{extended:?}");
        };
        assert_eq!(
            (&*fault.name, &*fault.extension),
            ("fault1", "fault1_extension")
        );
        // The plane through the box, less the fault.
        let area = 80.0 * 1.04f64.sqrt();
        let total = fault.area + fault.extension_area;
        assert!((total / area - 1.0).abs() < 0.1, "{total} {area}");
        let labels = &model.surfaces.connection_surfaces;
        let differing = labels.iter().zip(&crossing);
        let differing = differing.filter(|(a, b)| (**a != 0) != (**b != 0)).count();
        assert!(differing < 30, "{differing}");
        model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
        let check = SealCheck::new(&model, &ModelFrame::default(), &cancel).unwrap();
        assert_eq!(check.faults.len(), 1, "{check:?}");
        let passing = check.faults[0].through + check.faults[0].around;
        assert!(passing < 1e-9, "{check:?}");
        assert_eq!(check.faults[0].covered_share, 1.0);
        assert_eq!(check.compartments.len(), 2);
    }

    #[test]
    fn a_fault_of_steps_goes_on_at_its_slope() {
        let atoms = |i: usize| [i % 12, i / 12 % 12, i / 144].map(|c| c as f64 + 0.5);
        let atoms: Vec<[f64; 3]> = (0..12 * 12 * 4).map(atoms).collect();
        for slope in [-0.3, 0.3] {
            let mesh = voronoi::voronoi(&atoms, [12.0, 12.0, 4.0]).unwrap();
            let mut model = Model::new(mesh, None);
            let offset = |x: [f64; 3]| x[0] - 6.13 - slope * (x[1] - 6.0);
            let site = &model.graph.site;
            let on_fault = model.graph.connections.iter().map(|c| {
                let [a, b] = c.cells.map(|cell| offset(site[cell as usize]));
                u32::from(a * b < 0.0 && c.point[1] < 7.0)
            });
            model.surfaces.connection_surfaces = on_fault.collect();
            model.surfaces.kinds = vec![SurfaceKind::Fault];
            model.surfaces.kept_count = 1;
            let before = model.surfaces.connection_surfaces.clone();
            assert_eq!(model.extend_faults(100.0).len(), 1);
            let labels = model.surfaces.connection_surfaces.iter().zip(&before);
            let added = model.graph.connections.iter().zip(labels);
            let added = added.filter(|(_, (label, before))| **label != 0 && **before == 0);
            let points: Vec<[f64; 3]> = added.map(|(c, _)| c.point).collect();
            assert!(points.iter().any(|x| x[1] > 11.0));
            // The plane through faces of steps is not exact. With the steps turned round, the end is
            // three cells off.
            let farthest = points.iter().map(|x| offset(*x).abs()).fold(0.0, f64::max);
            assert!(farthest < 1.6, "{slope}: {farthest}");
        }
    }

    #[test]
    fn an_extension_ends_at_its_distance_and_at_the_next_fault() {
        let mut near = model(|x| x[1] < 3.0);
        let extended = near.extend_faults(2.0);
        let sqrt = 1.04f64.sqrt();
        let expected = 2.0 * 8.0 * sqrt;
        assert!(
            (extended[0].extension_area / expected - 1.0).abs() < 0.3,
            "{extended:?}"
        );
        // Another fault across the box, y = 5.
        let mut between = model(|x| x[1] < 3.0);
        let sites = between.graph.site.clone();
        let pairs = between.graph.connections.iter();
        let labels = between.surfaces.connection_surfaces.clone();
        let labels = pairs.zip(labels).map(|(c, label)| {
            let [a, b] = c.cells.map(|cell| sites[cell as usize][1] - 5.0);
            if a * b < 0.0 { 2 } else { label }
        });
        between.surfaces.connection_surfaces = labels.collect();
        between.surfaces.kinds = vec![SurfaceKind::Fault; 2];
        between.surfaces.kept_count = 2;
        let extended = between.extend_faults(100.0);
        assert_eq!(extended.len(), 1, "{extended:?}");
        let expected = 2.0 * 8.0 * sqrt;
        assert!(
            (extended[0].extension_area / expected - 1.0).abs() < 0.2,
            "{extended:?}"
        );
    }
}
