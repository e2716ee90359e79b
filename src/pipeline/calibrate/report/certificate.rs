//! The model's certificate in the report: the comparison of the final reflectance with known patches. Read as plain
//! JSON, whatever its figures are: `model/certificate.json` has its own account of what they mean.

use super::{CERTIFICATE, Line, Mark, Page, Part};
use crate::export::calibration_report::{Piece, Row, Table};
use crate::pipeline::report::{fact, moment};
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
        let verdict = certificate.get("verdict");
        let good = verdict.and_then(|v| v.get("good")).and_then(Value::as_bool);
        let mark = if good == Some(true) { Mark::Good } else { Mark::Bad };
        let sentences = verdict.and_then(|v| v.get("sentences")).and_then(Value::as_array);
        let mut sentences: Vec<String> =
            sentences.into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect();
        if good.is_none() {
            sentences.insert(0, "It holds no verdict that this program understands.".into());
        }
        let measured =
            [text("measured"), text("certified"), text("date")].into_iter().find(|t| !t.is_empty());
        let measured = measured.map(moment).unwrap_or_default();
        self.summary.push(Line {
            part: Some(CERTIFICATE.id),
            valid_for: "this session's model".into(),
            measured: measured.clone(),
            ..super::line(&CERTIFICATE, mark, sentences.first().cloned().unwrap_or_default())
        });
        let mut facts = vec![fact("Measured", measured)];
        let mut pieces = vec![];
        for (name, value) in certificate.as_object().into_iter().flatten() {
            match value {
                Value::Array(rows) if rows.iter().any(Value::is_object) => pieces.push(table(name, rows)),
                _ if ["verdict", "schema", "measured"].contains(&name.as_str()) => {}
                _ => facts.extend(plain(value).map(|words| fact(&spoken(name), words))),
            }
        }
        self.parts.push(Part {
            id: CERTIFICATE.id,
            letter: CERTIFICATE.letter,
            heading: CERTIFICATE.name,
            mark,
            sentences,
            facts,
            pieces,
            shots: vec![],
        });
    }
}

/// A field's name as people write it.
fn spoken(name: &str) -> String {
    name.replace('_', " ")
}

/// A value in one line; `None` for what has parts of its own.
fn plain(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Bool(yes) => Some(if *yes { "yes" } else { "no" }.to_owned()),
        Value::Number(number) if number.is_f64() => number.as_f64().map(|v| format!("{v:.4}")),
        Value::Number(number) => Some(number.to_string()),
        Value::Array(values) => {
            values.iter().map(plain).collect::<Option<Vec<_>>>().map(|v| v.join("\u{a0}\u{a0}"))
        }
        Value::Null | Value::Object(_) => None,
    }
}

/// Objects in a list as a table of what they have that fits into a line.
fn table(name: &str, rows: &[Value]) -> Piece {
    let mut names: Vec<&String> = vec![];
    for (name, value) in rows.iter().filter_map(Value::as_object).flatten() {
        if plain(value).is_some() && !names.contains(&name) {
            names.push(name);
        }
    }
    let cells = |row: &Value| {
        let cell = |name: &&String| row.get(name.as_str()).and_then(plain).unwrap_or_else(|| "-".into());
        Row { cells: names.iter().map(cell).collect(), from: vec![] }
    };
    Piece::Table(Table {
        caption: spoken(name),
        rows: rows.iter().map(cells).collect(),
        head: names.iter().map(|name| spoken(name)).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_list_of_whatever_objects_becomes_a_table() {
        let rows =
            [json!({"name": "grey", "error": 0.012, "rgb": [0.1, 0.2]}), json!({"name": "red", "deep": {}})];
        let Piece::Table(table) = table("known_patches", &rows) else { panic!() };
        assert_eq!((table.caption.as_str(), table.rows.len()), ("known patches", 2));
        let cell = |row: usize, name: &str| {
            let column = table.head.iter().position(|head| head == name)?;
            Some(table.rows[row].cells[column].as_str())
        };
        assert_eq!((cell(0, "error"), cell(1, "error")), (Some("0.0120"), Some("-")));
        assert_eq!((cell(0, "rgb"), cell(0, "deep")), (Some("0.1000\u{a0}\u{a0}0.2000"), None));
    }
}
