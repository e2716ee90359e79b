//! GLB, colour spaces and report, from plain inputs.

pub mod calibration_report;
pub mod chart;
pub mod colour;
pub mod glb;
pub mod report;
