//! The model's certificate in the report: the comparison of the final reflectance with known patches. It is read as
//! plain JSON: what is told in `model/certificate.json` is shown, and nothing is reckoned with it.

use super::{CERTIFICATE, Line, Mark, Page, Part};
use crate::export::calibration_report::{Piece, Row, Table};
use crate::pipeline::report::{fact, moment};
use crate::session::store;
use serde_json::Value;
use std::io::ErrorKind;

impl Page<'_> {
    pub(super) fn add_certificate(&mut self) {
        let path = self.session.model_dir().join("certificate.json");
        let certificate = match std::fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return self.missing(&CERTIFICATE),
            Err(error) => Err(format!("{} cannot be read: {error}", path.display())),
            Ok(bytes) => serde_json::from_slice::<Value>(&bytes)
                .map_err(|error| format!("{} is damaged ({error}); certify the model again", path.display())),
        };
        match certificate {
            Ok(certificate) => self.certified(&certificate),
            Err(words) => self.summary.push(super::line(&CERTIFICATE, Mark::Bad, words)),
        }
    }

    fn certified(&mut self, certificate: &Value) {
        let text = |name: &str| certificate.get(name).and_then(Value::as_str).unwrap_or_default();
        let good = certificate.pointer("/verdict/good").and_then(Value::as_bool);
        let said = certificate.pointer("/verdict/sentences").and_then(Value::as_array);
        let mut sentences: Vec<String> =
            said.into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect();
        if good.is_none() {
            sentences.insert(0, "It holds no verdict that this program understands; certify again.".into());
        }
        let of = certificate.pointer("/inputs/reflectance_blake3").and_then(Value::as_str);
        let model = self.session.model_dir().join("reflectance.exr");
        let stands = of.is_none_or(|of| store::digest_file(&model).is_ok_and(|own| own == of));
        if !stands {
            sentences
                .insert(0, "It is of another model than the one that is there now; certify again.".into());
        }
        let mark = if good == Some(true) && stands { Mark::Good } else { Mark::Bad };
        let made = moment(text("made"));
        self.summary.push(Line {
            part: Some(CERTIFICATE.id),
            valid_for: "this session's model".into(),
            measured: made.clone(),
            ..super::line(&CERTIFICATE, mark, sentences.first().cloned().unwrap_or_default())
        });
        let mut facts = vec![fact("Made", format!("{made} UTC, {}", text("software")))];
        for (name, value) in certificate.get("summary").and_then(Value::as_object).into_iter().flatten() {
            facts.extend(plain(value).map(|words| fact(&name.replace('_', " "), words)));
        }
        let patches = certificate.get("patches").and_then(Value::as_array);
        self.parts.push(Part {
            id: CERTIFICATE.id,
            letter: CERTIFICATE.letter,
            heading: CERTIFICATE.name,
            mark,
            sentences,
            facts,
            pieces: patches.map(|patches| table(patches)).into_iter().collect(),
            shots: vec![],
        });
    }
}

/// A value in one line; `None` for what has parts of its own.
fn plain(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Bool(yes) => Some(if *yes { "yes" } else { "no" }.to_owned()),
        Value::Number(number) if number.is_f64() => number.as_f64().map(|v| format!("{v:.4}")),
        Value::Number(number) => Some(number.to_string()),
        Value::Array(values) => {
            let values: Option<Vec<String>> = values.iter().map(plain).collect();
            values.map(|values| values.join("\u{a0}\u{a0}"))
        }
        Value::Null | Value::Object(_) => None,
    }
}

/// Columns of the patches' table, and where their values are.
const COLUMNS: [(&str, &str); 10] = [
    ("Patch", "/name"),
    ("Known reflectance (R G B)", "/comparison/known_reflectance"),
    ("Found", "/comparison/found_reflectance"),
    ("Standard error", "/comparison/found_reflectance_standard_error"),
    ("Error", "/comparison/error"),
    ("Error / known", "/comparison/relative_error"),
    ("CIEDE2000", "/comparison/delta_e_2000"),
    ("Within 5 %", "/comparison/within_5_percent/passes"),
    ("Within 2 %", "/comparison/within_2_percent/passes"),
    ("Not seen", "/not_seen"),
];

/// The patches with what is told of any of them.
fn table(patches: &[Value]) -> Piece {
    let told = |path: &str| patches.iter().any(|patch| patch.pointer(path).and_then(plain).is_some());
    let columns: Vec<(&str, &str)> = COLUMNS.into_iter().filter(|(_, path)| told(path)).collect();
    let row = |patch: &Value| {
        let cell =
            |(_, path): &(&str, &str)| patch.pointer(path).and_then(plain).unwrap_or_else(|| "-".into());
        Row { cells: columns.iter().map(cell).collect(), from: vec![] }
    };
    Piece::Table(Table {
        caption: "Patches: reflectance in camera RGB".into(),
        rows: patches.iter().map(row).collect(),
        head: columns.iter().map(|(name, _)| (*name).to_owned()).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn patches_become_a_table_of_what_is_told_of_them() {
        let seen = json!({
            "name": "grey",
            "comparison": {"error": [0.012, 0.0, -0.5], "within_5_percent": {"passes": true}}
        });
        let Piece::Table(table) = table(&[seen, json!({"name": "red", "not_seen": "hidden"})]) else {
            panic!()
        };
        assert_eq!(table.head, ["Patch", "Error", "Within 5 %", "Not seen"]);
        assert_eq!(table.rows[0].cells, ["grey", "0.0120\u{a0}\u{a0}0.0000\u{a0}\u{a0}-0.5000", "yes", "-"]);
        assert_eq!(table.rows[1].cells, ["red", "-", "-", "hidden"]);
    }
}
