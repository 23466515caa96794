//! Checks of options and their combinations.
//!
//! An option that has no effect with the others is refused, with the reason, unless it has its
//! default value. Errors begin with the option's name.

use std::fmt::Display;

use super::{
    AtomAlignment, CellKind, DistanceSource, LATTICE_OPTIONS, MeshSpec, NumberOrFile, SeedingKind,
    Slivers,
};
use crate::Result;
use crate::error::{Error, cause};
use crate::feature::{FeatureKind, LabelOptions, ThresholdMeaning};
use crate::image::LabelValue;
use crate::job::cover::Cover;
use crate::job::params::Evaluator;
use crate::mesh_file::pvtu::is_pvtu;
use crate::names::first_repeated;
use crate::option_text::names_image;

/// Largest fraction of the cells' radius within which nodes may be merged. Beyond it, cells lose
/// faces that matter.
const MAX_WELD_RATIO: f64 = 0.2;

/// Largest number of passes on smoother potentials, each of which is twice as smooth as the next.
const MAX_COARSE_PASSES: usize = 8;

/// Refuses a value of an option that is negative or not finite.
fn check_not_negative(option: &str, value: Option<f64>, remedy: &str) -> Result<()> {
    match value.filter(|value| !(value.is_finite() && *value >= 0.0)) {
        Some(value) => Err(option_error(option, value, "is not 0 or more", remedy)),
        None => Ok(()),
    }
}

/// Returns an error about an option.
fn option_error(name: &str, value: impl Display, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(format!("{name} {value}"), problem, remedy))
}

/// Options, and their defaults for comparison.
struct Options<'a> {
    spec: &'a MeshSpec,
    table: toml::Table,
    defaults: toml::Table,
}

impl Options<'_> {
    /// Returns an error if an option of these names differs from its default.
    fn refuse(&self, names: &[&str], problem: &str, remedy: &str) -> Result<()> {
        for name in names {
            let value = self.table.get(*name);
            if let Some(value) = value.filter(|value| self.defaults.get(*name) != Some(value)) {
                let value = match value {
                    toml::Value::String(text) => text.clone(),
                    toml::Value::Array(values) => values
                        .iter()
                        .map(|v| v.as_str().map_or_else(|| v.to_string(), String::from))
                        .collect::<Vec<_>>()
                        .join(" "),
                    other => other.to_string(),
                };
                return Err(option_error(name, value, problem, remedy));
            }
        }
        Ok(())
    }
}

impl MeshSpec {
    /// Checks that the options make sense together.
    ///
    /// # Errors
    /// [`Error::Job`] that begins with the name of the option that is impossible or that would have no
    /// effect.
    pub fn validate(&self) -> Result<()> {
        let options = Options {
            spec: self,
            table: self.to_table()?,
            defaults: Self::default().to_table()?,
        };
        options.check_alignment()?;
        options.check_cells()?;
        options.check_topography()?;
        options.check_choice()?;
        options.check_cover()?;
        options.check_periodic()?;
        if self.seeding == SeedingKind::Canny {
            options.check_canny()?;
        } else {
            options.check_lattice()?;
        }
        options.check_features()
    }
}

