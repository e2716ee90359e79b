//! What the stages of a run cost.

use serde::{Deserialize, Serialize};
use std::time::Instant;

/// One stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// What was done.
    pub stage: String,
    /// Seconds on the clock.
    pub wall: f64,
    /// Seconds of all processors together, of this process.
    pub cpu: f64,
}

/// Notes stage after stage.
pub(super) struct Costs {
    began: (Instant, f64),
    pub(super) list: Vec<Cost>,
}

impl Costs {
    pub(super) fn begin() -> Self {
        Self { began: (Instant::now(), cpu()), list: vec![] }
    }

    /// Ends a stage, and begins the next; one that comes again adds to what it took before.
    pub(super) fn done(&mut self, stage: &str) {
        let (wall, before) = self.began;
        let now = cpu();
        let (wall, cpu) = (wall.elapsed().as_secs_f64(), now - before);
        match self.list.iter_mut().find(|c| c.stage == stage) {
            Some(cost) => (cost.wall, cost.cpu) = (cost.wall + wall, cost.cpu + cpu),
            None => self.list.push(Cost { stage: stage.into(), wall, cpu }),
        }
        self.began = (Instant::now(), now);
    }
}

/// Processor seconds that this process has used.
fn cpu() -> f64 {
    let spent = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    spent.tv_sec as f64 + spent.tv_nsec as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_is_counted_and_waiting_is_not() {
        let mut costs = Costs::begin();
        let until = cpu() + 0.05;
        while cpu() < until {
            std::hint::spin_loop();
        }
        costs.done("work");
        costs.done("nothing");
        assert!(costs.list[0].cpu >= 0.05 && costs.list[1].cpu < costs.list[0].cpu, "{:?}", costs.list);
    }
}
