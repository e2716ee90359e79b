//! `model/report.html`: what a run made, from what, and how far to trust it.

mod certificate;
mod colour;
mod files;
mod flash;
mod previews;

use super::certify::Standing;
use super::colour::SessionColours;
use super::cost::Cost;
use super::energy::FlashAccount;
use super::process::ProcessSummary;
use crate::calibration::FlashCalibration;
use crate::codec::png::PngError;
use crate::export::report::{self, Block, Report, Section};
use crate::pair::PairRecord;
use crate::photometry::FlashGain;
use crate::reflectance::robust::Lobe;
use crate::reflectance::unwrap::UvSource;
use crate::session::Manifest;
pub(in crate::pipeline) use flash::repeatability;
pub(super) use previews::Estimates;
use previews::previews;

/// What the report tells of.
pub(super) struct Told<'a> {
    pub(super) manifest: &'a Manifest,
    pub(super) calibration: &'a FlashCalibration,
    /// Pairs that went in.
    pub(super) pairs: Vec<&'a PairRecord>,
    pub(super) summary: &'a ProcessSummary,
    pub(super) flash: &'a FlashAccount,
    pub(super) colours: &'a SessionColours,
    pub(super) certificate: Option<&'a Standing>,
    pub(super) estimates: Estimates<'a>,
}

/// The report as HTML.
pub(super) fn html(told: &Told<'_>) -> Result<String, PngError> {
    let title = format!("Reflectance of {}", told.manifest.name);
    let n = told.summary.used.len();
    let subtitle = format!(
        "{n} {}, session made {} UTC, {}",
        if n == 1 { "pair" } else { "pairs" },
        moment(&told.manifest.created),
        told.manifest.software
    );
    let sections = vec![
        Section { heading: "The texture", blocks: vec![Block::Pictures(previews(told.estimates)?)] },
        Section { heading: "Figures", blocks: figures(told) },
        Section { heading: "Certificate", blocks: certificate::blocks(told.certificate) },
        Section { heading: "Camera and flash", blocks: rig(told) },
        Section { heading: "Scaled, and held in part", blocks: remarks(told.summary) },
        Section { heading: "The flash over the session", blocks: flash::blocks(told.flash) },
        Section { heading: "Pairs", blocks: pairs(told.summary) },
        Section { heading: "What it cost", blocks: costs(told.summary) },
        Section { heading: "How to read the files", blocks: files::blocks() },
    ];
    Ok(report::html(&Report { title: &title, subtitle: &subtitle, sections }))
}

fn figures(told: &Told<'_>) -> Vec<Block> {
    let summary = told.summary;
    let range = &summary.out_of_range;
    let moved: Vec<String> = summary.rounds.iter().map(|r| format!("{:.5}", r.mean_change)).collect();
    let mut facts = vec![
        fact("Texture", format!("{n} x {n} texels", n = summary.texture_size)),
        fact("Surface seen", percent(summary.seen)),
        fact("Mean reflectance", three(summary.mean_reflectance, 4)),
        fact("Median standard deviation", format!("{:.4}", summary.median_deviation)),
        fact("Rounds of bounces", format!("{}; reflectance moved by {}", moved.len(), moved.join(", "))),
        fact("Texels solved", solved(summary)),
        fact(
            "Blur of the lens (R G B)",
            format!("{} pixels, standard deviation", three(summary.blur.map(f64::from), 2)),
        ),
        fact("Gloss taken off", gloss(summary)),
        fact("Texture coordinates", coordinates(&summary.uvs)),
        fact(
            "Darker than 0.02, brighter than 0.9",
            format!(
                "{}, {} of the seen texels, mean of the channels",
                percent(range.dark),
                percent(range.bright)
            ),
        ),
        fact(
            "Below 0, above 1",
            format!("{}, {}, in one channel at least", percent(range.negative), percent(range.above_one)),
        ),
    ];
    if !summary.turned.is_empty() {
        facts.push(fact("Turned to face the cameras", summary.turned.join(", ")));
    }
    let mut blocks = vec![
        Block::Facts(facts),
        Block::Text(format!("Reflectance runs from 0 to 1 and is linear. {}", colour::words(told.colours))),
        Block::Text(
            "Rendering programs expect diffuse colours between about 0.02 (charcoal) and 0.9 (fresh snow). Values \
             outside are kept as they were measured."
                .into(),
        ),
    ];
    blocks.extend(range.warnings().into_iter().map(Block::Text));
    blocks
}

