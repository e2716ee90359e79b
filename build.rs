//! Compiles the flash controller's own C core natively, for the simulated board of `studio`.

fn main() {
    const CORE: &str = "firmware/core";
    cc::Build::new()
        .std("c99")
        .warnings(true)
        .extra_warnings(true)
        .include(CORE)
        .files(["core.c", "line.c", "verbs.c"].map(|file| format!("{CORE}/{file}")))
        .compile("unlit_flash_core");
    println!("cargo::rerun-if-changed={CORE}");
    println!("cargo::rerun-if-changed=build.rs");
}
