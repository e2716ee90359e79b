//! The world before the simulated lens.

mod bowl;
mod glaze;
mod patch;
mod path;
mod render;
mod sampler;
mod stage;
