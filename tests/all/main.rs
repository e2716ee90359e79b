//! The one integration-test binary; a module a subject.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test's helpers may fail as its body may")]

mod api;
mod avr;
mod birdbath;
mod camera;
mod camera_faults;
mod camera_usb;
mod capture;
mod decoders;
mod disk;
mod evaluate;
mod experiments;
mod export;
mod fake_rig;
mod firmware;
mod firmware_fuzz;
mod firmware_host;
mod flash;
mod flash_commands;
mod flash_find;
mod flash_link;
mod flash_state;
mod flash_wire;
mod floors;
mod gphoto_cli;
mod hardware;
mod irradiance;
mod main_job;
mod pairs;
mod processes;
mod pulled_port;
mod raw;
mod real_rig;
mod repeatability;
mod samples;
mod scene_import;
mod session;
mod studio_camera;
mod studio_usb;
mod studio_world;
mod tired_flash;
mod usb_bench;
mod varnish;
mod wall;
