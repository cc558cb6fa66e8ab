//! Whether a pixel makes a point, and which.
//!
//! A pixel's point `X` with normal `n` is compared with every other view ([`crate::sight`]). It is
//! kept when enough views see the same surface and no more look through it than agree; its
//! position is the mean of the agreeing surfaces along the normal,
//! `X + n Σ w_j d_j / Σ w_j` with `w = c cos²θ / a²` (confidence, angle of incidence, pixel
//! footprint), its normal their mean with the same weights. Views emit it in the order of their
//! pixels per area, `cosθ / a²`, until there are two points per squared footprint; where all views
//! together give fewer, for the surface is oblique to all, pixels are split.
//!
//! The tolerance follows the data: four robust standard deviations of the distances between the
//! views, widened where confidence is low, between one footprint and [`DEPTH_TOLERANCE_PX`].

use crate::color::Palette;
use crate::reach::Patch;
use crate::sight::{Candidate, DEPTH_TOLERANCE_PX, SameSurface, Sight, look};
use crate::view::{Surface, View};
use nalgebra::{Point2, Point3, Vector3};
use rilievo_scene::{CloudPoint, PageCache};
use serde::{Deserialize, Serialize};

/// Points per squared footprint that the better views must give together before the others leave a
/// place to them. At 2 nearly no place is farther than a footprint from a point; every pixel of
/// every view would give twice as many points and no more detail.
const ENOUGH: f64 = 2.0;

/// Parts along each side into which an oblique pixel is split at most: at 82 degrees of incidence
/// a pixel covers seven footprints.
const MAX_SPLIT: usize = 4;

/// Points between pixels are made where depths and normals agree on the surface there to this many
/// footprints; elsewhere the pixel's own point is all that is known. Less leaves gaps of a
/// footprint on oblique slopes that bend.
const MAX_STRAIN_PX: f64 = 0.25;
/// The same at the rim, where the surface turns away within a pixel.
const MAX_STRAIN_AT_RIM_PX: f64 = 0.15;
/// Cosine of incidence from which on the rim begins: 72 degrees.
const RIM_COSINE: f64 = 0.3;

/// Distance from a view's surface beyond which a point lies apart from it, pixel footprints.
const APART_PX: f64 = 3.0;

enum Verdict {
    /// Too few views agree, or others see through it.
    Inconsistent,
    /// Views that resolve it better give enough points.
    Elsewhere,
    Keep {
        point: CloudPoint,
        /// Points per squared footprint that all views together give here.
        coverage: f64,
        /// Whether most views that cover the point have their surfaces apart from it; `None` where
        /// no view does.
        is_apart: Option<bool>,
    },
}

/// Views that may see a page's surface, those first that resolve it best.
struct Near<'a> {
    views: Vec<&'a View>,
    /// No pixel of theirs on it is smaller than this, world's unit.
    finest: f64,
}

/// The points of one page, and counts.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct PageShare {
    pub points: Vec<CloudPoint>,
    pub num_tried: usize,
    pub num_inconsistent: usize,
    pub num_covered: usize,
    pub num_apart: usize,
    /// Of the pixel that was judged last.
    walls: Vec<f64>,
}

/// What all pixels are judged by.
pub(crate) struct Judge {
    pub palette: Palette,
    /// Distance up to which confident views agree, pixel footprints.
    pub tolerance_px: f64,
    pub min_num_views: usize,
    pub min_normal_cosine: f64,
}

