//! The cloud: every piece of surface once, from the view that resolves it best.
//!
//! A pixel's point `X` with normal `n` is compared with every other view ([`crate::pairs`]). It is
//! kept when enough views see the same surface and no more look through it than agree; its
//! position is the mean of the agreeing surfaces along the normal,
//! `X + n Σ w_j d_j / Σ w_j` with `w = c cos²θ / a²` (confidence, angle of incidence, pixel
//! footprint), its normal their mean with the same weights. Views emit it in the order of their
//! pixels per area, `cosθ / a²`, until there are two points per squared footprint; where all views
//! together give fewer, for the surface is oblique to all, pixels are split.
//!
//! The tolerance follows the data: four robust standard deviations of the distances between the
//! views, widened where confidence is low, between one footprint and `depth_tolerance_px`.

use crate::color::ColorSource;
use crate::error::FusionError;
use crate::options::FusionOptions;
use crate::pairs::{Candidate, Sight, look, tolerance_px};
use crate::report::{Layering, ViewFusion};
use crate::view::{Surface, View};
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;
use rilievo_scene::{CloudPoint, Observer, StageId};

/// Points per squared footprint that the better views must give together before the others leave
/// a place to them. At 2 nearly no place is farther than a footprint from a point; every pixel of every
/// view would give twice as many points and no more detail.
const ENOUGH: f64 = 2.0;

/// Parts along each side into which an oblique pixel is split at most: at 82 degrees of incidence
/// a pixel covers seven footprints.
const MAX_SPLIT: usize = 4;

/// Points between pixels are made where depths and normals agree on the surface there to this many
/// footprints; elsewhere the pixel's own point is all that is known. Less leaves gaps of a footprint on
/// oblique slopes that bend.
const MAX_STRAIN_PX: f64 = 0.25;
/// The same at the rim, where the surface turns away within a pixel.
const MAX_STRAIN_AT_RIM_PX: f64 = 0.15;
/// Cosine of incidence from which on the rim begins: 72 degrees.
const RIM_COSINE: f64 = 0.3;

enum Verdict {
    /// Too few views agree, or others see through it.
    Inconsistent,
    /// Views that resolve it better give enough points.
    Elsewhere,
    Keep {
        point: CloudPoint,
        /// Points per squared footprint that all views together give here.
        coverage: f64,
    },
}

/// Gathers the points of all views, in the order of views and pixels.
pub(crate) fn gather(
    views: &[View],
    colors: &ColorSource,
    layering: &Layering,
    options: &FusionOptions,
    reports: &mut [ViewFusion],
    observer: &dyn Observer,
) -> Result<Vec<CloudPoint>, FusionError> {
    // A single view has nobody to agree with.
    let min_num_views = options.min_num_views.min(views.len());
    let tolerance = tolerance_px(layering.median, layering.footprint, options);
    let judge = Judge {
        views,
        colors,
        tolerance_px: tolerance,
        min_num_views,
        options,
    };
    let mut points = Vec::new();
    let mut num_candidates = 0;
    for (i, view) in views.iter().enumerate() {
        let flow = observer.progress(StageId::Fusion, "gathering points", (i, views.len()));
        flow.ok_or(FusionError::Interrupted)?;
        let rows: Vec<(Vec<CloudPoint>, usize, usize)> = (0..view.depth.height)
            .into_par_iter()
            .map(|y| {
                let mut kept = Vec::new();
                let (mut tried, mut inconsistent) = (0, 0);
                for x in 0..view.depth.width {
                    let Some(surface) = view.at(x, y).filter(|s| s.gives) else {
                        continue;
                    };
                    match judge.pixel(i, &view.ray(x, y), &surface) {
                        Verdict::Inconsistent => inconsistent += 1,
                        Verdict::Elsewhere => {}
                        Verdict::Keep { point, coverage } => {
                            let split = (ENOUGH / coverage).sqrt().ceil() as usize;
                            let num_before = kept.len();
                            if split > 1 {
                                judge.split(i, [x, y], split.min(MAX_SPLIT), &mut kept);
                            }
                            if kept.len() == num_before {
                                kept.push(point);
                            }
                        }
                    }
                    tried += 1;
                }
                (kept, tried, inconsistent)
            })
            .collect();
        let report = &mut reports[i];
        for (kept, tried, inconsistent) in rows {
            num_candidates += tried;
            report.num_inconsistent += inconsistent;
            report.num_points += kept.len();
            points.extend(kept);
        }
    }
    if points.is_empty() {
        return Err(FusionError::NothingAgrees {
            num_candidates,
            min_num_views,
            tolerance_px: tolerance,
        });
    }
    if options.spacing > 0.0 {
        points = thin(points, options.spacing);
    }
    Ok(points)
}

/// What all pixels are judged by.
struct Judge<'a> {
    views: &'a [View],
    colors: &'a ColorSource,
    tolerance_px: f64,
    min_num_views: usize,
    options: &'a FusionOptions,
}

