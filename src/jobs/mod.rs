//! Queue, worker and one job's life.
