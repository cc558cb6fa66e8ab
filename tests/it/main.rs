//! Tests of the program as its users call it, and of the workspace's layering.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests fail as tests do"
)]

mod bad_input;
mod browser;
mod camera_files;
mod command_line;
mod common;
mod data_sets;
mod fuse;
mod given_cameras;
mod layering;
mod photo_folders;
mod photo_formats;
mod photos_and_disk;
mod poses_and_light;
mod ranks;
mod run_directory;
mod sphere_input;
mod still_frames;
mod whole_program;
