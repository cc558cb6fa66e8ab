//! Some of the views of a set, with all that is known of them.

use crate::calibration::LightingCalibration;
use crate::ids::ViewIdx;
use crate::poses::PosedViews;

/// New numbers of the views that are kept, by their old ones.
struct Renumbered(Vec<Option<ViewIdx>>);

impl Renumbered {
    fn new(num_views: usize, kept: &[ViewIdx]) -> Self {
        let mut new = vec![None; num_views];
        for (k, &ViewIdx(old)) in kept.iter().enumerate() {
            if let Some(place) = new.get_mut(old) {
                *place = Some(ViewIdx(k));
            }
        }
        Self(new)
    }

    /// Gives a view its new number; whether it is kept.
    fn keeps(&self, view: &mut ViewIdx) -> bool {
        let new = self.0.get(view.0).copied().flatten();
        *view = new.unwrap_or(*view);
        new.is_some()
    }
}

impl PosedViews {
    /// The views `kept`, in this order, numbered anew; numbers that no view has are passed over.
    /// Points and anchors keep their places, and of their sightings those in the views that are
    /// kept; those that none of them sees go.
    pub fn of_views(&self, kept: &[ViewIdx]) -> Self {
        let new = Renumbered::new(self.views.len(), kept);
        let views = kept
            .iter()
            .filter_map(|view| self.views.get(view.0).cloned());
        let mut out = Self {
            views: views.collect(),
            ..self.clone()
        };
        out.points.retain_mut(|point| {
            point.track.retain_mut(|seen| new.keeps(&mut seen.view));
            !point.track.is_empty()
        });
        out.anchors.retain_mut(|anchor| {
            let observations = &mut anchor.observations;
            observations.retain_mut(|seen| new.keeps(&mut seen.view));
            !observations.is_empty()
        });
        out
    }
}

impl LightingCalibration {
    /// The light of the views `kept` of `num_views`, numbered as [`PosedViews::of_views`] numbers
    /// them. Samples of other views go with them.
    pub fn of_views(&self, num_views: usize, kept: &[ViewIdx]) -> Self {
        let new = Renumbered::new(num_views, kept);
        let lights = kept.iter();
        let lights = lights.filter_map(|old| self.views.iter().find(|light| light.view == *old));
        let mut out = Self {
            views: lights.cloned().collect(),
            ..self.clone()
        };
        out.views.retain_mut(|light| new.keeps(&mut light.view));
        out.samples.retain_mut(|sample| new.keeps(&mut sample.view));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{LightSample, LightSource, ViewLighting};
    use crate::camera::Intrinsics;
    use crate::ids::PhotoIdx;
    use crate::lighting::Lighting;
    use crate::poses::{
        PosedView, Scale, ScaleSource, SparsePoint, TrackElement, Unit, WorldFrame,
    };
    use crate::sphere::LightKind;
    use crate::transform::RigidTransform;

    fn posed() -> PosedViews {
        let view = |k: usize| PosedView {
            photo: PhotoIdx(k + 3),
            name: format!("v{k}"),
            file_name: format!("v{k}.jpg"),
            intrinsics: Intrinsics::pinhole(40, 30, 50.0, 20.0, 15.0),
            cam_from_world: RigidTransform::identity(),
        };
        let point = |views: &[usize]| SparsePoint {
            position: [0.0, 0.0, 1.0],
            color: [0; 3],
            error_px: 0.1,
            track: views
                .iter()
                .map(|&k| TrackElement {
                    view: ViewIdx(k),
                    keypoint_idx: k as u32,
                    pixel: [5.0, 6.0],
                })
                .collect(),
        };
        PosedViews {
            views: (0..4).map(view).collect(),
            unregistered: Vec::new(),
            points: vec![point(&[0, 1, 3]), point(&[0, 2])],
            anchors: Vec::new(),
            scale: Scale {
                unit: Unit::Metre,
                source: ScaleSource::Sphere,
                relative_sigma: None,
            },
            frame: WorldFrame::Level,
            offset: [0.0; 3],
            given_unit: None,
            spheres: Vec::new(),
            no_sphere: None,
        }
    }

    #[test]
    fn what_is_kept_of_views_and_light_is_consistent() {
        let whole = posed();
        let light = LightingCalibration {
            source: LightSource::Sphere,
            kind: LightKind::World,
            environment_in_world: None,
            views: (0..4)
                .map(|k| ViewLighting {
                    view: ViewIdx(k),
                    lighting: Lighting {
                        channels: Vec::new(),
                    },
                    residual: Some(k as f64),
                    gain: Vec::new(),
                })
                .collect(),
            spheres: Vec::new(),
            samples: (0..4)
                .map(|k| LightSample {
                    view: ViewIdx(k),
                    sphere: None,
                    normal_in_world: [0.0, 0.0, 1.0],
                    intensity: [k as f32; 3],
                    has_gain: true,
                })
                .collect(),
        };
        let kept = [ViewIdx(1), ViewIdx(3)];
        let half = whole.of_views(&kept);
        let names: Vec<&str> = half.views.iter().map(|v| v.name.as_str()).collect();
        assert_eq!(names, ["v1", "v3"]);
        // The second point was seen by none of them.
        assert_eq!(half.points.len(), 1);
        let sightings: Vec<_> = half.points[0]
            .track
            .iter()
            .map(|seen| (seen.view.0, seen.keypoint_idx))
            .collect();
        assert_eq!(sightings, [(0, 1), (1, 3)]);
        assert!(half.check().is_ok());
        let half = light.of_views(4, &kept);
        let views: Vec<_> = half.views.iter().map(|l| (l.view.0, l.residual)).collect();
        assert_eq!(views, [(0, Some(1.0)), (1, Some(3.0))]);
        let samples: Vec<_> = half
            .samples
            .iter()
            .map(|s| (s.view.0, s.intensity[0]))
            .collect();
        assert_eq!(samples, [(0, 1.0), (1, 3.0)]);
    }
}
