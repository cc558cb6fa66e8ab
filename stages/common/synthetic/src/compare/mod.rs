//! Results against truth, the gauge said aloud.
//!
//! A reconstruction lives in a frame `e` of its own, the truth in `t`. [`align`] finds the
//! similarity `x_t = s R x_e + b` from the camera poses that both sides know and says which kind
//! of motion it used; the other functions take it and never align again.

mod align;
mod appearance;
mod cloud;
mod evaluation;
mod halves;
mod maps;
mod nearest;
mod regions;
mod relief;
mod truth;

pub use align::{
    Alignment, AlignmentRequest, NamedPose, PoseComparison, Similarity, align, compare_poses,
};
pub use appearance::{AppearanceComparison, ImageErrors, LightComparison, compare_light};
pub use cloud::{CloudComparison, MeshDistance, ThresholdShares, TrueSurface, compare_cloud};
pub use evaluation::{Evaluation, evaluate};
pub use halves::{
    Half, HalvesBand, HalvesComparison, RESOLVED_CORRELATION, Resolved, compare_halves,
};
pub use maps::{MapComparison, NormalSource, PixelErrors, aggregate, compare_maps, plane_normals};
pub use regions::{Region, RegionError, RegionSums, region_errors};
pub use relief::{BandSums, ReliefBand, relief_bands, relief_sums};
pub use truth::{TruthMaps, TruthView};
