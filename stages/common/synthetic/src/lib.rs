//! Ground-truth scenes, a renderer, and gauge-aligned comparison.
//!
//! * [`Scene`] makes a matte object with fine relief, matte reference spheres and a printed mat
//!   under one soft light, all from a seed.
//! * [`Renderer`] photographs it: linear images with exact depth, normals, masks, poses and light.
//!   Under [`LightModel::Harmonics`] the images obey eq. 1 exactly; otherwise surfaces shade and
//!   light each other.
//! * [`compare`] measures a result against such truth, or that of any other data set.
//! * [`testing`] is what the tests of all crates share.

mod bake;
mod cameras;
mod environment;
mod error;
mod given;
mod mat;
mod noise;
mod options;
mod render;
mod scene;
mod sensor;
mod shape;
mod surface;
mod tracks;
mod view;

pub mod compare;
pub mod testing;

pub use error::SyntheticError;
pub use options::{
    BallOptions, Illumination, LightModel, RETIRED_KEYS, RenderOptions, SceneOptions, Subject,
};
pub use render::{Renderer, render};
pub use scene::{ReferenceSphere, Scene};
pub use sensor::to_srgb8;
pub use tracks::{TrueTrack, true_tracks};
pub use view::RenderedView;
