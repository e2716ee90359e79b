//! Pose refinement.
