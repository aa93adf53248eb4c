//! Phase 4: adaptive refinement of the faces that hold a point beyond the tolerance.

pub mod templates;
