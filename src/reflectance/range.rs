//! How much of a texture lies outside what diffuse surfaces reflect: told, never clamped.
//!
//! Guides to physically based materials put the base colour of non-metals between 30 to 50 and 240 of 255 in sRGB,
//! which is about 0.015 to 0.03 and 0.87 of 1: charcoal reflects 0.02 to 0.04, fresh snow 0.8 to 0.9. The bounds here
//! are a little wider, and are held against the mean of a texel's channels, because a pure pigment may well reflect
//! next to nothing in one of them. Below 0 and above 1, where no surface can be, every channel is looked at.

use serde::{Deserialize, Serialize};

/// Range of diffuse reflectance of non-metals.
pub const DIFFUSE: std::ops::RangeInclusive<f32> = 0.02..=0.9;

/// Share of the seen texels that must lie outside before a sentence is made of it.
const WORTH_TELLING: f64 = 0.01;

/// Shares of the seen texels, 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OutOfRange {
    /// Mean of the channels below [`DIFFUSE`].
    pub dark: f64,
    /// Mean of the channels above it.
    pub bright: f64,
    /// A channel at least below 0.
    pub negative: f64,
    /// A channel at least above 1.
    pub above_one: f64,
}

impl OutOfRange {
    /// Counts.
    pub fn of(seen: impl IntoIterator<Item = [f32; 3]>) -> Self {
        let (mut count, mut dark, mut bright, mut negative, mut above_one) =
            (0_u64, 0_u64, 0_u64, 0_u64, 0_u64);
        for rho in seen {
            let mean = rho.iter().sum::<f32>() / 3.0;
            count += 1;
            dark += u64::from(mean < *DIFFUSE.start());
            bright += u64::from(mean > *DIFFUSE.end());
            negative += u64::from(rho.iter().any(|v| *v < 0.0));
            above_one += u64::from(rho.iter().any(|v| *v > 1.0));
        }
        let share = |n: u64| n as f64 / count.max(1) as f64;
        Self {
            dark: share(dark),
            bright: share(bright),
            negative: share(negative),
            above_one: share(above_one),
        }
    }

    /// A sentence for each share that is worth one: how much, and what may be wrong.
    pub fn warnings(&self) -> Vec<String> {
        let [low, high] = [DIFFUSE.start(), DIFFUSE.end()];
        let told = [
            (
                self.dark,
                format!(
                    "of the seen texels reflect less than {low}, less than charcoal: metal and glass do, and so does all if the card was darker than --target-reflectance says or the flash was moved after calibration"
                ),
            ),
            (
                self.bright,
                format!(
                    "of the seen texels reflect more than {high}, more than fresh snow: gloss and metal do towards the flash, and so does all if the card was brighter than --target-reflectance says or lengths are not true (--unit, --scale)"
                ),
            ),
            (
                self.negative,
                "of the seen texels have a channel below 0: noise about black, or light of the room that changed between the two frames".to_owned(),
            ),
            (
                self.above_one,
                "of the seen texels have a channel above 1, which no matt surface can: gloss, metal, or a calibration of the flash that is too weak".to_owned(),
            ),
        ];
        let worth = |(share, text): (f64, String)| {
            (share >= WORTH_TELLING)
                .then(|| format!("{:.1} % {text}. Values are kept as measured.", 100.0 * share))
        };
        told.into_iter().filter_map(worth).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_count_each_kind_and_a_pure_pigment_is_none() {
        let texels = [[0.5; 3], [0.01; 3], [0.95; 3], [0.4, 0.001, 0.3], [-0.01, 0.5, 0.5], [0.2, 0.3, 1.4]];
        let sixth = 1.0 / 6.0;
        let counted = OutOfRange::of(texels);
        assert_eq!(counted, OutOfRange { dark: sixth, bright: sixth, negative: sixth, above_one: sixth });
        assert_eq!(counted.warnings().len(), 4);
        assert!(counted.warnings()[0].starts_with("16.7 % of the seen texels reflect less than 0.02"));
    }

    #[test]
    fn a_few_texels_outside_and_no_texels_at_all_are_not_worth_a_word() {
        let mut texels = vec![[0.5; 3]; 1000];
        texels.push([2.0; 3]);
        assert!(OutOfRange::of(texels).warnings().is_empty());
        assert_eq!(OutOfRange::of([]), OutOfRange::default());
    }
}
