//! GLB and report, from plain inputs.

pub mod glb;
pub mod report;
