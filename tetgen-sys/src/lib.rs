//! Raw bindings to libtet.
