//! Arrays written here and read again; those of others are judged in `tests/zarr.rs`.