impl Judge {
    /// Points of a page of a view.
    pub fn page(
        &self,
        pixels: &mut PageCache<'_>,
        views: &[View],
        view: &View,
        page: usize,
    ) -> PageShare {
        let mut share = PageShare::default();
        let Some(patch) = self.patch(pixels, view, page) else {
            return share;
        };
        // Those that resolve the patch best come first: they soonest show that a place is theirs.
        let mut near: Vec<&View> = views
            .iter()
            .filter(|other| other.idx == view.idx || patch.may_be_seen_by(other))
            .collect();
        near.sort_by(|a, b| patch.density(b).total_cmp(&patch.density(a)));
        let footprints = near.iter().map(|view| patch.least_footprint(view));
        let near = Near {
            finest: footprints.fold(f64::INFINITY, f64::min),
            views: near,
        };
        let [across, down] = view.pages.extent(page);
        for y in down {
            for x in across.clone() {
                let pixel = view.pixel(pixels, x, y);
                let Some(surface) = pixel.surface().filter(|s| s.makes_points) else {
                    continue;
                };
                share.num_tried += 1;
                let ray = view.ray(x, y, &pixel);
                match self.pixel(pixels, &near, view, &ray, &surface, &mut share.walls) {
                    Verdict::Inconsistent => share.num_inconsistent += 1,
                    Verdict::Elsewhere => {}
                    Verdict::Keep {
                        point,
                        coverage,
                        is_apart,
                    } => {
                        let split = (ENOUGH / coverage).sqrt().ceil() as usize;
                        let num_before = share.points.len();
                        if split > 1 {
                            let n = split.min(MAX_SPLIT);
                            self.split(pixels, &near, view, [x, y], n, &mut share);
                        }
                        if share.points.len() == num_before {
                            share.keep(point, is_apart);
                        }
                    }
                }
            }
        }
        share
    }

    /// The surface of a page and around it, grown by what its points may be moved; `None` where no
    /// pixel makes points.
    fn patch(&self, pixels: &mut PageCache<'_>, view: &View, page: usize) -> Option<Patch> {
        let [across, down] = view
            .pages
            .extent(page)
            .map(|range| range.start.saturating_sub(1)..range.end + 1);
        let mut surfaces = Vec::new();
        let (mut makes_points, mut widest) = (false, 0.0_f64);
        for y in down.start..down.end.min(view.camera.height) {
            for x in across.start..across.end.min(view.camera.width) {
                let pixel = view.pixel(pixels, x, y);
                let Some(surface) = pixel.surface() else {
                    continue;
                };
                let candidate = Candidate::of(view, &view.ray(x, y, &pixel), &surface);
                makes_points |= surface.makes_points;
                widest = widest.max(candidate.footprint);
                surfaces.push((candidate.point, candidate.normal));
            }
        }
        // Between pixels the surface bulges by less than a footprint.
        let margin = (DEPTH_TOLERANCE_PX + 1.0) * widest;
        Patch::around(&surfaces, margin).filter(|_| makes_points)
    }

    /// Adds `n × n` points of a pixel that all views see too obliquely for a point each.
    fn split(
        &self,
        pixels: &mut PageCache<'_>,
        near: &Near<'_>,
        view: &View,
        [x, y]: [usize; 2],
        n: usize,
        share: &mut PageShare,
    ) {
        let offset = |k: usize| (k as f64 + 0.5) / n as f64 - 0.5;
        for k in 0..n * n {
            let place = Point2::new(x as f64 + offset(k % n), y as f64 + offset(k / n));
            let ray = view.camera.ray(&place);
            let surface = view.along(pixels, &Point3::from(ray));
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
            if let Verdict::Keep {
                point, is_apart, ..
            } = self.pixel(pixels, near, view, &ray, &surface, &mut share.walls)
            {
                share.keep(point, is_apart);
            }
        }
    }

