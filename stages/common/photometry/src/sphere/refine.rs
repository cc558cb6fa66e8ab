//! Outline points at sub-pixel precision, from the image's edge near a predicted outline.
//!
//! # Problem
//! Along each normal of the predicted outline, `s` pixels outwards, find the position of the step
//! from the sphere's surface to what lies behind it.
//!
//! # Steps
//! 1. Nine harmonics are fitted on the inside of the predicted sphere. Towards the outline the
//!    brightness falls ever more steeply; taken as it is, that slope draws the edge inwards, or
//!    hides it where sphere and ground are alike. The fit's prediction is therefore subtracted,
//!    outside the outline with its value there.
//! 2. Sample all channels of that difference along the normal; `g(s)` = norm of the difference
//!    between the means of one pixel outwards and one pixel inwards.
//! 3. Among the local maxima of `g` of at least `EDGE_SHARE` of the largest, the innermost: the
//!    sphere itself is smooth, whereas a textured ground has edges of its own outside.
//! 4. A parabola through three values of `g` gives the position.
//! 5. Steps weaker than `MIN_CONTRAST` of the local intensity are no edge.
//!
//! Intensities are linear, so that a pixel half covered by the sphere has the mean of both sides
//! and the step's middle is the outline.

use super::cone::{OutlineCone, SphereInCamera};
use super::posed_image::Photo;
use crate::harmonics::{FitOptions, fit_robust, fit_with};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use rilievo_scene::{LinearImage, PackedMask, SphericalHarmonics};

/// Weakest step that counts, relative to the mean intensity around it; JPEG blocks and noise stay
/// below.
const MIN_CONTRAST: f64 = 0.05;
/// A local maximum of the step counts from this share of the largest.
const EDGE_SHARE: f64 = 0.4;
/// Edges weaker than this share of the usual one are left out: where sphere and ground are nearly
/// alike, what is left of the sphere's own slope displaces the edge.
const WEAK_EDGE: f64 = 0.3;
/// Share of the visible outline that must lie on an image edge.
pub(super) const MIN_EDGE_SUPPORT: f64 = 0.6;
/// Distance between samples along the normal, pixels.
const STEP_PX: f64 = 0.25;

/// How much is done against shadows on the sphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effort {
    /// One fit of the sphere's brightness: to look at many candidates.
    Quick,
    /// Parts in shadow are separated first.
    Thorough,
}

/// Edge points found near a predicted outline.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct RefinedOutline {
    /// The points, pixels.
    pub points: Vec<Point2<f64>>,
    /// Normals with an edge; those whose edge is much weaker than most are not in `points`.
    pub num_edges: usize,
    /// Normals that were searched: inside the frame and not excluded.
    pub num_searched: usize,
    /// Outline normals in all, the ones outside the frame included.
    pub num_total: usize,
}

impl RefinedOutline {
    /// Share of the searched normals with an edge, 0 where none was searched.
    pub fn support(&self) -> f64 {
        self.num_edges as f64 / self.num_searched.max(1) as f64
    }

    /// Share of the outline inside the frame and not excluded.
    pub fn visible_share(&self) -> f64 {
        self.num_searched as f64 / self.num_total.max(1) as f64
    }
}