fn solved(summary: &ProcessSummary) -> String {
    let pieces = match summary.pieces {
        0 | 1 => "all together".to_owned(),
        n => format!("in {n} pieces"),
    };
    let runs: Vec<String> = summary.runs.iter().map(|r| format!("{:.3}", r.misfit)).collect();
    format!("{pieces}; squared residual over what noise and model explain, run by run: {}", runs.join(", "))
}

fn gloss(summary: &ProcessSummary) -> String {
    let of = |(mesh, lobe): (usize, &Option<Lobe>)| {
        let lobe = lobe.as_ref()?;
        let (weight, width) = (percent(f64::from(lobe.weight)), lobe.alpha);
        Some(format!("mesh {}: {weight} of the light, GGX width {width:.2}", mesh + 1))
    };
    let found: Vec<String> = summary.gloss.iter().enumerate().filter_map(of).collect();
    if found.is_empty() { "none was found".into() } else { found.join("; ") }
}

fn coordinates(uvs: &UvSource) -> String {
    match uvs {
        UvSource::Own => "the mesh's own".into(),
        UvSource::Made(made) => format!(
            "made, because {}; {} charts, {} of the texture, lengths shortened {:.2} times at most, {:.2} on average",
            made.why,
            made.charts,
            percent(made.coverage),
            made.stretch[0],
            made.stretch[1]
        ),
    }
}

fn costs(summary: &ProcessSummary) -> Vec<Block> {
    let cost =
        |c: &Cost| fact(&c.stage, format!("{:.1} s, {:.1} s of all processors together", c.wall, c.cpu));
    vec![Block::Facts(summary.costs.iter().map(cost).collect())]
}

fn rig(told: &Told<'_>) -> Vec<Block> {
    let fit = told.calibration;
    let mut facts = vec![];
    if let Some(settings) = told.pairs.first().map(|p| &p.on.settings) {
        // Most models name their maker.
        let named = |make: &&String| settings.model.as_ref().is_none_or(|m| !m.starts_with(make.as_str()));
        let names = [settings.make.as_ref().filter(named), settings.model.as_ref(), settings.lens.as_ref()];
        let camera: Vec<&str> = names.into_iter().flatten().map(String::as_str).collect();
        let exposure = [
            settings.shutter.map(|s| s.to_string()),
            settings.aperture.map(|n| n.to_string()),
            settings.iso.map(|i| i.to_string()),
        ];
        let exposure: Vec<String> = exposure.into_iter().flatten().collect();
        facts.extend([
            fact("Camera", or_untold(camera.join(", "))),
            fact("Exposure", or_untold(exposure.join(", "))),
        ]);
    }
    let times = || told.pairs.iter().filter_map(|p| p.off.settings.taken_at.as_deref());
    if let (Some(first), Some(last)) = (times().min(), times().max()) {
        let span = format!("{} to {}, the camera's clock", moment(first), moment(last));
        facts.push(fact("Photographed", span));
    }
    let [a1, a2, a3] = fit.field.coefficients;
    let radiance = match fit.radiance_dn_standard_error {
        Some(error) => format!("{} DN, standard error {} DN", three(fit.radiance_dn, 0), three(error, 0)),
        None => format!("{} DN, not from a fit", three(fit.radiance_dn, 0)),
    };
    facts.extend([
        fact("Ring, radii", format!("{} to {} m", fit.ring.inner, fit.ring.outer)),
        fact("Ring, radiance (R G B)", radiance),
        fact(
            "Vignetting times lobe",
            format!("1 {a1:+.4} q {a2:+.4} q\u{b2} {a3:+.4} q\u{b3}, q = (r / half diagonal)\u{b2}"),
        ),
        fact(
            "Noise",
            format!("variance = {:.4} DN \u{d7} signal + {:.2} DN\u{b2}", fit.noise.gain, fit.noise.floor),
        ),
        fact("Card", format!("reflectance taken to be {}", fit.target_reflectance)),
        fact("Residual of the fit", percent(fit.residual_rms)),
        fact("Of it not the sensor's noise", percent(fit.misfit_rms)),
    ]);
    let rows = fit.cards.iter().map(|shot| {
        let used = |text: Option<String>| text.filter(|_| shot.used).unwrap_or_else(|| "left out".into());
        let measured = shot.measured_gain.map_or_else(|| "not measured".into(), |g| format!("{g:.4}"));
        vec![
            shot.label.clone(),
            format!("{} m", shot.distance_m),
            used(shot.gain.map(|gain| format!("{gain:.4}"))),
            used(Some(measured)),
            used(shot.residual_rms.map(percent)),
            percent(shot.clipped_share),
        ]
    });
    let head = vec!["Card shot", "Distance", "Flash, relative", "By photodiode", "Residual", "Clipped"];
    vec![Block::Facts(facts), Block::Table { head, rows: rows.collect() }]
}