impl Options<'_> {
    /// Checks that there is padding that can end at the topography.
    fn check_topography(&self) -> Result<()> {
        if self.spec.pad.is_some() {
            return Ok(());
        }
        let problem = "is where the cells beyond the image end, but there are none";
        let remedy = "add --pad, for example --pad below=500,sides=1000";
        self.refuse(&["topography"], problem, remedy)
    }

    /// Checks that the mesh can cover voxels.
    fn check_cover(&self) -> Result<()> {
        if self.spec.cover == Cover::Samples {
            return Ok(());
        }
        if self.spec.cell_kind() == CellKind::Voronoi {
            let problem =
                "is for tetrahedra and triangles: squeezed at the sides, Voronoi cells are none";
            let remedy = "omit it, or choose --cells tets";
            return Err(option_error("cover", "voxels", problem, remedy));
        }
        let problem = "needs a mesh through the outermost samples";
        let remedy = "omit it, or --cover voxels";
        let options = [
            "pad",
            "topography",
            "periodic",
            "page",
            "potential-out",
            "trace",
            "checkpoint",
        ];
        self.refuse(&options, problem, remedy)
    }

    /// Checks the labels that are left out.
    fn check_choice(&self) -> Result<()> {
        let choice = self.spec.cell_choice();
        choice.validate()?;
        if choice.keeps_all() {
            return Ok(());
        }
        let problem = "continues the mesh beyond the image, but labels of it are left out";
        let remedy = "omit it, or leave labels out afterwards (atomesh export --drop)";
        self.refuse(&["pad", "periodic"], problem, remedy)?;
        match &self.spec.output {
            Some(output) if is_pvtu(output) => Err(Error::Job(cause(
                format!("output {}", output.display()),
                "is a mesh in several files, of which no label can be left out",
                "give a name that ends in .vtu",
            ))),
            _ => Ok(()),
        }
    }

    /// Checks that nothing else determines the sides of a periodic mesh.
    fn check_periodic(&self) -> Result<()> {
        let Some(axes) = self.spec.periodic else {
            return Ok(());
        };
        if self.spec.cell_kind() == CellKind::Voronoi {
            let problem = "is for tetrahedra and triangles, but the mesh has Voronoi cells";
            let remedy = "omit it, or choose --cells tets";
            return Err(option_error("periodic", axes, problem, remedy));
        }
        let problem = format!(
            "is not for periodic meshes (periodic {axes}), whose sides follow from the image alone"
        );
        let names = [
            "pad",
            "topography",
            "surface",
            "atoms-from",
            "well",
            "smooth",
            "slivers",
            "velocity",
        ];
        self.refuse(&names, &problem, "omit one of the two")?;
        if self.spec.seeding == SeedingKind::Canny {
            return Err(option_error(
                "seeding",
                "canny",
                &problem,
                "omit one of the two",
            ));
        }
        Ok(())
    }

    /// Checks the alignment. Voronoi cells need atoms alongside features and strictly inside the
    /// box; tetrahedra need atoms on both.
    fn check_alignment(&self) -> Result<()> {
        let kind = self.spec.cell_kind();
        let (value, problem) = match (kind, self.spec.align) {
            (CellKind::Voronoi, Some(AtomAlignment::On)) => (
                "on",
                "puts atoms on features and on the sides of the box, where no Voronoi cell can end",
            ),
            (CellKind::Simplices, Some(AtomAlignment::Alongside)) => (
                "alongside",
                "keeps atoms off features and off the sides of the box, which tetrahedra must reach",
            ),
            _ => return Ok(()),
        };
        let remedy = "place atoms on features for --cells tets, alongside them for --cells voronoi";
        Err(option_error("align", value, problem, remedy))
    }

    /// Returns an error if there is a target angle that is not the default of the effort.
    fn refuse_target_angle(&self, problem: &str, remedy: &str) -> Result<()> {
        match self.spec.min_dihedral {
            Some(angle) if angle != self.spec.effort().min_angle() => {
                Err(option_error("min-dihedral", angle, problem, remedy))
            }
            _ => Ok(()),
        }
    }

    fn check_cells(&self) -> Result<()> {
        let spec = self.spec;
        if spec.cell_kind() == CellKind::Voronoi {
            let problem = "applies to tetrahedra and triangles, but the mesh has Voronoi cells";
            let remedy = "omit it, or choose --cells tets";
            let options = ["slivers", "smooth", "lines", "pad", "topography"];
            self.refuse(&options, problem, remedy)?;
            self.refuse_target_angle(problem, remedy)?;
            if !(0.0..=MAX_WELD_RATIO).contains(&spec.weld) {
                let problem = format!("is not a fraction from 0 to {MAX_WELD_RATIO}");
                return Err(option_error(
                    "weld",
                    spec.weld,
                    &problem,
                    "give for example 0.001",
                ));
            }
            return Ok(());
        }
        let problem = "applies to Voronoi cells, but the mesh has tetrahedra or triangles";
        self.refuse(&["weld"], problem, "omit it, or choose --cells voronoi")?;
        if spec.slivers == Slivers::None {
            let problem = "sets a target angle, but no slivers are to be removed";
            let remedy = "omit it, or have slivers removed (--slivers)";
            return self.refuse_target_angle(problem, remedy);
        }
        // A regular tetrahedron has 70.5 degrees, but no space is filled with those alone.
        let min_angle = spec.min_angle();
        if !(min_angle > 0.0 && min_angle <= 60.0) {
            let problem = "is not above 0 and at most 60 degrees";
            return Err(option_error(
                "min-dihedral",
                min_angle,
                problem,
                "30 is the default",
            ));
        }
        Ok(())
    }

    /// Checks the options of Canny's seeding: its atoms do not move, and the image determines their
    /// distance.
    fn check_canny(&self) -> Result<()> {
        if self.spec.cell_kind() == CellKind::Voronoi {
            return Err(option_error(
                "seeding",
                "canny",
                "puts atoms on features, but Voronoi cells need them alongside",
                "choose --cells tets, or another --seeding",
            ));
        }
        let remedy = "omit it, or choose another --seeding";
        self.refuse(
            &["distance", "distance-from"],
            "has no effect with seeding canny: the image and its features determine the distance",
            remedy,
        )?;
        self.refuse(
            &["well", "well-distance"],
            "has a distance of its own, but with seeding canny the image and its features determine it",
            "give wells as fixed atoms (--atoms-from), or choose another --seeding",
        )?;
        self.refuse(
            LATTICE_OPTIONS,
            "applies to a lattice whose energy is minimised, but with seeding canny no atom moves",
            remedy,
        )?;
        if self.spec.slivers == Slivers::None {
            let problem = "is spent on atoms that move and on slivers that are removed, but no atom \
                           moves and no slivers are removed";
            self.refuse(&["effort"], problem, remedy)?;
        }
        if self.spec.feature != FeatureKind::Paths {
            let problem = "sets the random numbers, but seeding canny uses none";
            self.refuse(&["rng-seed"], problem, remedy)?;
        }
        self.check_max_atoms()
    }

    fn check_max_atoms(&self) -> Result<()> {
        self.refuse(
            &["max-atoms"],
            "applies to atoms that are drawn one by one",
            "use it with --seeding guide, or choose a larger --distance",
        )
    }

    /// Checks the options of a lattice that moves.
    fn check_lattice(&self) -> Result<()> {
        let spec = self.spec;
        if spec.seeding != SeedingKind::Guide {
            self.check_max_atoms()?;
        }
        if spec.cell_kind() == CellKind::Voronoi && spec.seeding == SeedingKind::Projection {
            return Err(option_error(
                "seeding",
                "projection",
                "puts atoms onto features, which the faces of Voronoi cells follow",
                "choose --cells tets, or another --seeding",
            ));
        }
        if spec.coarse_to_fine > MAX_COARSE_PASSES {
            let problem = format!(
                "is more than {MAX_COARSE_PASSES} passes, each twice as smooth as the next"
            );
            return Err(option_error(
                "coarse-to-fine",
                spec.coarse_to_fine,
                &problem,
                "1 or 2 are typical",
            ));
        }
        if spec.rounds == Some(0) {
            let problem = "allows no move of any atom";
            return Err(option_error(
                "rounds",
                0,
                problem,
                "give 1 or more, or omit it",
            ));
        }
        self.check_distance()?;
        self.check_wells()?;
        self.check_extension()?;
        self.check_beta()?;
        self.check_energy()
    }

    fn check_distance(&self) -> Result<()> {
        let spec = self.spec;
        match (&spec.distance, &spec.distance_from) {
            (distance, DistanceSource::Gaps) if !distance.varies() => Ok(()),
            (d, source) if !d.varies() => Err(option_error(
                "distance-from",
                source,
                &format!("makes the distance vary, but it is {d} everywhere"),
                "omit it, or give a range MIN:MAX such as --distance 5:15",
            )),
            (_, DistanceSource::File(path)) if !names_image(path) => Err(option_error(
                "distance-from",
                path.display(),
                "is not gaps, features, image, laplacian or a file",
                "give one of these, or an image of distances in samples",
            )),
            _ => Ok(()),
        }
    }

    fn check_wells(&self) -> Result<()> {
        if self.spec.well.is_empty() {
            let problem = "is given without a well";
            return self.refuse(
                &["well-distance"],
                problem,
                "omit it, or give a well (--well)",
            );
        }
        match self.spec.well_distance {
            Some(d) if d.value <= 0.0 => Err(option_error(
                "well-distance",
                d,
                "is not a positive number of samples",
                "give one above 0",
            )),
            _ => Ok(()),
        }
    }

    fn check_extension(&self) -> Result<()> {
        match self.spec.extend_faults {
            Some(d) if !(d.value.is_finite() && d.value >= 0.0) => Err(option_error(
                "extend-faults",
                d,
                "is not a number of samples",
                "give 0 or more, or omit it",
            )),
            Some(_) if self.spec.surface.is_empty() => self.refuse(
                &["extend-faults"],
                "continues given faults, but none is given",
                "omit it, or give a fault (--surface)",
            ),
            _ => Ok(()),
        }
    }

    fn check_beta(&self) -> Result<()> {
        match &self.spec.beta {
            // With beta = 1, nothing would keep the atoms apart.
            NumberOrFile::Constant(beta) if !(0.0..1.0).contains(beta) => Err(option_error(
                "beta",
                beta,
                "is not at least 0 and below 1",
                "0 ignores the image, 0.5 is the default",
            )),
            NumberOrFile::File(path) if !names_image(path) => Err(option_error(
                "beta",
                path.display(),
                "is neither a number nor a file",
                "give a number from 0 to 1, or an image of such numbers",
            )),
            _ => Ok(()),
        }
    }

    fn check_energy(&self) -> Result<()> {
        let spec = self.spec;
        let has_voronoi_cells = spec.cell_kind() == CellKind::Voronoi;
        if spec.evaluator == Evaluator::Sampled {
            if has_voronoi_cells {
                return Err(option_error(
                    "evaluator",
                    "sampled",
                    "computes no mirror images of atoms, which atoms alongside features need",
                    "use --evaluator pairwise",
                ));
            }
            let problem = "needs the exact energy, but the sampled evaluator is chosen";
            return self.refuse(&["kappa"], problem, "use --evaluator pairwise");
        }
        if has_voronoi_cells {
            self.refuse(
                &["kappa"],
                "applies to the neighbours of atoms in tetrahedra or triangles, but the mesh has Voronoi cells",
                "omit it, or choose --cells tets",
            )?;
        }
        if !(0.0..=1.0).contains(&spec.kappa) {
            let remedy = "1 omits Laplacian coordinates, 0.7 is typical with them";
            return Err(option_error(
                "kappa",
                spec.kappa,
                "is not from 0 to 1",
                remedy,
            ));
        }
        Ok(())
    }

    fn check_features(&self) -> Result<()> {
        let spec = self.spec;
        self.check_feature_numbers()?;
        check_labels(&spec.label)?;
        if spec.feature == FeatureKind::NoFeatures {
            let problem =
                "is about features that are looked for, but --feature none looks for none";
            self.refuse(
                &["sigma", "threshold"],
                problem,
                "omit it, or choose another --feature",
            )?;
        }
        if !spec.surface.is_empty() && spec.seeding == SeedingKind::Canny {
            let problem = "is given, but seeding canny puts atoms on the points that it finds";
            self.refuse(&["surface"], problem, "choose another --seeding")?;
        }
        let kind = spec.clone().resolved().feature;
        let label_with_distance = spec.label.iter().find(|label| label.distance.is_some());
        if let (Some(label), SeedingKind::Canny) = (label_with_distance, spec.seeding) {
            let problem =
                "has a distance of its own, but with seeding canny the image determines it";
            return Err(option_error(
                "label",
                label,
                problem,
                "choose another --seeding",
            ));
        }
        self.check_options_of_kind(kind)
    }

    /// Checks the numbers that describe features, each by itself.
    fn check_feature_numbers(&self) -> Result<()> {
        let spec = self.spec;
        if let Some(sigma) = spec.sigma.filter(|s| !(s.is_finite() && *s > 0.0)) {
            let problem = "is not a positive number of samples";
            let remedy = "omit it, or give about the features' thickness";
            return Err(option_error("sigma", sigma, problem, remedy));
        }
        if let Some(thresholds) = &spec.threshold
            && !thresholds.values().iter().all(|t| t.is_finite())
        {
            let remedy = "omit it: the automatic threshold is printed";
            return Err(option_error(
                "threshold",
                thresholds,
                "is not a finite number",
                remedy,
            ));
        }
        if !(0.0..90.0).contains(&spec.min_dip) {
            let remedy = "give the smallest dip of a fault, such as 30";
            let problem = "is not in 0 .. 90 degrees";
            return Err(option_error("min-dip", spec.min_dip, problem, remedy));
        }
        let confidence_remedy = "noise has up to 1: give a value such as 1.5";
        check_not_negative(
            "min-fault-size",
            spec.min_fault_size,
            "give samples, such as 20",
        )?;
        check_not_negative("min-confidence", spec.min_confidence, confidence_remedy)?;
        Ok(())
    }

    /// Checks that options for labels are given only if the `kind` that is followed has labels.
    fn check_options_of_labels(&self, kind: FeatureKind) -> Result<()> {
        if !matches!(
            kind,
            FeatureKind::Auto | FeatureKind::Labels | FeatureKind::Isosurface
        ) {
            let problem = format!("is about parts of labels, but {kind} are followed");
            self.refuse(
                &["min-part"],
                &problem,
                "omit it, or follow labels or an isosurface (--feature)",
            )?;
        }
        // An isosurface divides the image into the labels 0 and 1, or more.
        if !matches!(kind, FeatureKind::Labels | FeatureKind::Isosurface) {
            let problem = format!("is about a label, but {kind} are followed");
            self.refuse(
                &["label", "drop", "keep", "keep-largest"],
                &problem,
                "omit it, or follow labels (--feature labels)",
            )?;
        }
        if kind != FeatureKind::Labels {
            let problem = format!("smooths the boundaries of labels, but {kind} are followed");
            self.refuse(
                &["label-smoothing"],
                &problem,
                "omit it, or follow labels (--feature labels)",
            )?;
        }
        Ok(())
    }

    /// Checks that no option is given that applies to other kinds of features than the `kind` that is
    /// followed.
    fn check_options_of_kind(&self, kind: FeatureKind) -> Result<()> {
        let spec = self.spec;
        if let Some(thresholds) = &spec.threshold
            && thresholds.values().len() > 1
            && kind != FeatureKind::Isosurface
        {
            return Err(option_error(
                "threshold",
                thresholds,
                &format!(
                    "has several values, which divide an image into regions, but {kind} are followed"
                ),
                "give one value, or choose --feature isosurface",
            ));
        }
        self.check_options_of_labels(kind)?;
        if kind != FeatureKind::Paths {
            let problem = "applies to an object whose boundary is followed by paths";
            self.refuse(
                &["object", "background"],
                problem,
                "omit it, or follow paths (--feature paths)",
            )?;
        }
        if kind != FeatureKind::FaultsAndHorizons {
            let problem = "weighs faults against horizons, but they are not followed together";
            self.refuse(
                &["feature-weights"],
                problem,
                "omit it, or follow both (--feature faults+horizons)",
            )?;
        }
        if !matches!(
            kind,
            FeatureKind::Auto | FeatureKind::Faults | FeatureKind::FaultsAndHorizons
        ) {
            let problem =
                format!("applies to faults of seismic amplitude, but {kind} are followed");
            self.refuse(
                &["min-dip", "min-fault-size"],
                &problem,
                "omit it, or follow faults (--feature faults)",
            )?;
        }
        if !matches!(
            kind,
            FeatureKind::Auto
                | FeatureKind::Faults
                | FeatureKind::Horizons
                | FeatureKind::FaultsAndHorizons
        ) {
            let problem = format!("applies to layers, but {kind} are followed");
            let remedy = "omit it, or follow faults or horizons (--feature)";
            self.refuse(&["keep-chaos"], &problem, remedy)?;
        }
        if kind.threshold_meaning() == ThresholdMeaning::Unused {
            let problem = format!("applies to the strength of features, but {kind} have none");
            self.refuse(
                &["threshold"],
                &problem,
                "omit it, or follow other features (--feature)",
            )?;
        }
        Ok(())
    }
}

