//! The one integration-test binary; a module a subject.

mod evaluate;
mod floors;
mod scene_import;
mod raw;
mod session;
mod studio_world;
