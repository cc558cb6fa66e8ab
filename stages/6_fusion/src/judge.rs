//! Whether a pixel gives a point, and which.
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

use crate::color::Palette;
use crate::options::FusionOptions;
use crate::pairs::{Candidate, Sight, look};
use crate::reach::Patch;
use crate::reader::Reader;
use crate::view::{Pixels, Surface, View};
use nalgebra::{Point2, Point3, Vector3};
use rilievo_scene::CloudPoint;
use serde::{Deserialize, Serialize};

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
        /// Whether most views that cover the point have their surfaces apart from it; `None` where no view does.
        is_apart: Option<bool>,
    },
}

/// Views that may see a page's surface, those first that resolve it best.
struct Near<'a> {
    views: Vec<&'a View>,
    /// No pixel of theirs on it is smaller than this, world's unit.
    finest: f64,
}

/// What one page gives.
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
pub(crate) struct Judge<'a> {
    pub palette: Palette,
    /// Distance up to which confident views agree, pixel footprints.
    pub tolerance_px: f64,
    pub min_num_views: usize,
    pub options: &'a FusionOptions,
}

impl Judge<'_> {
    /// Points of a page of a view.
    pub fn page(
        &self,
        pixels: &mut Reader<'_>,
        views: &[View],
        view: &View,
        page: usize,
    ) -> PageShare {
        let mut share = PageShare::default();
        let Some(patch) = self.patch(pixels, view, page) else {
            return share;
        };
        // Those that resolve the patch best come first: they soonest tell that a place is theirs.
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
                let pixel = pixels.pixel(view, x, y);
                let Some(surface) = pixel.surface().filter(|s| s.gives) else {
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

    /// The surface of a page and around it, grown by what its points may be moved; `None` where no pixel gives points.
    fn patch(&self, pixels: &mut Reader<'_>, view: &View, page: usize) -> Option<Patch> {
        let [across, down] = view
            .pages
            .extent(page)
            .map(|range| range.start.saturating_sub(1)..range.end + 1);
        let mut surfaces = Vec::new();
        let (mut gives, mut widest) = (false, 0.0_f64);
        for y in down.start..down.end.min(view.camera.height) {
            for x in across.start..across.end.min(view.camera.width) {
                let pixel = pixels.pixel(view, x, y);
                let Some(surface) = pixel.surface() else {
                    continue;
                };
                let candidate = Candidate::of(view, &view.ray(x, y, &pixel), &surface);
                gives |= surface.gives;
                widest = widest.max(candidate.footprint);
                surfaces.push((candidate.point, candidate.normal));
            }
        }
        // Between pixels the surface bulges by less than a footprint.
        let margin = (self.options.depth_tolerance_px + 1.0) * widest;
        Patch::around(&surfaces, margin).filter(|_| gives)
    }

    /// Adds `n × n` points of a pixel that all views see too obliquely for a point each.
    fn split(
        &self,
        pixels: &mut Reader<'_>,
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

    /// Judges the surface of a view along a ray of its camera by the views near it, itself among them. `walls` is left
    /// holding where those that cover the point have their surfaces, along the normal.
    fn pixel(
        &self,
        pixels: &mut Reader<'_>,
        near: &Near<'_>,
        view: &View,
        ray: &Vector3<f64>,
        surface: &Surface,
        walls: &mut Vec<f64>,
    ) -> Verdict {
        let options = self.options;
        let candidate = Candidate::of(view, ray, surface);
        let min_normal_cosine = options.normal_tolerance_deg.to_radians().cos();
        let widened = self.tolerance_px / surface.confidence.sqrt();
        let tolerance = widened.min(options.depth_tolerance_px) * candidate.footprint;

        let own_cosine = -surface.normal.dot(ray) / ray.norm();
        let own_weight = weight(surface.confidence, own_cosine, candidate.footprint);
        let own_density = own_cosine / (candidate.footprint * candidate.footprint);
        let (mut num_agree, mut num_through) = (1_usize, 0_usize);
        let (mut offset, mut weights) = (0.0, own_weight);
        let (mut square, mut confidence) = (0.0, own_weight * surface.confidence);
        let mut normal = candidate.normal * own_weight;
        let (mut better, mut all) = (0.0, own_density);
        let mut finest = candidate.footprint;
        walls.clear();
        for other in near.views.iter().filter(|other| other.idx != view.idx) {
            let (sight, covers) = look(pixels, other, &candidate, tolerance, min_normal_cosine);
            walls.extend(covers);
            match sight {
                Sight::Same {
                    distance,
                    normal: other_normal,
                    cosine,
                    footprint,
                    confidence: c,
                    gives,
                } => {
                    let weight = weight(c, cosine, footprint);
                    num_agree += 1;
                    offset += weight * distance;
                    square += weight * distance * distance;
                    weights += weight;
                    confidence += weight * c;
                    normal += other_normal * weight;
                    let density = cosine / (footprint * footprint);
                    finest = finest.min(footprint);
                    // Ties go to the first view, so that the order is one for all.
                    let is_better =
                        density > own_density || (density == own_density && other.idx < view.idx);
                    if gives {
                        all += density;
                    }
                    if gives && is_better {
                        better += density;
                    }
                }
                Sight::SeenThrough => num_through += 1,
                Sight::Nothing | Sight::Hidden => {}
            }
            let is_enough = better * near.finest * near.finest >= ENOUGH;
            if is_enough && num_agree >= self.min_num_views && num_through < num_agree {
                return Verdict::Elsewhere;
            }
        }
        if num_agree < self.min_num_views || num_through >= num_agree {
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
        let color = self.palette.color(
            pixels,
            &near.views,
            view.idx,
            &position,
            tolerance.max(2.0 * candidate.footprint),
        );
        let point = CloudPoint {
            position: position.coords.map(|c| c as f32).into(),
            normal: normal.map(|c| c as f32).into(),
            color,
            confidence: confidence as f32,
            num_views: num_agree.min(255) as u8,
        };
        let is_far = |wall: &&f64| (**wall - mean_offset).abs() > APART_PX * candidate.footprint;
        let is_apart = 2 * walls.iter().filter(is_far).count() > walls.len();
        Verdict::Keep {
            point,
            coverage: all * finest * finest,
            is_apart: (!walls.is_empty()).then_some(is_apart),
        }
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
