//! Files to results, in stages keyed by the digest of their inputs.

pub mod calibrate;
pub mod card_tags;
pub mod certify;
pub mod colour;
pub mod cost;
pub mod develop;
mod dress;
pub mod energy;
pub mod evaluate;
pub mod export;
pub mod flash;
pub mod levels;
mod manifest;
pub mod memory;
mod output;
pub mod pairs;
pub mod photos;
pub mod process;
mod report;
pub mod scale;
pub mod scene;
mod solve;
pub mod standing;
pub mod steadiness;
pub mod stops;
pub mod uvs;
pub mod views;
