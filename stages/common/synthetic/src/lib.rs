//! Ground-truth scenes, a renderer, and gauge-aligned comparison.

mod error;
mod options;
mod scene;
mod view;

pub mod compare;

pub use error::SyntheticError;
pub use options::{LightModel, RenderOptions, SceneOptions, Subject};
pub use scene::{ReferenceSphere, Renderer, Scene, render};
pub use view::RenderedView;
