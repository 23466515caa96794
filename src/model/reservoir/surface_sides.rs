//! The two sides of surfaces, and meshes split along them.

use super::Model;
use crate::Result;
use crate::error::{Error, cause};
use crate::model::flow::driver::{BarrierSelection, FaultLaws};
use crate::model::flow::{Barriers, FaultLaw, SplitMesh};
use crate::model::surface::Surfaces;

impl Model {
    /// Returns for each connection whether its second cell is on the upper side of its surface. The
    /// upper side is that of the surface's normal, which is consistent all over a surface and
    /// points upwards on average. The extension of a fault is a part of it. Only values of connections on
    /// surfaces have a meaning.
    pub fn second_cell_is_upper(&self) -> Vec<bool> {
        let labels = self.surfaces.merged_labels();
        let mut surface_faces: Vec<u32> = (0..labels.len() as u32)
            .filter(|&f| labels[f as usize] > 0)
            .collect();
        surface_faces.sort_by_key(|&f| labels[f as usize]);
        // Faces are convex, so the orientation of the first triangle is that of the face.
        let mut fans = Surfaces::<3>::default();
        let mut first_facet = Vec::with_capacity(surface_faces.len());
        let mut surface = 0;
        for &f in &surface_faces {
            let face_surface = labels[f as usize];
            if face_surface != surface {
                fans.start.push(fans.facets.len());
                surface = face_surface;
            }
            first_facet.push(fans.facets.len());
            let ring = self.mesh.faces.get(f as usize);
            fans.facets
                .extend((2..ring.len()).map(|i| [ring[0], ring[i - 1], ring[i]]));
        }
        fans.start.push(fans.facets.len());
        let first_node: Vec<u32> = first_facet
            .iter()
            .map(|&facet| fans.facets[facet][0])
            .collect();
        fans.orient(&self.mesh.nodes, [0.0, 0.0, 1.0]);
        let mut is_upper = vec![true; labels.len()];
        for ((&f, facet), node) in surface_faces.iter().zip(first_facet).zip(first_node) {
            is_upper[f as usize] = fans.facets[facet][0] == node;
        }
        is_upper
    }

    /// Splits the tetrahedra along the selected surfaces, but never along fragments.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if the cells are not tetrahedra or no selected surface has faces,
    /// and [`Error::Flow`] if a selector matches no surface.
    pub fn split_along(&mut self, selection: BarrierSelection) -> Result<()> {
        let tets = self.need_tets("a split mesh")?;
        let laws = FaultLaws {
            selection,
            law: FaultLaw::CLOSED,
            overrides: Vec::new(),
            must_apply: false,
        };
        let laws = laws.surface_laws(&self.surfaces.all_names(), "split")?;
        let mut label = vec![0; 4 * tets.tets.len()];
        for (f, &surface) in self.surfaces.connection_surfaces.iter().enumerate() {
            if surface == 0 || surface as usize > self.surfaces.kept_count {
                continue;
            }
            let cell = self.mesh.face_cells[f][0] as usize;
            let ring = self.mesh.faces.get(f);
            let opposite = tets.tets[cell].iter().position(|n| !ring.contains(n));
            label[4 * cell + opposite.unwrap_or(0)] = surface;
        }
        let split = SplitMesh::new(tets, &Barriers::new(label, laws)?)?;
        if split.faces.is_empty() {
            return Err(Error::Export(cause(
                "a split mesh",
                "needs a surface to split along, but there is none among those selected",
                "select other surfaces, or omit it",
            )));
        }
        self.split_mesh = Some(split);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::poly::PolyMesh;
    use crate::model::surface::SurfaceKind;

    /// Returns a box of tetrahedra with a fault at x = 1, which ends at y = 2 of 3.
    fn faulted_model() -> Model {
        let tets = kuhn_box([3, 3, 2], 1.0);
        let mut mesh = PolyMesh::from_simplices(&tets, &[], &[]).unwrap();
        mesh.assign_sides([0.0; 3], [3.0, 3.0, 2.0]);
        for f in 0..mesh.inner_face_count() {
            let ring = mesh.faces.get(f).iter().map(|&n| mesh.nodes[n as usize]);
            mesh.on_feature[f] =
                ring.clone().all(|p| p[0] == 1.0) && ring.clone().all(|p| p[1] <= 2.0);
        }
        Model::new(mesh, Some(tets))
    }

    #[test]
    fn a_surface_has_one_upper_side() {
        let model = faulted_model();
        let is_upper = model.second_cell_is_upper();
        let mut upper = Vec::new();
        for (f, c) in model.graph.connections.iter().enumerate() {
            if c.on_feature {
                let [below, above] = if is_upper[f] { [0, 1] } else { [1, 0] };
                let x = |side: usize| model.graph.site[c.cells[side] as usize][0];
                upper.push(x(above) > x(below));
            }
        }
        assert_eq!(upper.len(), 8);
        assert!(upper.iter().all(|u| *u == upper[0]), "{upper:?}");
    }

    #[test]
    fn nodes_are_doubled_along_the_fault_but_not_at_its_tip() {
        let mut model = faulted_model();
        let node_count = model.mesh.nodes.len();
        model.split_along(BarrierSelection::Faults).unwrap();
        let split = model.split_mesh.as_ref().unwrap();
        // Nodes at y = 0 and 1 are doubled, at each of three heights; those at y = 2 are at the
        // tip.
        assert_eq!(split.mesh.nodes.len() - node_count, 6);
        assert_eq!(split.faces.len(), 8);
        assert!(split.original_node[node_count..].iter().all(|&n| {
            let [x, y, _] = split.mesh.nodes[n as usize];
            x == 1.0 && y < 2.0
        }));
        model.surfaces.kinds = vec![SurfaceKind::Horizon];
        let error = model
            .split_along(BarrierSelection::Faults)
            .unwrap_err()
            .to_string();
        assert!(error.contains("there is none"), "{error}");
        model.surfaces.kept_count = 0;
        assert!(model.split_along(BarrierSelection::All).is_err());
        assert!(
            model
                .split_along(BarrierSelection::Selected(vec![2.into()]))
                .is_err()
        );
    }
}
