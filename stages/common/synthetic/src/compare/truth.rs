//! What is known of a view's surface.

use rilievo_scene::{DepthMap, Intrinsics, NormalMap};

/// Truth of one view.
#[derive(Clone, Debug, PartialEq)]
pub struct TruthView {
    /// The photo's name without ending.
    pub name: String,
    /// Camera of the maps.
    pub intrinsics: Intrinsics,
    /// What is known of the surface.
    pub maps: TruthMaps,
}

/// What a truth knows of a view's surface; it is known where the map is not zero.
#[derive(Clone, Debug, PartialEq)]
pub enum TruthMaps {
    /// Depth, truth's unit.
    Depth(DepthMap),
    /// Normals, camera frame (photometric data sets).
    Normal(NormalMap),
    /// Depth and normals; known where there is a depth.
    Both(DepthMap, NormalMap),
}

impl TruthMaps {
    /// From what was found; `None` where there is neither.
    pub fn new(depth: Option<DepthMap>, normal: Option<NormalMap>) -> Option<Self> {
        match (depth, normal) {
            (Some(depth), Some(normal)) => Some(Self::Both(depth, normal)),
            (Some(depth), None) => Some(Self::Depth(depth)),
            (None, Some(normal)) => Some(Self::Normal(normal)),
            (None, None) => None,
        }
    }

    /// Depth, where it is known.
    pub fn depth(&self) -> Option<&DepthMap> {
        match self {
            Self::Depth(depth) | Self::Both(depth, _) => Some(depth),
            Self::Normal(_) => None,
        }
    }

    /// Normals, where they are known.
    pub fn normal(&self) -> Option<&NormalMap> {
        match self {
            Self::Normal(normal) | Self::Both(_, normal) => Some(normal),
            Self::Depth(_) => None,
        }
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Depth(depth) | Self::Both(depth, _) => (depth.width, depth.height),
            Self::Normal(normal) => (normal.width, normal.height),
        }
    }

    /// Whether the surface is known in a pixel inside the maps.
    pub fn is_known(&self, x: usize, y: usize) -> bool {
        match self {
            Self::Depth(depth) | Self::Both(depth, _) => is_depth(*depth.at(x, y)),
            Self::Normal(normal) => normal.normal(x, y).is_some(),
        }
    }
}

/// Whether a depth map holds a value there.
pub(super) fn is_depth(z: f32) -> bool {
    z.is_finite() && z > 0.0
}
