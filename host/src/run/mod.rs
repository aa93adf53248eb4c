//! The capture log.
