//! The one integration-test binary; a module a subject.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on stops where it is")]

mod camera;
mod floors;