/// By what exposures were scaled, and which calibrations hold only in part.
fn remarks(summary: &ProcessSummary) -> Vec<Block> {
    let ratios = Block::Facts(vec![fact("Exposures", summary.ratios.words())]);
    std::iter::once(ratios).chain(summary.remarks.iter().cloned().map(Block::Text)).collect()
}

fn pairs(summary: &ProcessSummary) -> Vec<Block> {
    let mut blocks = vec![Block::Text(format!("In the model: {}.", summary.used.join(", ")))];
    let energy = |(name, gain): (&String, &FlashGain)| {
        vec![name.clone(), format!("{:.4}", gain.value), format!("{:.4}", gain.deviation)]
    };
    if !summary.gains.is_empty() {
        blocks.push(Block::Table {
            head: vec!["Pair", "Energy of its pulse, the calibration's being 1", "Standard deviation"],
            rows: summary.gains.iter().map(energy).collect(),
        });
    }
    if summary.left_out.is_empty() {
        blocks.push(Block::Text("None was left out.".into()));
    } else {
        let rows = summary.left_out.iter().map(|l| vec![l.name.clone(), l.why.clone()]).collect();
        blocks.push(Block::Table { head: vec!["Left out", "Why"], rows });
    }
    blocks
}

pub(in crate::pipeline) fn fact(name: &str, value: String) -> (String, String) {
    (name.to_owned(), value)
}

/// Date and minute of an ISO 8601 moment.
pub(in crate::pipeline) fn moment(iso: &str) -> String {
    iso.get(..16).unwrap_or(iso).replace('T', " ")
}

pub(in crate::pipeline) fn or_untold(text: String) -> String {
    if text.is_empty() { "the files do not tell".into() } else { text }
}

fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}