/// Looks for the outline of `sphere` within `search_px` of its prediction. Pixels of the object, in front
/// of the sphere, are not looked at.
pub(super) fn refine_outline(
    photo: &Photo,
    sphere: &SphereInCamera,
    search_px: f64,
    effort: Effort,
) -> RefinedOutline {
    let (image, intrinsics, exclude) = (photo.image, photo.intrinsics, photo.object);
    let mut found = RefinedOutline::default();
    let Some(cone) = sphere.cone() else {
        return found;
    };
    let radius_px = sphere.radius_px(intrinsics);
    // One normal a pixel; more would look at the same pixels again.
    let num_normals = ((std::f64::consts::TAU * radius_px).round() as usize).clamp(24, 2000);
    // Inside a small sphere the search must not cross to the far side.
    let inner_px = search_px.min(0.5 * radius_px);
    let mut profile = Profile::new(inner_px, search_px, image.channels);
    let appearance = appearance(photo, sphere, effort);
    let tangent = (sphere.center.coords.norm_squared() - sphere.radius * sphere.radius).sqrt();
    let wider = OutlineCone {
        half_angle: cone.half_angle * (1.0 + 1.0 / radius_px),
        ..cone
    };
    found.num_total = num_normals;
    let mut edges: Vec<(f64, Point2<f64>)> = Vec::with_capacity(num_normals);
    for k in 0..num_normals {
        let angle = std::f64::consts::TAU * k as f64 / num_normals as f64;
        let (Some(at), Some(outer)) = (
            intrinsics.project(&Point3::from(cone.ray(angle))),
            intrinsics.project(&Point3::from(wider.ray(angle))),
        ) else {
            continue;
        };
        let normal = (outer - at).normalize();
        if !profile.sample(image, &at, &normal, exclude) {
            continue;
        }
        found.num_searched += 1;
        if let Some(lights) = &appearance {
            let at_limb = (cone.ray(angle) * tangent - sphere.center.coords) / sphere.radius;
            profile.subtract(lights, |p| {
                sphere.normal_at(intrinsics, p).unwrap_or(at_limb)
            });
        }
        if let Some((shift, strength)) = profile.edge() {
            edges.push((strength, at + normal * shift));
        }
    }
    found.num_edges = edges.len();
    let mut strengths: Vec<f64> = edges.iter().map(|(strength, _)| *strength).collect();
    let limit = WEAK_EDGE * rilievo_numerics::robust::quantile(&mut strengths, 0.6).unwrap_or(0.0);
    found.points = edges
        .into_iter()
        .filter_map(|(strength, point)| (strength >= limit).then_some(point))
        .collect();
    found
}

/// Smallest sphere whose inside is worth a fit, pixels of radius.
const MIN_RADIUS_PX: f64 = 8.0;

/// Nine harmonics per channel on the inside of a sphere; `None` where they cannot be had.
///
/// The good pixels are chosen on the mean of the channels, so that a shadow is found once.
fn appearance(
    photo: &Photo,
    sphere: &SphereInCamera,
    effort: Effort,
) -> Option<Vec<SphericalHarmonics>> {
    let image = photo.image;
    let radius_px = sphere.radius_px(photo.intrinsics);
    if radius_px < MIN_RADIUS_PX {
        return None;
    }
    let pixels: Vec<_> = sphere
        .pixels(photo.intrinsics, (0.06 * radius_px).max(2.0))
        .into_iter()
        .filter(|p| !photo.is_object(p.x as isize, p.y as isize))
        .collect();
    // A smooth function of nine numbers: a thousand pixels determine it.
    let num_enough = match effort {
        Effort::Quick => 400,
        Effort::Thorough => 1200,
    };
    let stride = pixels.len().div_ceil(num_enough).max(1);
    let few: Vec<_> = pixels.iter().step_by(stride).collect();
    let normals: Vec<Vector3<f64>> = few.iter().map(|p| p.normal_in_cam).collect();
    let channel_of = |channel: usize| -> Vec<f64> {
        few.iter()
            .map(|p| f64::from(image.pixel(p.x, p.y)[channel]))
            .collect()
    };
    let weights = match effort {
        Effort::Quick => vec![1.0; few.len()],
        Effort::Thorough => {
            let grey: Vec<f64> = few
                .iter()
                .map(|p| image.pixel(p.x, p.y).iter().map(|&v| f64::from(v)).sum())
                .collect();
            let fit = fit_robust(&normals, &grey, None).ok()?;
            let good = |(n, v): (&Vector3<f64>, &f64)| {
                (fit.coefficients.evaluate(n) - v).abs() <= 3.0 * fit.sigma
            };
            let flags = normals.iter().zip(&grey).map(good);
            flags.map(|is_good| f64::from(u8::from(is_good))).collect()
        }
    };
    (0..image.channels)
        .map(|channel| {
            let values = channel_of(channel);
            let fit = fit_with(&normals, &values, Some(&weights), &FitOptions::QUICK);
            Some(fit.ok()?.coefficients)
        })
        .collect()
}

