//! Light: the ray kernel, lamps, direct light, its mean over a camera's pixels, and the transport of bounces.

mod depth;
mod divide;
mod elements;
mod emitter;
mod film;
mod kernel;
mod occluders;
mod patches;
mod ring;
mod sight;
mod transport;
mod tree;

pub use elements::{Elements, interpolate};
pub use emitter::{Emitter, EmitterError, Shape};
pub use film::{Finish, Spot, expose};
pub use kernel::{Hit, RayKernel};
pub use occluders::Occluders;
pub use patches::{Patches, SPOTS};
pub use ring::{Draw, Ring, RingError};
pub use sight::Sight;
pub use transport::Transport;
