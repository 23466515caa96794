//! Tests of the resident session by lines of scripts are in `cli::script`, which parses them.
