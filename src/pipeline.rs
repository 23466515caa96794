//! The whole job: image in, mesh out (under construction).
