//! Normals and colours of the mesh's vertices from the views.
//!
//! A vertex takes the mean normal of the views that see its surface, with the weights of the
//! cloud's points, and the mean of their colours. It stays where it is: the zero of the distances
//! is nearer to the surface than the mean of a few planes, which curvature bends outwards.

use crate::color::{Blend, Palette};
use crate::judge::weight;
use crate::options::FusionOptions;
use crate::sight::{Candidate, DEPTH_TOLERANCE_PX, Sight, look, min_normal_cosine};
use crate::tsdf::Volume;
use crate::view::View;
use nalgebra::{Point3, Vector3};
use rilievo_scene::PageCache;
use serde::{Deserialize, Serialize};

/// A vertex with what the views give it.
#[derive(Serialize, Deserialize)]
pub(crate) struct Dressed {
    pub position: [f32; 3],
    pub normal: [f32; 3],
    pub color: [u8; 3],
    /// Distance from the mean of the views' surfaces, world's unit; `None` where no view agrees.
    pub distance: Option<f64>,
}

/// What all vertices are dressed by.
pub(crate) struct Dresser<'a> {
    views: &'a [View],
    volume: &'a Volume,
    palette: Palette,
    /// Tolerance along the normal, world's unit, and the least cosine between normals: of views
    /// that agree, and where none does of those that made the vertex.
    limits: [(f64, f64); 2],
}

impl<'a> Dresser<'a> {
    pub fn new(views: &'a [View], volume: &'a Volume, options: &FusionOptions) -> Self {
        let footprint = volume.voxel / (options.voxel_px * volume.coarsened_by);
        let tolerance = volume.voxel.max(DEPTH_TOLERANCE_PX * footprint);
        Self {
            views,
            volume,
            palette: Palette::new(),
            limits: [
                (tolerance, min_normal_cosine()),
                (2.0 * volume.truncation, -1.0),
            ],
        }
    }

    /// Views that shape a block.
    pub fn near(&self, pixels: &mut PageCache<'_>, block: usize) -> Vec<&'a View> {
        self.volume.best(pixels, self.views, block)
    }

    /// Dresses a vertex where the distances grow along `gradient`.
    pub fn dress(
        &self,
        pixels: &mut PageCache<'_>,
        near: &[&View],
        position: &Point3<f64>,
        gradient: &Vector3<f64>,
    ) -> Dressed {
        let outwards = gradient.try_normalize(0.0).unwrap_or_else(Vector3::z);
        let candidate = Candidate {
            point: *position,
            normal: outwards,
            footprint: self.volume.voxel,
        };
        let seen = self.limits.iter().find_map(|&limits| {
            mean_sight(
                pixels,
                near,
                &candidate,
                limits,
                |pixels, view, _, colors| {
                    self.paint(pixels, view, position, colors);
                },
            )
        });
        let distance = seen.as_ref().map(|seen| seen.distance.abs());
        let (mut normal, mut colors) = seen.map_or_else(Default::default, |s| (s.normal, s.colors));
        if distance.is_none() {
            // Turned away from all, as at the end of what was seen: the nearest surface on any
            // view's ray made it.
            let gap = |view: &&View, pixels: &mut PageCache<'_>| {
                let in_cam = view.pose.apply(position);
                let seen = (in_cam.z > 0.0).then(|| view.along(pixels, &in_cam))??;
                Some(((seen.depth - in_cam.z).abs(), view.to_world(&seen.normal)))
            };
            let mut nearest = f64::INFINITY;
            for view in near {
                let Some((gap, seen)) = gap(view, pixels).filter(|(gap, _)| *gap < nearest) else {
                    continue;
                };
                nearest = gap;
                normal = seen;
                colors = Blend::default();
                self.paint(pixels, view, position, &mut colors);
            }
        }
        Dressed {
            position: position.coords.map(|c| c as f32).into(),
            normal: normal
                .try_normalize(0.0)
                .unwrap_or(outwards)
                .map(|c| c as f32)
                .into(),
            color: colors.color(),
            distance,
        }
    }

    /// Adds a view's colour of a place.
    fn paint(
        &self,
        pixels: &mut PageCache<'_>,
        view: &View,
        place: &Point3<f64>,
        colors: &mut Blend,
    ) {
        let pixel = view.camera.project(&view.pose.apply(place));
        if let Some(pixel) = pixel.filter(|_| view.has_photo) {
            self.palette.add(pixels, view, [pixel.x, pixel.y], colors);
        }
    }
}

/// What several views see of a place.
pub(crate) struct MeanSight {
    /// Not of unit length, world frame.
    pub normal: Vector3<f64>,
    /// Distance of their surfaces along the normal, world's unit.
    pub distance: f64,
    pub colors: Blend,
}

/// What the views see that have one surface with a candidate, by tolerance (world's unit) and least
/// cosine between normals; `None` where none has. `paint` adds the colour of a view of a weight.
pub(crate) fn mean_sight(
    pixels: &mut PageCache<'_>,
    near: &[&View],
    candidate: &Candidate,
    (tolerance, min_cosine): (f64, f64),
    paint: impl Fn(&mut PageCache<'_>, &View, f64, &mut Blend),
) -> Option<MeanSight> {
    let (mut normal, mut offset, mut weights) = (Vector3::zeros(), 0.0, 0.0);
    let mut colors = Blend::default();
    for view in near {
        let (sight, _) = look(pixels, view, candidate, tolerance, min_cosine);
        let Sight::Same(seen) = sight else {
            continue;
        };
        let weight = weight(seen.confidence, seen.cosine, seen.footprint);
        normal += seen.normal * weight;
        offset += seen.distance * weight;
        weights += weight;
        paint(pixels, view, weight, &mut colors);
    }
    (weights > 0.0).then(|| MeanSight {
        normal,
        distance: offset / weights,
        colors,
    })
}
