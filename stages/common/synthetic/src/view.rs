//! One photograph with its truth.

use rilievo_scene::{DepthMap, Intrinsics, Lighting, LinearImage, Mask, NormalMap, RigidTransform};

/// One rendered photo and everything that is known of it.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderedView {
    /// Name without ending, `IMG_0001`.
    pub name: String,
    /// Linear intensities, three channels, noise included; 1 is white, values are not clipped.
    pub image: LinearImage,
    /// Pixels whose centre ray meets the object.
    pub object_mask: Mask,
    /// Pixels whose centre ray meets a reference sphere, for every sphere of the scene.
    pub sphere_masks: Vec<Mask>,
    /// Depth of the object, metres; 0 elsewhere.
    pub depth: DepthMap,
    /// Normals of the object, camera frame; zero elsewhere.
    pub normal: NormalMap,
    /// Albedo of the object, three channels; 0 elsewhere.
    pub albedo: LinearImage,
    /// Camera.
    pub intrinsics: Intrinsics,
    /// Pose, metres.
    pub cam_from_world: RigidTransform,
    /// Nine harmonics of the light on an unshadowed surface of the object's albedo, camera frame,
    /// exposure included. The image obeys them exactly under [`crate::LightModel::Harmonics`].
    pub lighting: Lighting,
    /// Exposure relative to the mean photo.
    pub gain: f64,
}
