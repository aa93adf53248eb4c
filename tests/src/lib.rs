//! Shared fixtures of the whole-program tests.
