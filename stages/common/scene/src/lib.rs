//! The words all stages speak: cameras, transforms, maps, lighting, clouds, ids and events.
//!
//! # Conventions (fixed here, used everywhere)
//! * Camera frame: x right, y down, z forward. Pixel centres lie at integer coordinates, so the
//!   frame of an image of `width` columns spans `-0.5 ..= width - 0.5`.
//! * Depth is `z` along the optical axis, never the length of the ray; 0 means "no value".
//! * A visible surface has `normal · view ray < 0`, hence `n3 < 0` for a frontal patch.
//! * Intensities are linear, 1 is the photo's white.
//! * Transforms are named `target_from_source`; positions carry their frame in the name.
//! * Spherical harmonics are ordered as the basis of [`lighting::SphericalHarmonics`].
//!
//! Every stage is a function from these types to these types. This crate imports no sibling.

pub mod asset;
pub mod calibration;
pub mod camera;
pub mod checkpoint;
pub mod cloud;
pub mod consistency;
pub mod decoded;
mod distortion;
pub mod division;
pub mod events;
mod findings;
pub mod ids;
pub mod lighting;
pub mod loading;
mod local;
pub mod maps;
pub mod matches;
pub mod naming;
pub mod options;
pub mod orientation;
mod packed_mask;
pub mod page_store;
pub mod photos;
pub mod poses;
pub mod raster;
pub mod scratch;
pub mod shaded;
pub mod sphere;
pub mod srgb;
mod subset;
pub mod team;
pub mod transform;

pub use asset::{Asset, BaseColor};
pub use calibration::{LightSample, LightSource, LightingCalibration, SphereLight, ViewLighting};
pub use camera::{FocalSource, Intrinsics};
pub use checkpoint::{Checkpoint, CheckpointError, NoCheckpoint, StatePart};
pub use cloud::{CloudError, CloudPoint, CloudSink, Mesh, PointCloud};
pub use consistency::{Inconsistent, check_descriptors, check_keypoints};
pub use decoded::{DecodedPhoto, ExifFacts, Samples};
pub use distortion::{Bend, Distortion};
pub use division::DividedStep;
pub use events::{Event, Flow, Observer, Recorder, Silent, StageId};
pub use findings::{Finding, FindingCode, Verdict};
pub use ids::{PhotoIdx, PointIdx, ViewIdx};
pub use lighting::{Lighting, SphericalHarmonics};
pub use local::local_offset;
pub use maps::{ConfidenceMap, DepthMap, NormalMap};
pub use matches::{FeatureMatches, Keypoint, PairMatches, PhotoKeypoints, motion_in_frame};
pub use naming::{artifact_name, first_and_more};
pub use options::{InTable, OptionError, RetiredKey, fulfils, in_range};
pub use orientation::Orientation;
pub use packed_mask::PackedMask;
pub use page_store::{PAGE_SIDE, PageCache, PageCaches, PageStore, Pages};
pub use photos::{InMemoryPixels, Photo, PhotoSet, PixelError, PixelSource};
pub use poses::{
    Anchor, AnchorObservation, AnchorOrigin, MIN_TRIANGULATION_ANGLE_DEG, PosedView, PosedViews,
    Scale, ScaleSource, SparsePoint, TrackElement, Unit, Unregistered, WorldCoordinates,
    WorldFrame,
};
pub use raster::{LinearImage, Mask, Raster, bilinear};
pub use scratch::{MemoryScratch, Room, Scratch, ScratchError};
pub use shaded::{MapSource, ShadedImages, ShadedView, ShadedViews};
pub use sphere::{
    LightKind, LocatedSphere, MarkedSphere, SphereCalibration, SphereMark, SphereRequest,
};
pub use team::{Alone, Team, TeamError, divided};
pub use transform::RigidTransform;
