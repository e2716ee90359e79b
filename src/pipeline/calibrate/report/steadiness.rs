//! How steady the flash is, in the report: from lit frames, and from the controller's own series, of which no frames are
//! kept.

use super::{Line, Mark, Page, Part, STEADINESS, Told, body, ends, figure, figures, head, or_dash, used};
use crate::calibration::{Record, Rig, Steadiness};
use crate::export::calibration_report::{Piece, Row, Table};
use crate::export::chart::Plot;
use crate::pair::Settings;
use crate::pipeline::energy;
use crate::pipeline::report::{fact, moment, repeatability};
use crate::pipeline::steadiness::picture;
use crate::session::Session;

/// Label, value and interval of a deviation.
type Deviation<'a> = (&'a str, Option<f64>, Option<[f64; 2]>);

pub(super) fn tell(_: &Session, record: &Record<Steadiness>) -> Told {
    let fit = &record.fit;
    let from = used(record, |_| true);
    let told: [Deviation<'_>; 6] = [
        (
            "Energy between shots, standard deviation",
            Some(fit.jitter_deviation),
            Some(fit.jitter_deviation_interval_95),
        ),
        (
            "Left when divided by measured energies",
            fit.corrected_deviation,
            fit.corrected_deviation_interval_95,
        ),
        ("Light as it came, standard deviation", Some(fit.light_deviation), None),
        ("Of that, the sensor's noise", Some(fit.sensor_deviation), None),
        ("Largest excursion of a shot", Some(fit.largest_excursion), None),
        ("Drift from the first to the last shot", Some(fit.drift), None),
    ];
    let row = |(name, value, interval): Deviation<'_>| {
        let interval = interval.map(|i| ends(i.map(|v| 100.0 * v), 4));
        figure(name, or_dash(value.map(|v| 100.0 * v), 4), "%", interval, &from)
    };
    let frames = fit.frames.iter().enumerate().map(|(number, frame)| Row {
        cells: vec![
            (number + 1).to_string(),
            frame.light_dn.map(|dn| format!("{dn:.2}")).join("\u{a0}\u{a0}"),
            format!("{:.5}", frame.relative_light),
            or_dash(frame.energy_counts, 1),
            or_dash(frame.relative_light_by_energy, 5),
        ],
        from: vec![number],
    });
    let frames = Table {
        caption: "Frames".into(),
        head: head(&[
            "Frame",
            "Light (R G B), DN",
            "Light, 1 = mean",
            "Energy, counts",
            "Light by energy, 1 = mean",
        ]),
        rows: frames.collect(),
    };
    Told {
        valid_for: vec!["the flash as it was set".into()],
        pieces: vec![
            Piece::Plot(Plot { joined: true, ..Plot::from(picture(fit)) }),
            figures("Figures", told.map(row).into()),
            Piece::Table(frames),
        ],
        ..Told::default()
    }
}

/// Where and with what the controller's series was taken.
#[derive(serde::Deserialize)]
struct Origin {
    taken: String,
    settings: Settings,
}

/// What the controller's series says, in two sentences.
fn words(run: &Steadiness, measured: &str) -> String {
    let by_energy = run
        .light_by_energy_deviation
        .map(|left| format!(", and {:.3} % divided by the measured energy", 100.0 * left));
    format!(
        "In the controller's own series of {} shots ({measured}) the known light has a standard deviation of {:.3} %{}. No \
         frames of it are kept.",
        run.frames.len(),
        100.0 * run.light_deviation,
        by_energy.unwrap_or_default()
    )
}

impl Page<'_> {
    /// The series that the flash controller shot and measured itself, if there is one: beside that from frames, or in
    /// its place.
    pub(super) fn add_controllers_series(&mut self) {
        let run = match energy::repeatability(self.session) {
            Ok(Some(run)) => run,
            Ok(None) => return,
            Err(error) => return self.summary.push(super::line(&STEADINESS, Mark::Bad, error.to_string())),
        };
        let file = std::fs::read(energy::repeatability_file(self.session)).unwrap_or_default();
        let origin = serde_json::from_slice::<Origin>(&file).ok();
        let measured = origin.as_ref().map_or_else(|| "date not told".into(), |o| moment(&o.taken));
        let rig = origin.map(|origin| Rig::of(&origin.settings)).unwrap_or_default();
        let words = words(&run, &measured);
        let pieces = repeatability(&run).into_iter().map(Piece::Block);
        if let Some(part) = self.parts.iter_mut().find(|part| part.id == STEADINESS.id) {
            part.sentences.push(words);
            part.pieces.extend(pieces);
            return;
        }
        self.summary.retain(|line| !(line.name == STEADINESS.name && line.mark == Mark::Missing));
        let valid_for = format!("{}, the flash as it was set", body(&rig));
        self.parts.push(Part {
            id: STEADINESS.id,
            letter: STEADINESS.letter,
            heading: STEADINESS.name,
            mark: Mark::Good,
            sentences: vec![words.clone()],
            facts: vec![fact("True of", valid_for.clone()), fact("Measured", format!("{measured} UTC"))],
            pieces: pieces.collect(),
            shots: vec![],
        });
        self.summary.push(Line {
            part: Some(STEADINESS.id),
            valid_for,
            measured,
            ..super::line(&STEADINESS, Mark::Good, words)
        });
        if !self.rigs.contains(&rig) {
            self.rigs.push(rig);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{SteadyShot, steadiness};

    #[test]
    fn the_controllers_series_tells_of_energies_only_where_they_were_measured() {
        let told = |energy_counts: Option<f64>| {
            let shot = SteadyShot { light_dn: [100.0; 3], energy_counts, ..SteadyShot::default() };
            words(&steadiness(vec![shot; 8]).unwrap(), "today")
        };
        assert!(told(Some(500.0)).contains("0.000 %, and 0.000 % divided by the measured energy. No frames"));
        assert!(told(None).contains("of 8 shots (today)") && told(None).contains("0.000 %. No frames"));
    }
}
