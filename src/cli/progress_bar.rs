//! One progress bar for every command that takes long: on stderr, and only where someone looks at it.

use crate::progress::Progress;
use indicatif::{ProgressBar, ProgressStyle};

/// A bar, and the progress that moves it. Finish the bar when the work is done.
pub(super) fn watched() -> (ProgressBar, Progress) {
    let bar = ProgressBar::new(0);
    // The template is a constant that indicatif accepts; its default would do as well.
    if let Ok(style) = ProgressStyle::with_template("{prefix} [{bar:24}] {msg}") {
        bar.set_style(style.progress_chars("=> "));
    }
    let shown = bar.clone();
    let progress = Progress::new(move |report| {
        shown.set_length(report.total);
        shown.set_position(report.done);
        shown.set_message(report.stage.clone());
    });
    (bar, progress)
}
