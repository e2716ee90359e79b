//! Light: the ray kernel, the ring lamp, direct light, and the transport of bounces.

mod kernel;

pub use kernel::{Hit, RayKernel};
