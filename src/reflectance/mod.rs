//! Reflectance: measured light over simulated light, solved for every surface point over all views.
//!
//! Image by image the ratio explodes where little light falls: at grazing angles, silhouettes and shadow
//! edges. So measured and simulated light stay apart. On surface elements each point's reflectance rho minimises
//! `sum of w (P - rho m)^2` over the views that see it, m being what a white surface would have read
//! ([`observe`], [`solve`]); bounced light depends on rho, so [`bounce`] simulates it with the estimate so far and
//! solves again until it stands still, and [`robust`] finds a gloss that a whole surface shares. The texels are
//! then solved together against the sensor sites of all views, through the lens ([`project`], [`joint`]); how far they may
//! be off comes from the views' disagreement. [`atlas`] and [`unwrap`] lay the surface out in the texture, [`maps`]
//! gives the per-view images for those who texture elsewhere.
//!
//! Units: light in DN of the sensor, so that the lamp's calibrated radiance is all that ties them together;
//! reflectance unit-free, camera RGB, Lambertian (exitance over irradiance).

pub mod atlas;
pub mod bounce;
pub mod joint;
pub mod maps;
mod mirror;
pub mod observe;
pub mod orientation;
pub mod pieces;
pub mod project;
pub mod projection;
pub mod range;
pub mod robust;
pub mod solve;
pub mod stage;
pub mod texture;
mod uncertainty;
pub mod unwrap;
