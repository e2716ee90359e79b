//! The one integration-test binary; a module a subject.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test's helpers may fail as its body may")]

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that panics has spoken")]

mod evaluate;
mod capture;
mod fake_rig;
mod flash;
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on stops where it is")]

mod camera;
mod evaluate;
mod floors;
mod pairs;
mod raw;
mod scene_import;
mod session;
mod studio_world;
