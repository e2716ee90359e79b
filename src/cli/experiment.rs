//! `unlit experiment`: the thesis's tables in the simulated studio.

use super::{CliError, CliResult, Exit, progress_bar};
use crate::progress::Progress;
use crate::studio::experiment::{self, Kind, Options};
use clap::ValueEnum;

/// Arguments of `unlit experiment`.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Which one.
    experiment: Name,
    /// Fewer views, pixels and rays.
    #[arg(long)]
    quick: bool,
    /// Seed of renders and noise: the same figures for the same seed.
    #[arg(long, default_value_t = 1)]
    seed: u32,
    /// Threads to compute on; all cores by default.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print JSON; means and standard deviations of 1.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Name {
    /// Table 2.2: isolating and dividing, without bounces.
    Poc,
    /// Table 2.3: 8 and 14 bits, exposures, flash factors.
    Precision,
    /// Table 2.4: bounced light.
    Gi,
    /// Tables 12.1 and 12.2: 45 views, raw files to texture.
    Synthetic,
    /// A glossy coat on the object.
    Varnish,
}

impl From<Name> for Kind {
    fn from(name: Name) -> Self {
        match name {
            Name::Poc => Self::Poc,
            Name::Precision => Self::Precision,
            Name::Gi => Self::Gi,
            Name::Synthetic => Self::Synthetic,
            Name::Varnish => Self::Varnish,
        }
    }
}

/// Runs it and prints.
pub(super) fn run(args: Args) -> CliResult {
    let (bar, progress) = progress_bar::watched();
    cancel_on_interrupt(&progress)?;
    let options = Options { quick: args.quick, seed: args.seed };
    let threads = usize::from(args.threads.unwrap_or(0));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(CliError::new)?;
    let outcome = pool.install(|| experiment::run(args.experiment.into(), options, &progress));
    bar.finish_and_clear();
    let outcome = outcome.map_err(CliError::new)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&outcome).map_err(CliError::new)?);
        return Ok(Exit::Success);
    }
    println!("{}", outcome.about);
    for table in &outcome.tables {
        println!("\n{}", table.to_string().trim_end());
    }
    for note in &outcome.notes {
        println!("\n{note}");
    }
    Ok(Exit::Success)
}

/// Ctrl-C stops the work at its next look at the flag, so that temporary folders are cleared away.
fn cancel_on_interrupt(progress: &Progress) -> Result<(), CliError> {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(CliError::new)?;
    let progress = progress.clone();
    std::thread::spawn(move || {
        if runtime.block_on(tokio::signal::ctrl_c()).is_ok() {
            progress.cancel();
        }
    });
    Ok(())
}
