//! GLB and report, from plain inputs.

pub mod chart;
pub mod glb;
pub mod report;
