//! The one integration-test binary; a module a subject.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test's helpers may fail as its body may")]
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on stops where it is")]

mod api;
mod camera;
mod capture;
mod evaluate;
mod fake_rig;
mod flash;
mod floors;
mod pairs;
mod raw;
mod scene_import;
mod session;
mod studio_world;
