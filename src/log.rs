//! What the log says: of what (`UNLIT_LOG`), in which form, and whose line it is. Users read events and errors; the log is
//! for whoever looks for a cause.
//!
//! Lines carry the spans that they were written in: `request`, `job`, `pair`, `camera_host`. These spans have the level
//! of errors, so that a warning says whose it is whatever `UNLIT_LOG` leaves out.

use std::io::IsTerminal;
use std::process::Command;
use std::str::FromStr;
use std::sync::OnceLock;
use tracing_subscriber::EnvFilter;

/// Names the parts of the program and levels to be logged.
const FILTER: &str = "UNLIT_LOG";
/// Names the form; how a child process knows it.
const FORMAT: &str = "UNLIT_LOG_FORMAT";
/// What is logged if nobody says.
const USUAL: &str = "warn";

static STARTED: OnceLock<(Format, String)> = OnceLock::new();

/// The form of the log's lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// A line for people.
    #[default]
    Human,
    /// An object a line, for programs that collect logs.
    Json,
}

impl Format {
    /// As the environment says; a line for people where it says nothing that is known.
    pub fn inherited() -> Self {
        std::env::var(FORMAT).ok().and_then(|text| text.parse().ok()).unwrap_or_default()
    }
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Format::Human => "human",
            Format::Json => "json",
        })
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "human" => Ok(Format::Human),
            "json" => Ok(Format::Json),
            _ => Err("a log is `human` or `json`".to_owned()),
        }
    }
}

/// Begins to log on stderr; what was begun already stays as it is.
pub fn start(format: Format) {
    let asked = std::env::var(FILTER).ok().filter(|text| !text.is_empty());
    let (filter, refused) = match asked.as_deref().unwrap_or(USUAL).parse::<EnvFilter>() {
        Ok(filter) => (filter, None),
        Err(error) => (EnvFilter::new(USUAL), Some(error)),
    };
    let told = filter.to_string();
    let coloured = std::io::stderr().is_terminal();
    let lines =
        tracing_subscriber::fmt().with_env_filter(filter).with_ansi(coloured).with_writer(std::io::stderr);
    let begun = match format {
        Format::Human => lines.try_init(),
        Format::Json => lines.json().try_init(),
    };
    if begun.is_ok() {
        STARTED.get_or_init(|| (format, told));
    }
    if let Some(error) = refused {
        tracing::warn!("{FILTER} is not understood ({error}); the log has what `{USUAL}` lets through");
    }
}

/// What is logged, as `UNLIT_LOG` would say it.
pub fn filter() -> &'static str {
    STARTED.get().map_or("off", |(_, filter)| filter)
}

/// Has a child process of this program log in the same form.
pub fn pass_on(child: &mut Command) {
    child.env(FORMAT, STARTED.get().map_or_else(Format::inherited, |(format, _)| *format).to_string());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_known_by_the_names_that_they_print() {
        for format in [Format::Human, Format::Json] {
            assert_eq!(format.to_string().parse(), Ok(format));
        }
        assert!("xml".parse::<Format>().unwrap_err().contains("json"));
    }

    #[test]
    fn a_child_is_told_the_form() {
        let mut child = Command::new("true");
        pass_on(&mut child);
        let told = child.get_envs().find(|(name, _)| *name == FORMAT).and_then(|(_, value)| value);
        assert!(told.is_some_and(|value| value == "human" || value == "json"), "{told:?}");
    }
}