    /// Judges the surface of a view along a ray of its camera by the views near it, itself among
    /// them. `walls` is left holding where those that cover the point have their surfaces, along
    /// the normal.
    fn pixel(
        &self,
        pixels: &mut PageCache<'_>,
        near: &Near<'_>,
        view: &View,
        ray: &Vector3<f64>,
        surface: &Surface,
        walls: &mut Vec<f64>,
    ) -> Verdict {
        let candidate = Candidate::of(view, ray, surface);
        let widened = self.tolerance_px / surface.confidence.sqrt();
        let tolerance = widened.min(DEPTH_TOLERANCE_PX) * candidate.footprint;

        let own_cosine = -surface.normal.dot(ray) / ray.norm();
        let mut all = Agreement::of(&candidate, surface, own_cosine);
        let own_density = all.density;
        walls.clear();
        for other in near.views.iter().filter(|other| other.idx != view.idx) {
            let (sight, covers) =
                look(pixels, other, &candidate, tolerance, self.min_normal_cosine);
            walls.extend(covers);
            match sight {
                Sight::Same(seen) => {
                    let density = all.add(&seen);
                    // Ties go to the first view, so that the order is one for all.
                    let is_better =
                        density > own_density || (density == own_density && other.idx < view.idx);
                    if seen.makes_points && is_better {
                        all.better += density;
                    }
                }
                Sight::SeenThrough => all.num_through += 1,
                Sight::Nothing | Sight::Hidden => {}
            }
            let is_enough = all.better * near.finest * near.finest >= ENOUGH;
            if is_enough && all.is_kept(self.min_num_views) {
                return Verdict::Elsewhere;
            }
        }
        if !all.is_kept(self.min_num_views) {
            return Verdict::Inconsistent;
        }
        if all.better * all.finest * all.finest >= ENOUGH {
            return Verdict::Elsewhere;
        }
        let offset = all.offset / all.weights;
        let position = candidate.point + candidate.normal * offset;
        let color = self.palette.color(
            pixels,
            &near.views,
            view.idx,
            &position,
            tolerance.max(2.0 * candidate.footprint),
        );
        let point = CloudPoint {
            position: position.coords.map(|c| c as f32).into(),
            normal: all.normal.normalize().map(|c| c as f32).into(),
            color,
            confidence: all.confidence(tolerance) as f32,
            num_views: all.num_agree.min(255) as u8,
        };
        let is_far = |wall: &&f64| (**wall - offset).abs() > APART_PX * candidate.footprint;
        let is_apart = 2 * walls.iter().filter(is_far).count() > walls.len();
        Verdict::Keep {
            point,
            coverage: all.density * all.finest * all.finest,
            is_apart: (!walls.is_empty()).then_some(is_apart),
        }
    }
}

/// Sums over the views that see a pixel's surface, the pixel's own among them.
struct Agreement {
    num_agree: usize,
    /// Views that look through the point.
    num_through: usize,
    /// Weights; distances along the normal, their squares and confidences with these weights.
    weights: f64,
    offset: f64,
    square: f64,
    weighted_confidence: f64,
    normal: Vector3<f64>,
    /// Pixels per area of all views, and of those that resolve the place better.
    density: f64,
    better: f64,
    /// Smallest pixel footprint, world's unit.
    finest: f64,
}

impl Agreement {
    /// The pixel's own view alone.
    fn of(candidate: &Candidate, surface: &Surface, cosine: f64) -> Self {
        let footprint = candidate.footprint;
        let weight = weight(surface.confidence, cosine, footprint);
        Self {
            num_agree: 1,
            num_through: 0,
            weights: weight,
            offset: 0.0,
            square: 0.0,
            weighted_confidence: weight * surface.confidence,
            normal: candidate.normal * weight,
            density: cosine / (footprint * footprint),
            better: 0.0,
            finest: footprint,
        }
    }

    /// Adds a view that sees the same surface; returns its pixels per area.
    fn add(&mut self, seen: &SameSurface) -> f64 {
        let weight = weight(seen.confidence, seen.cosine, seen.footprint);
        self.num_agree += 1;
        self.offset += weight * seen.distance;
        self.square += weight * seen.distance * seen.distance;
        self.weights += weight;
        self.weighted_confidence += weight * seen.confidence;
        self.normal += seen.normal * weight;
        let density = seen.cosine / (seen.footprint * seen.footprint);
        self.finest = self.finest.min(seen.footprint);
        if seen.makes_points {
            self.density += density;
        }
        density
    }

    /// Whether enough views agree, and more than look through.
    fn is_kept(&self, min_num_views: usize) -> bool {
        self.num_agree >= min_num_views && self.num_through < self.num_agree
    }

    /// How likely the point is right: confidence of its pixels, number of independent sightings,
    /// and how well they agree.
    fn confidence(&self, tolerance: f64) -> f64 {
        let offset = self.offset / self.weights;
        let variance = self.square / self.weights - offset * offset;
        let spread = variance.max(0.0).sqrt() / tolerance;
        self.weighted_confidence / self.weights
            * (1.0 - 0.5_f64.powi(self.num_agree as i32))
            * (-0.5 * spread * spread).exp()
    }
}

impl PageShare {
    fn keep(&mut self, point: CloudPoint, is_apart: Option<bool>) {
        self.points.push(point);
        self.num_covered += usize::from(is_apart.is_some());
        self.num_apart += usize::from(is_apart == Some(true));
    }
}

/// Weight of a sighting.
#[inline]
pub(crate) fn weight(confidence: f64, cosine: f64, footprint: f64) -> f64 {
    confidence * (cosine * cosine).max(1e-4) / (footprint * footprint)
}
