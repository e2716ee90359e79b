//! A glossy object: the highlight is not painted into the reflectance.

use serde_json::Value;
use std::process::Command;

#[test]
fn a_varnish_hardly_moves_the_reflectance_found_under_it() {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit"))
        .args(["experiment", "varnish", "--quick", "--json"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let outcome: Value = serde_json::from_slice(&output.stdout).unwrap();
    let rows = outcome["tables"][0]["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 2, "{outcome:#}");
    for row in rows {
        let mean = row["ours"]["mean"].as_f64().unwrap();
        assert!(mean.abs() <= 0.01, "{row:#}");
        assert!(row["ours"]["count"].as_u64().unwrap() > 30_000, "{row:#}");
    }
}