impl Judge<'_> {
    /// Adds `n × n` points of a pixel that all views see too obliquely for a point each.
    fn split(&self, idx: usize, [x, y]: [usize; 2], n: usize, kept: &mut Vec<CloudPoint>) {
        let view = &self.views[idx];
        let offset = |k: usize| (k as f64 + 0.5) / n as f64 - 0.5;
        for k in 0..n * n {
            let place = Point2::new(x as f64 + offset(k % n), y as f64 + offset(k / n));
            let ray = view.camera.ray(&place);
            let surface = view.along(&Point3::from(ray));
            let is_smooth = |s: &Surface| {
                let cosine = -s.normal.dot(&ray) / ray.norm();
                let max = if cosine < RIM_COSINE {
                    MAX_STRAIN_AT_RIM_PX
                } else {
                    MAX_STRAIN_PX
                };
                !s.is_extrapolated && s.strain_px < max
            };
            let Some(surface) = surface.filter(is_smooth) else {
                continue;
            };
            if let Verdict::Keep { point, .. } = self.pixel(idx, &ray, &surface) {
                kept.push(point);
            }
        }
    }

    /// Judges the surface of view `idx` along a ray of its camera.
    fn pixel(&self, idx: usize, ray: &Vector3<f64>, surface: &Surface) -> Verdict {
        let Self {
            views,
            colors,
            tolerance_px,
            min_num_views,
            options,
        } = *self;
        let view = &views[idx];
        let candidate = Candidate {
            point: view.point_to_world(&(ray * surface.depth)),
            normal: view.to_world(&surface.normal),
            footprint: view.footprint(surface.depth),
        };
        let min_normal_cosine = options.normal_tolerance_deg.to_radians().cos();
        let widened = tolerance_px / surface.confidence.sqrt();
        let tolerance = widened.min(options.depth_tolerance_px) * candidate.footprint;

        let weight_of = |confidence: f64, cosine: f64, footprint: f64| {
            confidence * (cosine * cosine).max(1e-4) / (footprint * footprint)
        };
        let own_cosine = -surface.normal.dot(ray) / ray.norm();
        let own_weight = weight_of(surface.confidence, own_cosine, candidate.footprint);
        let own_density = own_cosine / (candidate.footprint * candidate.footprint);
        let (mut num_agree, mut num_through) = (1_usize, 0_usize);
        let (mut offset, mut weights) = (0.0, own_weight);
        let (mut square, mut confidence) = (0.0, own_weight * surface.confidence);
        let mut normal = candidate.normal * own_weight;
        let (mut better, mut all) = (0.0, own_density);
        let mut finest = candidate.footprint;
        for (j, other) in views.iter().enumerate() {
            if j == idx {
                continue;
            }
            match look(other, &candidate, tolerance, min_normal_cosine) {
                Sight::Same {
                    distance,
                    normal: other_normal,
                    cosine,
                    footprint,
                    confidence: c,
                    gives,
                } => {
                    let weight = weight_of(c, cosine, footprint);
                    num_agree += 1;
                    offset += weight * distance;
                    square += weight * distance * distance;
                    weights += weight;
                    confidence += weight * c;
                    normal += other_normal * weight;
                    let density = cosine / (footprint * footprint);
                    finest = finest.min(footprint);
                    // Ties go to the first view, so that the order is one for all.
                    if gives {
                        all += density;
                    }
                    if gives && (density > own_density || (density == own_density && j < idx)) {
                        better += density;
                    }
                }
                Sight::SeenThrough => num_through += 1,
                Sight::Nothing | Sight::Hidden => {}
            }
        }
        if num_agree < min_num_views || num_through >= num_agree {
            return Verdict::Inconsistent;
        }
        if better * finest * finest >= ENOUGH {
            return Verdict::Elsewhere;
        }
        let normal = normal.normalize();
        let mean_offset = offset / weights;
        let position = candidate.point + candidate.normal * mean_offset;
        // How likely the point is right: confidence of its pixels, number of independent sightings,
        // and how well they agree.
        let spread = (square / weights - mean_offset * mean_offset)
            .max(0.0)
            .sqrt()
            / tolerance;
        let confidence = confidence / weights
            * (1.0 - 0.5_f64.powi(num_agree as i32))
            * (-0.5 * spread * spread).exp();
        let point = CloudPoint {
            position: position.coords.map(|c| c as f32).into(),
            normal: normal.map(|c| c as f32).into(),
            color: colors.color(
                views,
                idx,
                &position,
                tolerance.max(2.0 * candidate.footprint),
            ),
            confidence: confidence as f32,
            num_views: num_agree.min(255) as u8,
        };
        Verdict::Keep {
            point,
            coverage: all * finest * finest,
        }
    }
}

/// One point, the most confident, in every cube of edge `spacing`.
fn thin(points: Vec<CloudPoint>, spacing: f64) -> Vec<CloudPoint> {
    let cell = |p: &CloudPoint| p.position.map(|c| (f64::from(c) / spacing).floor() as i64);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| {
        cell(&points[a])
            .cmp(&cell(&points[b]))
            .then(points[b].confidence.total_cmp(&points[a].confidence))
            .then(a.cmp(&b))
    });
    order.dedup_by(|a, b| cell(&points[*a]) == cell(&points[*b]));
    order.sort_unstable();
    order.into_iter().map(|i| points[i]).collect()
}

/// Mean of the points' normals and colours around a place, by nearness.
pub(crate) fn blend(points: &[CloudPoint], nearest: &[(usize, f64)]) -> (Vector3<f32>, [u8; 3]) {
    let scale = nearest.iter().map(|n| n.1).fold(0.0, f64::max).max(1e-300);
    let (mut normal, mut color, mut sum) = (Vector3::zeros(), Vector3::<f64>::zeros(), 0.0);
    for &(i, square) in nearest {
        let point = &points[i];
        let weight = f64::from(point.confidence).max(0.01) * (1.05 - square / scale);
        normal += Vector3::from(point.normal.map(f64::from)) * weight;
        color += Vector3::from(point.color.map(f64::from)) * weight;
        sum += weight;
    }
    let color = (color / sum).map(|c| c.round() as u8);
    (normal.normalize().map(|c| c as f32), color.into())
}