/// Checks that each label has options once, and that none is merged into a label that is itself merged.
fn check_labels(labels: &[LabelOptions]) -> Result<()> {
    for (i, label) in labels.iter().enumerate() {
        if labels[..i].iter().any(|known| known.label == label.label) {
            return Err(option_error(
                "label",
                label,
                "gives options of the same label a second time",
                "give all options of a label at once, with commas between them",
            ));
        }
    }
    let names = labels.iter().filter_map(|label| label.name.as_deref());
    let repeated = first_repeated(names);
    if let Some(label) =
        (labels.iter().rev()).find(|l| repeated.is_some() && l.name.as_deref() == repeated)
    {
        let problem = "gives a name that another label has";
        let remedy = "give each label a name of its own, or merge them with into=VALUE";
        return Err(option_error("label", label, problem, remedy));
    }
    let is_merged = |value: LabelValue| {
        labels
            .iter()
            .any(|label| label.label == value && label.merge_into.is_some())
    };
    if let Some(label) = (labels.iter()).find(|label| label.merge_into.is_some_and(is_merged)) {
        let problem = "merges a label into one that is itself merged into another";
        return Err(option_error(
            "label",
            label,
            problem,
            "name the final label",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> std::result::Result<MeshSpec, toml::de::Error> {
        toml::from_str(text)
    }

    #[test]
    fn an_empty_file_gives_the_defaults() {
        assert_eq!(read("").unwrap(), MeshSpec::default());
        assert!(read("distanse = 5").is_err());
    }

    #[test]
    fn options_survive_toml_and_json() {
        for text in [
            "",
            "distance = \"4:9.5\"\ndistance-from = \"laplacian\"\nthreshold = 0.3\nkappa = 0.7",
            "cells = \"voronoi\"\nweld = 0.01\nwell = [\"a.csv\", \"b.csv\"]\nwell-distance = 2",
            "seeding = \"canny\"\nsmooth = \"odt\"\nfeature = \"labels\"\nslivers = \"none\"",
            "feature = \"paths\"\nobject = [\"1,2\", \"-3,4.5\"]\nevaluator = \"sampled\"",
            "feature = \"faults+horizons\"\nfeature-weights = \"1,0.5\"\nmetric = \"1,1,0.2\"",
            "feature = \"isosurface\"\nthreshold = [300, 700.5]\nmin-part = 20",
            "velocity = 2400.0",
            "velocity = \"velocities.sgy\"",
            "label = [\"3:distance=4,name=fault\", \"5:into=3\"]",
            "surface = [\"faults.ts\", \"a.vtp:Main,horizon\"]\nfeature = \"none\"",
            "pad = \"above=200,sides=50.5\"",
            "pad = { below = 200, sides = 50.5 }",
            "pad = \"sides=50\"\ntopography = \"ground.irap:Ground\"",
            "rounds = 5\noptimizer = \"genetic\"",
            "effort = \"draft\"\nmin-dihedral = 20",
            "effort = \"best\"\ncells = \"voronoi\"",
            "effort = \"normal\"\nslivers = \"none\"",
            "velocity = 2400.0\nmetric = \"samples\"",
            "seeding = \"guide\"\nmax-atoms = 50\n[input]\ninline-byte = 9",
        ] {
            let spec = read(text).unwrap();
            spec.validate().unwrap();
            for spec in [spec.clone(), spec.resolved()] {
                let written = spec.to_toml().unwrap();
                assert_eq!(read(&written).unwrap(), spec, "{written}");
                let json = serde_json::to_string(&spec).unwrap();
                assert_eq!(
                    serde_json::from_str::<MeshSpec>(&json).unwrap(),
                    spec,
                    "{json}"
                );
            }
        }
    }

    #[test]
    fn options_without_effect_are_refused_by_name() {
        for (text, name) in [
            ("seeding = \"canny\"\nbeta = 0.2", "beta"),
            (
                "seeding = \"canny\"\nslivers = \"none\"\neffort = \"best\"",
                "effort",
            ),
            ("seeding = \"canny\"\nkappa = 0.7", "kappa"),
            ("seeding = \"canny\"\noptimizer = \"genetic\"", "optimizer"),
            ("seeding = \"canny\"\nevaluator = \"sampled\"", "evaluator"),
            ("seeding = \"canny\"\ncoarse-to-fine = 1", "coarse-to-fine"),
            ("seeding = \"canny\"\nrounds = 2", "rounds"),
            ("rounds = 0", "rounds"),
            ("seeding = \"canny\"\ntrace = \"t.pvd\"", "trace"),
            ("seeding = \"canny\"\ndistance = 5", "distance"),
            ("seeding = \"canny\"\nrng-seed = 5", "rng-seed"),
            ("feature = \"labels\"\nthreshold = 0.5", "threshold"),
            ("feature = \"edges\"\nthreshold = [0.5, 2]", "threshold"),
            ("threshold = \"300,700\"", "threshold"),
            ("feature = \"edges\"\nmin-part = 20", "min-part"),
            ("feature = \"paths\"\nthreshold = 0.5", "threshold"),
            ("object = [\"1,2\"]", "object"),
            ("background = [\"1,2\"]", "background"),
            ("feature-weights = \"1,0.5\"", "feature-weights"),
            ("slivers = \"none\"\nmin-dihedral = 20", "min-dihedral"),
            ("cells = \"voronoi\"\nmin-dihedral = 20", "min-dihedral"),
            ("cells = \"voronoi\"\nkappa = 0.7", "kappa"),
            ("cells = \"voronoi\"\npad = \"above=50\"", "pad"),
            ("cells = \"voronoi\"\ntopography = \"a.ts\"", "topography"),
            ("topography = \"a.ts\"", "topography"),
            ("weld = 0.01", "weld"),
            ("cells = \"voronoi\"\nlines = \"l.vtp\"", "lines"),
            ("seeding = \"canny\"\nlabel = [\"3:distance=2\"]", "label"),
            ("label = [\"3:name=a\", \"3:distance=2\"]", "label"),
            ("label = [\"3:name=a\", \"4:name=a\"]", "label"),
            ("label = [\"3:into=4\", \"4:into=5\"]", "label"),
            ("feature = \"edges\"\nlabel = [\"3:distance=2\"]", "label"),
            ("max-atoms = 9", "max-atoms"),
            ("well-distance = 3", "well-distance"),
            ("evaluator = \"sampled\"\nkappa = 0.7", "kappa"),
            ("distance = 8\ndistance-from = \"image\"", "distance-from"),
            ("feature = \"none\"\nsigma = 2", "sigma"),
            ("seeding = \"canny\"\nsurface = [\"a.ts\"]", "surface"),
            ("extend-faults = \"3\"", "extend-faults"),
            (
                "extend-faults = \"-1\"\nsurface = [\"a.ts\"]",
                "extend-faults",
            ),
            ("beta = 1", "beta"),
        ] {
            let error = read(text).unwrap().validate().unwrap_err().to_string();
            assert!(error.starts_with(&format!("{name} ")), "{text}: {error}");
            assert!(error.contains(": ") && error.contains("; "), "{error}");
        }
        // An option that has its default value is accepted.
        let text = "seeding = \"canny\"\nbeta = 0.5\ndistance = \"2.7:8\"";
        assert!(read(text).unwrap().validate().is_ok());
    }

    #[test]
    fn an_effort_is_a_preset_that_other_options_override() {
        for (text, angle) in [
            ("", 30.0),
            ("effort = \"draft\"", 15.0),
            ("effort = \"best\"", 30.0),
            ("effort = \"draft\"\nmin-dihedral = 30", 30.0),
        ] {
            let spec = read(text).unwrap().reproducible();
            assert_eq!(spec.target().unwrap().min_dihedral, angle, "{text}");
            assert_eq!(spec.min_dihedral, Some(angle), "{text}");
            assert_eq!(spec.effort.is_some(), !text.is_empty(), "{text}");
        }
        // The default has no entry of its own in the record.
        let spec = read("effort = \"normal\"").unwrap();
        assert_eq!(spec.reproducible(), read("").unwrap().reproducible());
    }

    #[test]
    fn invalid_values_are_refused() {
        for text in [
            "distance = \"0\"",
            "distance = \"9:4\"",
            "distance = \"a\"",
            "metric = \"1,2,3,4\"",
            "feature-weights = \"1,2\"",
            "label = [\"3:distance=0\"]",
            "object = [\"1\"]",
            "pad = \"200\"",
            "pad = \"above=0\"",
            "pad = \"left=5\"",
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains("; "), "{text}: {error}");
        }
    }

    #[test]
    fn a_record_of_version_0_1_0_is_understood() {
        let record = "distance = \"5\"\nfeature = \"ridges\"\ncells = \"voronoi\"\nbeta = \"0.5\"\n\
                      seeding = \"fcc\"\npotential = \"pairwise\"\nkappa = 1.0\noptimizer = \"lbfgs\"\n\
                      coarse-to-fine = 0\nmin-dihedral = 30.0\nslivers = \"joe\"\nweld = 0.0\n\
                      metric = \"samples\"\nrng-seed = 1\n\n[input]\n";
        let spec = read(record).unwrap();
        spec.validate().unwrap();
        assert_eq!(spec.cell_kind(), CellKind::Voronoi);
    }
}
