//! The one integration-test binary; a module a subject.

mod floors;
mod scene_import;
mod raw;
