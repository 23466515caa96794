//! Methods as others have published them, kept to compare the default methods with them. With the
//! default options nothing here runs: `job` hands a method to the modules below where an option
//! chooses it. `docs/notes/published-methods.md` has figures.
//!
//! | module | paper | option |
//! |---|---|---|
//! | [`guide`] | Fernandes & Gattass 2009: atoms at random | `--seeding guide` |
//! | [`projection`] | Esperança et al. 2008: sites projected onto features | `--seeding projection` |
//! | `canny` | Xu 2016, chapters 2 and 4: atoms on Canny's points | `--seeding canny` |
//! | [`laplacian_distance`] | Hale 2002: d(x) from the potential | `--distance-from laplacian` |
//! | [`genetic`] | Fernandes & Gattass 2009: a genetic algorithm | `--optimizer genetic` |
//! | [`laplacian`] | Esperança et al. 2008: Laplacian coordinates | `--kappa` |
//! | [`sampled`] | Hale 2001, Algorithm 1: the energy on the image's grid | `--evaluator sampled` |
//! | `coarse_to_fine` | Hale 2001: smoother potentials first | `--coarse-to-fine` |
//! | [`relax`] | Xu 2016, section 2.3: smoothing by the image, in 2-D | `--smooth` |
//!
//! Two detectors after Xu (2016), for `--feature canny` and `--feature paths`, are with the others in
//! `feature::detectors`: the table there is what chooses a detector, and the properties of a kind of
//! feature come from its detector. The weight kappa of the energy between atoms stays a factor in
//! the kernels of `lattice::energy::pairwise`, and steepest descent (`--optimizer descent`) is L-BFGS
//! without its memory.

pub(crate) mod canny;
pub(crate) mod coarse_to_fine;
pub mod genetic;
pub mod guide;
pub mod laplacian;
pub mod laplacian_distance;
pub mod projection;
pub mod relax;
pub mod sampled;

pub use laplacian::RegularisedEnergy;
pub use sampled::SampledEnergy;
