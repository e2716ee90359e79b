//! Files to results, in stages keyed by the digest of their inputs.

pub mod evaluate;
pub mod pairs;
pub mod scene;
