//! Cameras far from their frame's origin, as survey software exports them: the local frame that is
//! worked in, and the way back.
//!
//! `x_world = x_local + offset`. Single precision keeps a coordinate to `2⁻²⁴` of itself, so that a
//! surface 600 km from the origin has steps of 6 cm; near the cameras it has none that matter.

use crate::poses::PosedViews;
use crate::transform::RigidTransform;
use nalgebra::Vector3;

/// Distance from the origin over the cameras' spread up to which no offset is taken: `2⁻²⁴ · 32` is
/// 2e-6 of the spread, a hundred-thousandth of an object a fifth as large.
const FAR: f64 = 32.0;

/// What to subtract from the coordinates of a world so that cameras stand near the origin: `known`
/// where they do then, else in round numbers of some ten times their spread, so that a world that was
/// moved by such numbers comes out the same, and it is exact in every file. Zero for a world where they
/// stand near anyway.
pub fn local_offset(poses: &[RigidTransform], known: [f64; 3]) -> [f64; 3] {
    let centers: Vec<Vector3<f64>> = poses.iter().map(|p| p.center_in_source().coords).collect();
    // Medians, since a camera that went astray stands anywhere.
    let middle_of = |mut values: Vec<f64>| -> Option<f64> {
        values.retain(|value| value.is_finite());
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let along = |k: usize| middle_of(centers.iter().map(|c| c[k]).collect());
    let (Some(x), Some(y), Some(z)) = (along(0), along(1), along(2)) else {
        return known;
    };
    let middle = Vector3::new(x, y, z);
    let spread = middle_of(centers.iter().map(|c| (c - middle).norm()).collect());
    // Cameras at one place say nothing of the size of what they see.
    let spread = spread.filter(|&spread| spread > 0.0).unwrap_or(1.0);
    let is_near = |offset: [f64; 3]| (middle - Vector3::from(offset)).norm() <= FAR * spread;
    if let Some(offset) = [known, [0.0; 3]]
        .into_iter()
        .find(|&offset| is_near(offset))
    {
        return offset;
    }
    let step = round_step(8.0 * spread);
    // Without negative zeros.
    middle.map(|c| (c / step).round() * step + 0.0).into()
}

/// The next 1, 2 or 5 times a power of ten; below one the next power of two, which is exact.
fn round_step(least: f64) -> f64 {
    if least <= 1.0 {
        return 2.0_f64.powf(least.log2().ceil());
    }
    let power = 10.0_f64.powf(least.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|k| k * power);
    steps
        .into_iter()
        .find(|&step| step >= least)
        .unwrap_or(10.0 * power)
}

impl RigidTransform {
    /// The same motion of coordinates from which `offset` was subtracted.
    pub fn with_origin_at(&self, offset: [f64; 3]) -> Self {
        if offset == [0.0; 3] {
            return *self;
        }
        Self {
            rotation: self.rotation,
            translation: self.translation + self.rotation * Vector3::from(offset),
        }
    }
}

impl PosedViews {
    /// Multiplies every length.
    pub fn multiply(&mut self, factor: f64) {
        for view in &mut self.views {
            view.cam_from_world.translation *= factor;
        }
        let points = self.points.iter_mut().map(|point| &mut point.position);
        let anchors = self.anchors.iter_mut().map(|anchor| {
            anchor
                .covariance
                .iter_mut()
                .for_each(|v| *v *= factor * factor);
            for seen in &mut anchor.observations {
                seen.depth *= factor;
            }
            &mut anchor.position
        });
        let spheres = self.spheres.iter_mut().flat_map(|sphere| {
            sphere.radius *= factor;
            [&mut sphere.center_in_world, &mut sphere.center_sigma]
        });
        let places = points.chain(anchors).chain(spheres);
        for v in places.chain([&mut self.offset]).flatten() {
            *v *= factor;
        }
    }

    /// In the world of the given cameras: without an offset.
    pub fn in_world(&self) -> Self {
        let mut out = self.clone();
        let offset = std::mem::take(&mut out.offset);
        if offset == [0.0; 3] {
            return out;
        }
        for view in &mut out.views {
            view.cam_from_world = view.cam_from_world.with_origin_at(offset.map(|v| -v));
        }
        let points = out.points.iter_mut().map(|point| &mut point.position);
        let anchors = out.anchors.iter_mut().map(|anchor| &mut anchor.position);
        let spheres = out
            .spheres
            .iter_mut()
            .map(|sphere| &mut sphere.center_in_world);
        for place in points.chain(anchors).chain(spheres) {
            for (v, by) in place.iter_mut().zip(offset) {
                *v += by;
            }
        }
        out
    }

    /// In the unit of the given cameras, where that is one of length.
    pub fn in_given_unit(mut self) -> Self {
        if let Some(unit) = self.given_unit.take()
            && let Some(metres) = unit.metres()
        {
            self.multiply(1.0 / metres);
            self.scale.unit = unit;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Rotation3};

    fn ring(middle: [f64; 3], radius: f64) -> Vec<RigidTransform> {
        let at = |k: usize| {
            let angle = k as f64;
            let center =
                Point3::from(middle) + radius * Vector3::new(angle.cos(), angle.sin(), 0.2);
            RigidTransform::from_world_pose(Rotation3::from_euler_angles(angle, 0.3, 0.1), center)
        };
        (0..7).map(at).collect()
    }

    #[test]
    fn far_cameras_have_an_exact_offset_and_near_ones_none() {
        let far = [600_000.37, 5_100_000.81, 200.4];
        for (middle, radius, offset) in [
            ([0.3, -0.2, 0.5], 1.0, [0.0; 3]),
            ([20.0, 0.0, 0.0], 1.0, [0.0; 3]),
            (far, 1e6, [0.0; 3]),
        ] {
            assert_eq!(
                local_offset(&ring(middle, radius), [0.0; 3]),
                offset,
                "{middle:?}"
            );
        }
        for radius in [300.0, 1.0, 0.01] {
            let poses = ring(far, radius);
            let offset = local_offset(&poses, [0.0; 3]);
            for (pose, near) in poses.iter().zip(ring([0.0; 3], radius)) {
                let local = pose.with_origin_at(offset);
                let center = local.center_in_source().coords + Vector3::from(offset);
                let error = (center - Vector3::from(far) - near.center_in_source().coords).norm();
                assert!(error < 1e-8, "{error}");
                // The steps of single precision are small beside the rig.
                let step = local.center_in_source().coords.amax() * 2.0_f64.powi(-24);
                assert!(step < 2e-6 * radius, "{step} of {radius}");
            }
            // Whole, or an exact fraction: the same in every file.
            assert!(
                offset.iter().all(|v| (v * 1024.0).fract() == 0.0),
                "{offset:?}"
            );
            let by = [-1e6, 2e4, 5e4];
            let moved: Vec<_> = poses.iter().map(|p| p.with_origin_at(by)).collect();
            let same = local_offset(&moved, [0.0; 3]);
            assert_eq!([0, 1, 2].map(|k| same[k] + by[k]), offset);
            let known = offset.map(|v| v + radius);
            assert_eq!(local_offset(&poses, known), known);
        }
        assert_eq!(local_offset(&[], [1.0; 3]), [1.0; 3]);
    }
}
