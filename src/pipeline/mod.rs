//! The six stages in order: load what a stage reads, run it, save what it makes.
//!
//! A stage's input is always read back from the run directory, also right after the stage before
//! it, so that a run that was stopped and continued sees the same bytes as an undisturbed one.

mod anchors;
mod artifacts;
mod context;
mod errors;
mod estimate;
mod execute;
mod features;
mod fusion;
mod halves;
mod inputs;
mod lighting;
mod parallel;
mod photo_files;
mod photos;
mod plan;
mod poses;
mod request;
mod shading;
mod spheres;

pub use context::Context;
pub use errors::{from_fusion, from_lighting, from_shading};
pub use estimate::{REPORT, WRITING, expect, expect_with_masks};
pub use execute::{Range, bring_up_to_date, run_stage};
pub use fusion::{OFFSET, cloud_offset, write_surface};
pub use halves::{ShapedHalf, shaped_halves};
pub use inputs::{Inputs, PhotoInput};
pub use parallel::{Resources, start_threads};
pub use photos::{check as check_photos, linear_photo, map_photos};
pub use plan::{Plan, StageState, is_another_set, photo_role, upstream};
pub use poses::load as load_poses;
pub use request::{LightingInput, MaskOrigin, Request, SphereInput};
pub use shading::{ShadingFacts, shown_albedo, write_maps};
