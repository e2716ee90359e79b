//! GLB, colour spaces and report, from plain inputs.

pub mod chart;
pub mod colour;
pub mod glb;
pub mod report;
