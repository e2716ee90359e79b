//! The certificate's section: known patches against the texture.

use super::{fact, moment};
use crate::export::report::Block;
use crate::pipeline::certify::{HEAD, Standing, rows};

pub(super) fn blocks(standing: Option<&Standing>) -> Vec<Block> {
    let Some(Standing { certificate, stale }) = standing else {
        return vec![Block::Text(
            "None: no patch of known reflectance was compared with this model. `unlit certify` does it."
                .into(),
        )];
    };
    let made = moment(&certificate.made);
    if *stale {
        return vec![Block::Text(format!(
            "STALE: the certificate of {made} UTC is of another model than this one. Run `unlit certify` again."
        ))];
    }
    let mut blocks: Vec<Block> = certificate.verdict.sentences.iter().cloned().map(Block::Text).collect();
    blocks.push(Block::Table { head: HEAD.to_vec(), rows: rows(&certificate.patches) });
    let colours = certificate.colour.as_ref().map_or_else(|| "not known".into(), |basis| basis.words());
    blocks.push(Block::Facts(vec![
        fact("Made", format!("{made} UTC, {}", certificate.software)),
        fact("Camera's colours", colours),
        fact("Texture (BLAKE3)", certificate.inputs.reflectance_blake3.clone()),
        fact("List of patches (BLAKE3)", certificate.inputs.patches_blake3.clone()),
    ]));
    blocks
}
