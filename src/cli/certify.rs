//! `unlit certify`: known patches against a session's finished reflectance.

use super::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::certify::{Certificate, HEAD, certify, rows};
use std::path::PathBuf;

/// Arguments of `unlit certify`.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Session folder, processed.
    session: PathBuf,
    /// List of patches: name, what each reflects, where it is; docs/certificate.md shows its form.
    patches: PathBuf,
    /// The certificate as JSON, the same as model/certificate.json.
    #[arg(long)]
    json: bool,
}

/// Certifies and prints.
pub(super) fn run(args: &Args) -> CliResult {
    let session = open_session(&args.session)?;
    let (bar, progress) = progress_bar::watched();
    let certificate = certify(&session, &args.patches, &progress);
    bar.finish_and_clear();
    let certificate = certificate.map_err(CliError::new)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&certificate).map_err(CliError::new)?);
    } else {
        print!("{}", words(&certificate));
    }
    Ok(if certificate.verdict.good { Exit::Success } else { Exit::Failure })
}

fn words(certificate: &Certificate) -> String {
    let table: Vec<Vec<String>> =
        std::iter::once(HEAD.map(str::to_owned).to_vec()).chain(rows(&certificate.patches)).collect();
    let width = |column: usize| table.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..HEAD.len()).map(width).collect();
    let mut text = certificate.verdict.sentences.join("\n") + "\n\n";
    for row in &table {
        let cells: Vec<String> =
            row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
        text += cells.join("  ").trim_end();
        text.push('\n');
    }
    text
}