/// Samples along one normal; buffers are reused from normal to normal.
struct Profile {
    inner_px: f64,
    channels: usize,
    num_samples: usize,
    positions: Vec<Point2<f64>>,
    values: Vec<f64>,
    /// The sphere's brightness as fitted, at the samples, and as pixels see it.
    sharp: Vec<f64>,
    model: Vec<f64>,
    /// Samples at the inner end that surely lie on the sphere.
    num_inner: usize,
    /// Root mean square of the intensities along the normal, all channels together.
    size: f64,
    step: Vec<f64>,
}

/// Samples in one pixel along the normal.
const PER_PIXEL: usize = 4;
/// A triangle two pixels wide, sampled in quarters of a pixel.
const TRIANGLE: [f64; 7] = [0.0625, 0.125, 0.1875, 0.25, 0.1875, 0.125, 0.0625];

impl Profile {
    fn new(inner_px: f64, outer_px: f64, channels: usize) -> Self {
        // One pixel more at either end, for the means on both sides.
        let num_samples = ((inner_px + outer_px + 2.0) / STEP_PX).round() as usize + 1;
        Self {
            inner_px: inner_px + 1.0,
            channels,
            num_samples,
            positions: vec![Point2::origin(); num_samples],
            size: 0.0,
            values: vec![0.0; num_samples * channels],
            sharp: vec![0.0; num_samples * channels],
            model: vec![0.0; num_samples * channels],
            num_inner: (((0.5 * inner_px + 1.0) / STEP_PX) as usize).max(2),
            step: vec![0.0; num_samples],
        }
    }

    /// Fills the samples; `false` where the normal leaves the frame or meets an excluded pixel.
    fn sample(
        &mut self,
        image: &LinearImage,
        at: &Point2<f64>,
        normal: &Vector2<f64>,
        exclude: Option<&PackedMask>,
    ) -> bool {
        for k in 0..self.num_samples {
            let p = at + normal * (k as f64 * STEP_PX - self.inner_px);
            self.positions[k] = p;
            if exclude.is_some_and(|m| m.contains(p.x.round() as isize, p.y.round() as isize)) {
                return false;
            }
            for channel in 0..self.channels {
                match image.sample(p.x, p.y, channel) {
                    Some(value) => self.values[k * self.channels + channel] = f64::from(value),
                    None => return false,
                }
            }
        }
        let square: f64 = self.values.iter().map(|v| v * v).sum();
        self.size = (square / self.num_samples as f64).sqrt();
        true
    }

    /// Takes the sphere's own brightness off, scaled to the inner part of the normal, so that a
    /// shadowed or dirty part of the sphere keeps the slope that is its own.
    fn subtract(
        &mut self,
        lights: &[SphericalHarmonics],
        normal_at: impl Fn(&Point2<f64>) -> Vector3<f64>,
    ) {
        let (c, inner) = (self.channels, self.num_inner);
        for (k, p) in self.positions.iter().enumerate() {
            let normal = normal_at(p);
            for (channel, light) in lights.iter().enumerate() {
                self.sharp[k * c + channel] = light.evaluate(&normal);
            }
        }
        // Pixels average over their area, and so does interpolation between them: a triangle of
        // two pixels' width. Left sharp, the limb's steep fall would push the edge outwards.
        for channel in 0..c {
            for k in 0..self.num_samples {
                let mut sum = 0.0;
                for (j, weight) in TRIANGLE.iter().enumerate() {
                    let at = (k + j)
                        .saturating_sub(PER_PIXEL - 1)
                        .min(self.num_samples - 1);
                    sum += weight * self.sharp[at * c + channel];
                }
                self.model[k * c + channel] = sum;
            }
        }
        for channel in 0..c {
            let at = |k: usize| (self.values[k * c + channel], self.model[k * c + channel]);
            let (mut cross, mut square) = (0.0, 0.0);
            for (value, model) in (0..inner).map(at) {
                cross += value * model;
                square += model * model;
            }
            let scale = if square > 0.0 {
                (cross / square).clamp(0.0, 2.0)
            } else {
                1.0
            };
            for k in 0..self.num_samples {
                self.values[k * c + channel] -= scale * self.model[k * c + channel];
            }
        }
    }

