//! Processes that share a job: the ranks of MPI, if the program is `atomesh-mpi`.
//!
//! Every rank runs the whole job and has a communicator ([`Comm`]). The driver hands it to distributed data
//! structures, which keep it to themselves and offer operations on their data. Work in parts, such as windows of an
//! image's layers or slabs of points, is distributed (`distribute`): each rank does some of the parts, and all ranks
//! receive the results of all parts in the order of the parts. So the outcome is the same on every rank and for any
//! number of ranks. Where no rank needs everything, each rank holds a part and sends the others what they need of it.
//! Only the root (rank 0) prints, and writes what is not in parts.
//!
//! Before ranks exchange anything, they tell one another where they are and whether one has failed; then all end with
//! its error.
//!
//! - `collective`: the trait [`Comm`], its collective operations, and [`SelfComm`], a group of one
//! - `mpi_comm`: [`MpiComm`], all ranks of MPI
//! - `world`: the calls of MPI that [`MpiComm`] needs, as the program passes them in
//! - `launch`: how this process was started
//! - `partition_range`: how parts are divided among ranks
//! - `selection`: values by their rank in sorted order, among those that all ranks have
//! - `thread_comm`: threads in place of ranks, for tests

mod collective;
mod launch;
mod mpi_comm;
mod partition_range;
pub(crate) mod selection;
#[cfg(test)]
mod thread_comm;
pub mod world;

pub use collective::{Comm, SelfComm, concatenate};
#[cfg(feature = "cli")]
pub use launch::ranks_sharing_processors;
pub use mpi_comm::MpiComm;
pub use partition_range::partition_range;
#[cfg(test)]
pub(crate) use thread_comm::run_threads;
