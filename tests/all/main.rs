//! The one integration-test binary; a module a subject.

mod floors;
mod pairs;
mod raw;
mod session;
mod scene_import;