    /// Position of the edge outwards of the prediction, pixels, and the size of its step.
    fn edge(&mut self) -> Option<(f64, f64)> {
        let c = self.channels;
        let range = PER_PIXEL..self.num_samples - PER_PIXEL;
        let mut largest = 0.0_f64;
        for k in range.clone() {
            let mut square = 0.0;
            for channel in 0..c {
                let mut difference = 0.0;
                for j in 1..=PER_PIXEL {
                    difference +=
                        self.values[(k + j) * c + channel] - self.values[(k - j) * c + channel];
                }
                square += (difference / PER_PIXEL as f64).powi(2);
            }
            self.step[k] = square.sqrt();
            largest = largest.max(self.step[k]);
        }
        let limit = (EDGE_SHARE * largest).max(MIN_CONTRAST * self.size);
        let peak = (range.start + 1..range.end - 1).find(|&k| {
            self.step[k] >= limit
                && self.step[k] >= self.step[k - 1]
                && self.step[k] > self.step[k + 1]
        })?;
        let (before, here, after) = (self.step[peak - 1], self.step[peak], self.step[peak + 1]);
        let curvature = before - 2.0 * here + after;
        let offset = if curvature < 0.0 {
            0.5 * (before - after) / curvature
        } else {
            0.0
        };
        let position = (peak as f64 + offset.clamp(-0.5, 0.5)) * STEP_PX - self.inner_px;
        Some((position, here))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sphere::mark::{MIN_INLIER_SHARE, cone_from_points};
    use rilievo_scene::Intrinsics;

    /// A disc of constant brightness with exact coverage by supersampling.
    fn render(camera: &Intrinsics, sphere: &SphereInCamera) -> LinearImage {
        let mut image = LinearImage::filled(camera.width, camera.height, 1, 0.0);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let mut inside = 0;
                for sub in 0..64 {
                    let p = Point2::new(
                        x as f64 + (f64::from(sub % 8) - 3.5) / 8.0,
                        y as f64 + (f64::from(sub / 8) - 3.5) / 8.0,
                    );
                    let ray = camera.ray(&p).normalize();
                    inside += i32::from(sphere.distance_along(&ray).is_some());
                }
                let share = inside as f32 / 64.0;
                image.pixel_mut(x, y)[0] = 0.7 * share + 0.2 * (1.0 - share);
            }
        }
        image
    }

    #[test]
    fn edge_points_lie_on_the_outline_to_a_twentieth_of_a_pixel() {
        let camera = Intrinsics::pinhole(320, 240, 400.0, 159.5, 119.5);
        let truth = SphereInCamera {
            center: Point3::new(0.13, 0.05, 0.8),
            radius: 0.08,
        };
        let guess = SphereInCamera {
            center: Point3::new(0.132, 0.047, 0.81),
            radius: 0.08,
        };
        let image = render(&camera, &truth);
        let photo = Photo {
            image: &image,
            intrinsics: &camera,
            object: None,
            clip_level: 1.0,
        };
        let found = refine_outline(&photo, &guess, 4.0, Effort::Thorough);
        assert!(found.support() > 0.99, "support {}", found.support());
        let fit = cone_from_points(&found.points, &camera, MIN_INLIER_SHARE).unwrap();
        let center = fit.cone.sphere(0.08).center;
        let off_px = 400.0 / 0.8 * (center - truth.center).xy().norm();
        assert!(off_px < 0.02, "centre off by {off_px} px");
        let radius_px = 40.0 * (center.z / truth.center.z - 1.0).abs();
        assert!(radius_px < 0.05, "radius off by {radius_px} px");
        assert!(fit.rms_px < 0.1, "scatter {} px", fit.rms_px);
    }
}