fn three(values: [f64; 3], digits: usize) -> String {
    values.map(|v| format!("{v:.digits$}")).join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{CardResidual, FieldFactor};
    use crate::light::Ring;
    use crate::pair::energy::{EnergyScale, trend};
    use crate::photometry::NoiseModel;
    use crate::pipeline::process::LeftOut;
    use crate::reflectance::bounce::Round;
    use crate::reflectance::range::OutOfRange;
    use crate::reflectance::solve::Estimate;
    use crate::reflectance::unwrap::UvChoice;

    fn of(name: &str, rho: [f32; 3]) -> String {
        let manifest = Manifest {
            schema: 1,
            name: name.into(),
            created: "2026-01-02T03:04:05Z".into(),
            software: "unlit 0".into(),
            plan: None,
            region: None,
            confirmed: Vec::new(),
            lighting: Default::default(),
        };
        let calibration = FlashCalibration {
            ring: Ring::new(0.035, 0.085).unwrap(),
            radiance_dn: [51_234.0, 52_345.0, 43_456.0],
            radiance_dn_interval_95: None,
            radiance_dn_standard_error: None,
            field: FieldFactor { coefficients: [-0.1234, 0.0, 0.0] },
            colour_vignetting: None,
            noise: NoiseModel { gain: 0.3125, floor: 4.5 },
            target_reflectance: 0.94,
            iso: None,
            aperture: None,
            focal_length_mm: None,
            energy_counts: None,
            cards: vec![CardResidual {
                label: "card-far.dng".into(),
                distance_m: 1.4,
                gain: Some(1.0),
                measured_gain: None,
                residual_rms: Some(0.0021),
                clipped_share: 0.0,
                used: true,
                left_out: None,
                prediction_error: None,
                prediction_error_interval_95: None,
                held_out: false,
            }],
            residual_rms: 0.0037,
            misfit_rms: 0.0012,
            findings: Default::default(),
        };
        let summary = ProcessSummary {
            used: vec!["0001".into()],
            remarks: vec!["Scaled, pair 0001: shot at ISO 200.".into()],
            left_out: vec![LeftOut { name: "0002".into(), why: "rejected: <the vase moved>".into() }],
            texture_size: 640,
            seen: 0.875,
            median_deviation: 0.0123,
            mean_reflectance: [0.25, 0.5, 0.75],
            rounds: vec![Round { mean_change: 0.002 }],
            runs: vec![],
            gains: Default::default(),
            ratios: Default::default(),
            blur: [0.9; 3],
            gloss: vec![None],
            pieces: 1,
            looks: 1,
            costs: vec![],
            turned: vec![],
            uv_choice: UvChoice::Auto,
            uvs: UvSource::Own,
            object: String::new(),
            out_of_range: OutOfRange::of(std::iter::repeat_n(rho, 1).chain([[0.5; 3]; 3])),
            up_to_date: false,
            views: (0, 0),
        };
        let scale = EnergyScale::new([], None, None);
        let flash = FlashAccount { trend: trend::<PairRecord>(&[], &scale), scale, repeatability: None };
        // A quarter of the seen texels has the reflectance asked for, the rest 0.5.
        let at = |x: usize, y: usize| {
            let rho = if x < 80 { rho } else { [0.5; 3] };
            (x < 320).then_some(Estimate { rho, sd: [0.01; 3], views: 1 + y as u16 })
        };
        html(&Told {
            manifest: &manifest,
            calibration: &calibration,
            pairs: vec![],
            summary: &summary,
            flash: &flash,
            colours: &SessionColours::default(),
            certificate: None,
            estimates: Estimates { size: (640, 4), at: &at },
        })
        .unwrap()
    }

    #[test]
    fn a_report_names_session_figures_calibration_and_what_was_left_out() {
        let html = of("vase <script>", [0.5; 3]);
        for words in [
            "Reflectance of vase &lt;script&gt;",
            "2026-01-02 03:04 UTC",
            "640 x 640 texels",
            "87.50 %",
            "0.2500 0.5000 0.7500",
            "0.0123",
            "51234 52345 43456 DN",
            "-0.1234 q",
            "0.3125 DN",
            "0.37 %",
            "card-far.dng",
            "rejected: &lt;the vase moved&gt;",
            "no exposure table was measured",
            "Scaled, pair 0001: shot at ISO 200.",
            "camera RGB, uncalibrated",
            "reflectance.exr",
        ] {
            assert!(html.contains(words), "no {words:?}");
        }
        assert!(!html.contains("<script"));
        assert_eq!(html.matches("<img").count(), 3);
    }

    #[test]
    fn unusual_reflectance_is_counted_not_clamped() {
        assert!(of("a", [0.5; 3]).contains("0.00 %, 0.00 % of the seen texels"));
        let bright = of("a", [0.95, 0.95, 1.05]);
        assert!(bright.contains("0.00 %, 25.00 % of the seen texels, mean of the channels"));
        assert!(bright.contains("0.00 %, 25.00 %, in one channel at least"));
        assert!(bright.contains("more than fresh snow") && bright.contains("which no matt surface can"));
        let dark = of("a", [0.01, -0.01, 0.02]);
        assert!(dark.contains("25.00 %, 0.00 % of the seen texels") && dark.contains("less than charcoal"));
    }
}
