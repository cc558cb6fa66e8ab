//! True matches: surface points with the pixels of the views that see them.

use crate::noise::unit;
use crate::view::RenderedView;
use nalgebra::Point3;
use rilievo_scene::Mesh;

/// A surface point that at least two views see.
#[derive(Clone, Debug, PartialEq)]
pub struct TrueTrack {
    /// Position in the world, metres.
    pub position: [f64; 3],
    /// Index of the view, pixel, and depth there.
    pub observations: Vec<(usize, [f64; 2], f64)>,
}

/// Relative difference of depth within which a point is the one that a view sees.
const VISIBLE: f64 = 1e-3;

/// Tracks of up to `num` vertices of the true surface, spread over it by `seed`, with exact
/// pixels; noise is for the caller to add.
pub fn true_tracks(mesh: &Mesh, views: &[RenderedView], num: usize, seed: u64) -> Vec<TrueTrack> {
    if mesh.vertices.is_empty() {
        return Vec::new();
    }
    // Most vertices of a closed surface are hidden, so several are drawn for each that is kept.
    (0..20 * num as u32)
        .filter_map(|i| {
            let draw = unit([seed as u32, i, 0x7472, 0]) * mesh.vertices.len() as f64;
            let position = mesh.vertices[draw as usize].map(f64::from);
            let observations: Vec<_> =
                views
                    .iter()
                    .enumerate()
                    .filter_map(|(idx, view)| {
                        let in_cam = view.cam_from_world.apply(&Point3::from(position));
                        let pixel = view.intrinsics.project(&in_cam)?;
                        let seen = *view
                            .depth
                            .get(pixel.x.round() as isize, pixel.y.round() as isize)?;
                        (seen > 0.0 && (f64::from(seen) / in_cam.z - 1.0).abs() < VISIBLE)
                            .then_some((idx, pixel.into(), in_cam.z))
                    })
                    .collect();
            (observations.len() >= 2).then_some(TrueTrack {
                position,
                observations,
            })
        })
        .take(num)
        .collect()
}
