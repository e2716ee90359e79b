//! Figures beside the thesis's.

use serde::Serialize;
use std::fmt;

/// Mean and standard deviation of a pool of errors, of 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Values pooled.
    pub count: u64,
    /// Mean of estimate - truth.
    pub mean: f64,
    /// Standard deviation about it.
    pub sd: f64,
}

/// One line of a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What was compared.
    pub name: String,
    /// Ours.
    pub ours: Figures,
    /// The thesis's mean and standard deviation of 1, where it has them.
    pub thesis: Option<[f64; 2]>,
}

/// A table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// What it shows.
    pub title: String,
    /// Its lines.
    pub rows: Vec<Row>,
}

/// Sums errors up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pool {
    count: u64,
    sum: f64,
    squares: f64,
}

impl Pool {
    pub(super) fn add(&mut self, errors: impl IntoIterator<Item = f32>) {
        for e in errors {
            self.count += 1;
            self.sum += f64::from(e);
            self.squares += f64::from(e).powi(2);
        }
    }

    /// Adds what has been summed up elsewhere.
    pub(super) fn merge(&mut self, figures: Figures) {
        let n = figures.count as f64;
        self.count += figures.count;
        self.sum += n * figures.mean;
        self.squares += n * (figures.sd.powi(2) + figures.mean.powi(2));
    }

    /// `None` of nothing.
    pub(super) fn figures(&self) -> Option<Figures> {
        let n = self.count as f64;
        let mean = self.sum / n;
        let sd = (self.squares / n - mean * mean).max(0.0).sqrt();
        (self.count > 0).then_some(Figures { count: self.count, mean, sd })
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.title)?;
        let width = self.rows.iter().map(|r| r.name.chars().count()).max().unwrap_or(0).max(12);
        writeln!(
            f,
            "  {:<width$}  {:>20}  {:>20}  {:>20}  {:>20}",
            "of 1 (of 255)", "mean", "SD", "thesis's mean", "thesis's SD"
        )?;
        let both = |v: f64| format!("{v:+.5} ({:+.3})", 255.0 * v);
        let size = |v: f64| format!("{v:.5} ({:.3})", 255.0 * v);
        for row in &self.rows {
            write!(f, "  {:<width$}  {:>20}  {:>20}", row.name, both(row.ours.mean), size(row.ours.sd))?;
            match row.thesis {
                Some([mean, sd]) => writeln!(f, "  {:>20}  {:>20}", both(mean), size(sd))?,
                None => writeln!(f, "  {:>20}  {:>20}", "-", "-")?,
            }
        }
        Ok(())
    }
}

/// The thesis's figures of 255 as figures of 1.
pub(super) fn of_255(figures: [f64; 2]) -> [f64; 2] {
    figures.map(|v| v / 255.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pools_of_parts_are_the_pool_of_the_whole() {
        let values: Vec<f32> = (0..40).map(|i| (i * i % 17) as f32).collect();
        let (mut whole, mut parts) = (Pool::default(), Pool::default());
        whole.add(values.iter().copied());
        for part in values.chunks(7) {
            let mut own = Pool::default();
            own.add(part.iter().copied());
            parts.merge(own.figures().unwrap());
        }
        let (whole, parts) = (whole.figures().unwrap(), parts.figures().unwrap());
        assert_eq!(whole.count, parts.count);
        assert!((whole.mean - parts.mean).abs() < 1e-12 && (whole.sd - parts.sd).abs() < 1e-9);
        assert!(Pool::default().figures().is_none());
    }
}
