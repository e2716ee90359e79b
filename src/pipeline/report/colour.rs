//! What the colours are, in words.

use crate::pipeline::colour::SessionColours;

pub(super) fn words(colours: &SessionColours) -> String {
    let words = match &colours.matrix {
        Some(matrix) => format!(
            "The float files are in camera RGB; colours of model.glb are sRGB by a matrix {}.",
            matrix.basis.words()
        ),
        None => "Colour space: camera RGB, uncalibrated. The channels are the camera's own, so colours are right only in \
                 relation to each other; no colour chart went into this."
            .into(),
    };
    colours.note.iter().fold(words, |words, note| format!("{words} Note: {note}"))
}
