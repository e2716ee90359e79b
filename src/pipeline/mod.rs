//! Files to results, in stages keyed by the digest of their inputs.

pub mod pairs;
pub mod evaluate;
pub mod scene;
