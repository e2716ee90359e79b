//! `unlit` takes the light out of photographed objects.
//!
//! A tethered camera and a ring flash take flash-off/flash-on pairs round an object with one locked
//! exposure. Off is subtracted from on, so that only the flash's own light is left; the light that the
//! flash must have thrown on the reconstructed surface is simulated; the ratio of the two, solved for
//! every surface point over all views, is the surface's diffuse reflectance.
//!
//! # Map of the house
//!
//! A module uses only modules further down this list (`tests/all/floors.rs` holds it to that).
//!
//! | floor | what it is for |
//! |---|---|
//! | [`cli`], [`http`] | faces: they parse and print, nothing else |
//! | [`studio`] | the simulated world: camera on PTP/IP, flash board on a pty, path-traced object |
//! | [`capture`] | one pair from arming to commit; sole owner of the rig |
//! | [`rig`] | camera (libgphoto2 in a child process), flash controller (serial), USB |
//! | [`pipeline`] | files to results; every stage keyed by the digest of its inputs |
//! | [`jobs`] | queue and life of long work |
//! | [`session`] | the folder: layout, journal, atomic writes, checksums, lock |
//! | [`export`] | GLB and report, from plain inputs |
//! | [`reflectance`] | weighted least squares per surface point, iterated with the bounces |
//! | [`calibration`] | fits from calibration shots |
//! | [`light`] | ray kernel, ring lamp, direct light, transport of bounces |
//! | [`scene`] | meshes, cameras, importers |
//! | [`codec`] | the only caller of file decoders and encoders |
//! | [`pair`] | pure: settings, checks and verdicts of a pair |
//! | [`photometry`] | pure: sensor values, levels, noise, isolation of the known light |
//! | [`raster`] | pure: images, filters, statistics |
//! | [`log`], [`progress`], [`units`] | the log's form, progress and cancelling, physical quantities |

pub mod calibration;
pub mod capture;
pub mod cli;
pub mod codec;
pub mod export;
pub mod http;
pub mod jobs;
pub mod light;
pub mod log;
pub mod pair;
pub mod photometry;
pub mod pipeline;
pub mod progress;
pub mod raster;
pub mod reflectance;
pub mod rig;
pub mod scene;
pub mod session;
pub mod studio;
pub mod units;
