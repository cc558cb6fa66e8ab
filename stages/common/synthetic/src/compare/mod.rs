//! Results against truth, the gauge said aloud.
//!
//! A reconstruction lives in a frame `e` of its own, the truth in `t`. [`align`] finds the
//! similarity `x_t = s R x_e + b` from the camera poses that both sides know and says which kind
//! of motion it used; the other functions take it and never align again.

mod align;
mod appearance;
mod cloud;
mod distance;
mod edges;
mod evaluation;
mod halves;
mod maps;
mod nearest;
mod planes;
mod regions;
mod relief;
mod truth;

pub use align::{
    Alignment, AlignmentRequest, NamedPose, PoseComparison, Similarity, align, compare_poses,
};
pub use appearance::{AppearanceComparison, ImageErrors, LightComparison, compare_light};
pub use cloud::{CloudComparison, ThresholdShares, TrueSurface, compare_cloud};
pub use distance::MeshDistance;
pub use evaluation::{Evaluation, evaluate};
pub use halves::{
    Half, HalvesBand, HalvesComparison, RESOLVED_CORRELATION, Resolved, compare_halves,
};
pub use maps::{MapComparison, NormalSource, PixelErrors, aggregate, compare_maps};
pub use planes::plane_normals;
pub use regions::{Region, RegionError, RegionSums};
pub use relief::{BandSums, ReliefBand};
pub use truth::{TruthMaps, TruthView};
