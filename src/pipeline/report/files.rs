//! How to read the files beside the report.

use crate::export::report::Block;

pub(super) fn blocks() -> Vec<Block> {
    let rows = [
        ["model.glb", "The object with its reflectance as base colour, for any viewer; 8 bits, metres."],
        [
            "reflectance.exr",
            "The texture to work with: 32-bit float, linear, row 0 at v = 1. Unseen parts are filled.",
        ],
        ["stddev.exr", "Its standard deviation, a channel each; 0 where views.exr is 0."],
        [
            "views.exr",
            "Y: views that made up each texel. surface: 1 on the object, 0 between charts. surface 1 and Y 0: no view \
             saw it, it was filled.",
        ],
        ["summary.json", "The figures above, for programs."],
        ["certificate.json", "Known patches against the texture, where there were any."],
    ];
    let rows = rows.into_iter().map(|row| row.map(str::to_owned).to_vec()).collect();
    vec![
        Block::Table { head: vec!["File", "What it holds"], rows },
        Block::Text(
            "To light the object anew, use the reflectance as the colour of a matt surface and nothing else: it \
             holds neither light nor shadow of the room."
                .into(),
        ),
    ]
}
