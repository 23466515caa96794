//! Names of the arrays and fields of our mesh files.
//!
//! Arrays of simplices whose names depend on the dimension are constants of
//! [`Simplices`](crate::mesh::Simplices).

/// Cell array of regions.
pub(crate) const REGION_ARRAY: &str = "region";
/// Cell array of sites.
pub(crate) const SITE_ARRAY: &str = "site";
/// Name of the array with the kind of each node, which says how it may move.
pub(crate) const ATOM_KIND_ARRAY: &str = "atom_kind";
/// Name of the array with the nominal distance d at each node.
pub(crate) const DISTANCE_ARRAY: &str = "distance";
/// Name of the arrays with the image's values.
pub(crate) const IMAGE_ARRAY: &str = "image";
/// Name of the array with the share of each cell that holds data.
pub(crate) const LIVE_ARRAY: &str = "live";
/// Name of the array that marks cells with angles outside [30, 150] degrees, and tells whether
/// features explain them.
pub(crate) const ANGLES_ARRAY: &str = "angles";
/// Name of the array that marks faces on horizons, which are no barriers to flow: bits of cells as
/// in `feature_faces`, or pairs of cells for polyhedra and polygons.
pub(crate) const HORIZON_FACES_ARRAY: &str = "horizon_faces";
/// Name of the array with the base of each node of a periodic mesh. Nodes with the same number are
/// images of one another on opposite sides; other nodes have their own number.
pub(crate) const PERIODIC_NODE_ARRAY: &str = "periodic_node";
/// Name of the array with the axes of the image on whose far side each node of a periodic mesh lies:
/// 1 for x, 2 for y, 4 for z, added up.
pub(crate) const FAR_AXES_ARRAY: &str = "periodic_axes";
/// Array of the global node numbers.
pub(crate) const GLOBAL_NODE_ARRAY: &str = "node";
/// Start of the name of a cell array that is a set of cells.
pub(crate) const CELL_SET_PREFIX: &str = "cell_set:";
/// Start of the name of a node array that is a set of nodes.
pub(crate) const NODE_SET_PREFIX: &str = "node_set:";

/// Field with the position of the first sample of the image that was meshed.
pub(crate) const ORIGIN_FIELD: &str = "origin";
/// Field with the steps from sample to sample along each axis of that image, one after the other.
pub(crate) const AXES_FIELD: &str = "axes";
/// Field with the units of the coordinates, separated by commas.
pub(crate) const UNITS_FIELD: &str = "units";
/// Field with the length of one sample along each axis of lattice space.
pub(crate) const LATTICE_STEP_FIELD: &str = "lattice_step";
/// Field with the far corner of the box in lattice space.
pub(crate) const LATTICE_EXTENT_FIELD: &str = "lattice_extent";
/// Field with the number of the side of the box that follows a topography.
pub(crate) const BENT_SIDE_FIELD: &str = "bent_side";
/// Field with the velocities of the conversion from time to depth: a velocity in m/s, or the name
/// of a file of velocities.
pub(crate) const VELOCITY_FIELD: &str = "depth_velocity";
/// Field with the version of atomesh that made the mesh.
pub(crate) const VERSION_FIELD: &str = "atomesh_version";
/// Field with the options of the job, as its configuration file has them.
pub(crate) const PARAMETERS_FIELD: &str = "parameters";
/// Field with the SHA-256 of the input.
pub(crate) const INPUT_HASH_FIELD: &str = "input_sha256";
/// Field with the options that feature detection used.
pub(crate) const FEATURES_FIELD: &str = "features";
/// Field of faces on features: pairs of cells.
pub(crate) const FEATURE_FACES_FIELD: &str = "feature_faces";
/// Name of the field that stores the labels.
pub(crate) const LABELS_FIELD: &str = "labels";
/// Field with the names of the regions of a mesh that continues beyond its image.
pub(crate) const REGIONS_FIELD: &str = "regions";
/// Field with the names of the surfaces, one per line.
pub(crate) const SURFACE_NAMES_FIELD: &str = "surface_names";
/// Field with the faces of named surfaces, three numbers each: the number of the surface, from 1,
/// and its two cells.
pub(crate) const SURFACE_FACES_FIELD: &str = "surface_faces";
/// Field with the names of the sets of faces, one per line.
pub(crate) const FACE_SET_NAMES_FIELD: &str = "face_set_names";
/// Field with the faces of the sets: for each face the number of its set, from 1, the number of its
/// nodes, and its nodes.
pub(crate) const FACE_SETS_FIELD: &str = "face_sets";
/// Field with the names of the sets of faces at which cells were left out, one per line. Together with the
/// sides of the box they bound the mesh.
pub(crate) const OUTER_BOUNDARY_FIELD: &str = "outer_boundary";
/// Field with the share of the box that the cells fill, if some were left out.
pub(crate) const FILLED_SHARE_FIELD: &str = "filled_share";
/// Field of welded Voronoi cells: the fraction of their size within which nodes are merged.
pub(crate) const WELD_FIELD: &str = "weld";
/// Field of meshes of columns that are offset at faults: upright faces with one cell that lie in no side
/// of the box are at faults.
pub(crate) const THROWS_FIELD: &str = "throws";

/// Returns the unit of one of our arrays, from its name and the units of the coordinates; empty for
/// numbers without unit, or if the unit is not known.
pub(crate) fn array_unit<const D: usize>(array: &str, units: &[String; D]) -> String {
    match array {
        "min_dihedral" | "min_angle" | "min_dihedral_physical" | "min_angle_physical" => {
            "degrees".to_string()
        }
        DISTANCE_ARRAY => "samples".to_string(),
        "volume" | "area" if units.iter().all(|unit| *unit == units[0]) => {
            match units[0].as_str() {
                "" => String::new(),
                unit => format!("{unit}^{D}"),
            }
        }
        "volume" | "area" => units.join(" "),
        _ => String::new(),
    }
}
