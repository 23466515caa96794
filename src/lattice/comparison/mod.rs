//! Methods as others have published them, kept to compare the default methods with them. Nothing
//! here is used by default; `docs/notes/published-methods.md` has figures.
//!
//! - [`genetic`]: optimises a population of lattices, instead of L-BFGS (`--optimizer genetic`)
//! - [`laplacian`]: adds Laplacian coordinates to the energy (`--kappa`)
//! - `sampled`: the energy from a field sampled like the image (`--evaluator sampled`)
//! - `guide`: draws atoms from guide tables (`--seeding guide`)
//! - `projection`: projects sites onto features (`--seeding projection`)

pub mod genetic;
pub(crate) mod guide;
pub mod laplacian;
pub(crate) mod projection;
pub(crate) mod sampled;
