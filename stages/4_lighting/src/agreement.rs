//! Whether several spheres see one light.
//!
//! # Problem
//! Under a distant light, matte spheres of one paint have one brightness at equal normals, wherever
//! they stand. A sphere in a shadow, or beside something bright, or under a near lamp, has another;
//! so has one of another paint, but by one factor per channel.
//!
//! # Steps
//! 1. Each sphere's own light: a robust fit over all views (a light fixed to the world), or one per
//!    view (fixed to the camera).
//! 2. For every pair, the light of one applied to the pixels of the other, at normals that both
//!    show: the median ratio per channel is the paint's, and the residual after it shows whether the
//!    lights agree.
//! 3. The sphere with which most others agree is the reference; of equals the brightest, since a
//!    shadow takes light away and seldom anything adds any.
//! 4. Spheres that agree with it count, brightness divided by their paint where that is another's;
//!    the others are left out, and said to be.

use crate::error::LightingError;
use crate::error::warn;
use crate::pool::Pool;
use crate::report::LightingReport;
use crate::residual::residual_of;
use crate::side::{Patch, Side};
use nalgebra::{UnitQuaternion, Vector3};
use rilievo_numerics::robust::median;
use rilievo_photometry::harmonics::{Reading, dominant_direction};
use rilievo_photometry::samples::{NUM_CELLS, cell_of};
use rilievo_photometry::surface_check::MAX_SAMPLES;
use rilievo_scene::{LightKind, Lighting, Observer};

/// Residual on another sphere, beyond its own, below which two lights are one whatever their ratio:
/// uneven paint and the mat's bounce light differ by this much between spheres that stand well.
const SMALLEST_GAP: f64 = 0.04;
/// Two spheres see one light where the light of one leaves at most this times as much of the other
/// unexplained as the other's own light does. Larger lets a shadowed sphere count, smaller leaves good
/// ones out for their uneven paint.
const MAX_RATIO: f64 = 1.4;
/// Logarithm of a brightness ratio below which two paints are one. A smaller difference moves their
/// common light by less than what nine harmonics leave unexplained of a matte sphere.
const SAME_PAINT: f64 = 0.03;
/// Fewest pixels at common normals that compare two spheres: of fewer, a rim or a stain makes the
/// median.
const MIN_COMMON: usize = 100;

/// Views that share one light: all of a light fixed in the world, or one of a light fixed to the
/// camera.
struct Group<'a> {
    /// Patches by sphere.
    patches: Vec<Vec<&'a Patch>>,
    /// Own light by sphere.
    own: Vec<Option<Lighting>>,
}

/// One sphere's pixels under another's light.
#[derive(Clone, Debug)]
struct Comparison {
    /// Brightness over what the other's light predicts, per channel.
    ratio: Vec<f64>,
    /// Residual after that ratio.
    rms: f64,
    /// Residual of the sphere's own light at the same pixels.
    own_rms: f64,
    /// Angle between the dominant directions of both lights, degrees.
    direction_deg: Option<f64>,
}

impl Comparison {
    fn agrees(&self) -> bool {
        self.rms <= (MAX_RATIO * self.own_rms).max(self.own_rms + SMALLEST_GAP)
    }

    fn mean_ratio(&self) -> f64 {
        self.ratio.iter().sum::<f64>() / self.ratio.len().max(1) as f64
    }
}

/// Compares the spheres, decides which count ([`Side::paint`]), and reports. `gains` per view of
/// `side`.
///
/// # Errors
/// [`LightingError::Interrupted`].
pub(crate) fn judge(
    side: &mut Side,
    gains: &[Vec<f64>],
    kind: LightKind,
    report: &mut LightingReport,
    observer: &dyn Observer,
) -> Result<(), LightingError> {
    let num_spheres = side.paint.len();
    let seen = |k: usize| side.patches.iter().any(|patch| patch.sphere == k);
    let spheres: Vec<usize> = (0..num_spheres).filter(|&k| seen(k)).collect();
    if spheres.len() < 2 {
        return Ok(());
    }
    let frames = Frames { side, gains, kind };
    let groups = frames.groups();
    let compare = |k: usize, by: usize| frames.compare(&groups, k, by);
    // How many agree with a sphere, and how much brighter it is than they are.
    let standing = |by: usize| {
        let others = spheres.iter().filter(|&&k| k != by);
        let found: Vec<Comparison> = others.filter_map(|&k| compare(k, by)).collect();
        let agreeing = found.iter().filter(|c| c.agrees()).count();
        let brighter: f64 = found.iter().map(|c| -c.mean_ratio().max(1e-6).ln()).sum();
        (agreeing, brighter)
    };
    let best = spheres
        .iter()
        .map(|&k| (standing(k), k))
        .max_by(|(a, i), (b, j)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(j.cmp(i)));
    let Some((_, reference)) = best else {
        return Ok(());
    };
    let others = spheres.iter().filter(|&&k| k != reference);
    let verdicts: Vec<_> = others.map(|&k| (k, compare(k, reference))).collect();
    let mut paint = side.paint.clone();
    let by = report.spheres[reference].name.clone();
    for (k, verdict) in verdicts {
        let name = report.spheres[k].name.clone();
        let Some(found) = verdict else {
            let message = format!(
                "{name} and {by} show no common normals: whether they see one light is not known"
            );
            warn(observer, message)?;
            continue;
        };
        let facts = &mut report.spheres[k];
        facts.compared_with = Some(by.clone());
        facts.brightness_ratio.clone_from(&found.ratio);
        facts.own_rms = Some(found.own_rms);
        facts.other_rms = Some(found.rms);
        facts.direction_difference_deg = found.direction_deg;
        if !found.agrees() {
            facts.left_out = true;
            paint[k] = None;
            let direction = found.direction_deg.map_or(String::new(), |angle| {
                format!(", from a direction {angle:.0} degrees away")
            });
            let message = format!(
                "{name} does not see the light that {by} sees: it is {:.2} times as bright at equal \
                 normals{direction}; {by}'s light leaves {:.1} % of it unexplained, its own {:.1} %: \
                 it stands in a shadow or bounce light, or the light is not distant; it is left out",
                found.mean_ratio(),
                100.0 * found.rms,
                100.0 * found.own_rms,
            );
            warn(observer, message)?;
        } else if found
            .ratio
            .iter()
            .any(|r| r.max(1e-6).ln().abs() > SAME_PAINT)
        {
            let message = format!(
                "{name} is {} times as bright as {by} at equal normals{}: another paint, or less \
                 light; it counts with that factor",
                listed(&found.ratio),
                if found.ratio.len() > 1 {
                    " (per channel)"
                } else {
                    ""
                }
            );
            warn(observer, message)?;
            paint[k] = Some(found.ratio);
        }
    }
    side.paint = paint;
    Ok(())
}

fn listed(ratios: &[f64]) -> String {
    let ratios: Vec<String> = ratios.iter().map(|r| format!("{r:.2}")).collect();
    ratios.join(", ")
}

/// How patches are brought into one frame.
struct Frames<'a> {
    side: &'a Side,
    gains: &'a [Vec<f64>],
    kind: LightKind,
}

impl<'a> Frames<'a> {
    fn rotation(&self, patch: &Patch) -> UnitQuaternion<f64> {
        match self.kind {
            LightKind::World => self.side.world_from_cam[patch.view],
            LightKind::Camera => UnitQuaternion::identity(),
        }
    }

    fn groups(&self) -> Vec<Group<'a>> {
        let num_groups = match self.kind {
            LightKind::World => 1,
            LightKind::Camera => self.side.views.len(),
        };
        let num_spheres = self.side.paint.len();
        (0..num_groups)
            .map(|group| {
                let mut patches: Vec<Vec<&Patch>> = vec![Vec::new(); num_spheres];
                for patch in &self.side.patches {
                    if self.kind == LightKind::World || patch.view == group {
                        patches[patch.sphere].push(patch);
                    }
                }
                let own = patches.iter().map(|list| self.own_light(list));
                Group {
                    own: own.collect(),
                    patches,
                }
            })
            .collect()
    }

    fn own_light(&self, patches: &[&Patch]) -> Option<Lighting> {
        let mut pool = Pool::default();
        for patch in patches {
            let share = MAX_SAMPLES / patches.len();
            let (rotation, gain) = (self.rotation(patch), &self.gains[patch.view]);
            pool.add(&patch.samples.readings, &rotation, gain, share);
        }
        Some(pool.fit("a sphere").ok()?.lighting())
    }

    /// Cells of normals that a sphere shows.
    fn shown(&self, patches: &[&Patch]) -> Vec<bool> {
        let mut shown = vec![false; NUM_CELLS];
        for patch in patches {
            let rotation = self.rotation(patch);
            for reading in &patch.samples.readings {
                shown[cell_of(&(rotation * reading.normal))] = true;
            }
        }
        shown
    }

    /// Sphere `k` under the light of sphere `by`; `None` where they share no normals.
    fn compare(&self, groups: &[Group], k: usize, by: usize) -> Option<Comparison> {
        let num_channels = self.side.num_channels();
        let mut common: Vec<Common> = Vec::new();
        let mut angles = Vec::new();
        for group in groups {
            let (Some(own), Some(other)) = (&group.own[k], &group.own[by]) else {
                continue;
            };
            let shown = self.shown(&group.patches[by]);
            for patch in &group.patches[k] {
                common.extend(self.common(patch, &shown, own, other));
            }
            if let (Some(a), Some(b)) = (dominant_direction(own), dominant_direction(other)) {
                angles.push(a.angle(&b).to_degrees());
            }
        }
        if common.len() < MIN_COMMON {
            return None;
        }
        let ratio: Vec<f64> = (0..num_channels)
            .map(|channel| {
                let usable = |c: &&Common| c.reading.usable[channel] && c.other[channel] > 1e-4;
                let ratios = common.iter().filter(usable);
                let ratios = ratios.map(|c| c.reading.values[channel] / c.other[channel]);
                median(&mut ratios.collect::<Vec<_>>()).unwrap_or(1.0)
            })
            .collect();
        let residual = |predicted: &dyn Fn(&Common, usize) -> f64| {
            residual_of(common.iter().flat_map(|c| {
                let usable = (0..num_channels).filter(|&channel| c.reading.usable[channel]);
                usable.map(move |channel| (c.reading.values[channel], predicted(c, channel)))
            }))
        };
        Some(Comparison {
            rms: residual(&|c, channel| ratio[channel] * c.other[channel])?,
            own_rms: residual(&|c, channel| c.own[channel])?,
            direction_deg: median(&mut angles),
            ratio,
        })
    }

    /// A patch's pixels at normals that the other sphere shows.
    fn common(
        &self,
        patch: &Patch,
        shown: &[bool],
        own: &Lighting,
        other: &Lighting,
    ) -> Vec<Common> {
        let (rotation, gain) = (self.rotation(patch), &self.gains[patch.view]);
        let under = |light: &Lighting, normal: &Vector3<f64>| -> Vec<f64> {
            light.channels.iter().map(|l| l.evaluate(normal)).collect()
        };
        let readings = patch.samples.readings.iter();
        let turned = readings.map(|reading| reading.turned(&rotation, gain));
        let common = turned.filter(|reading| shown[cell_of(&reading.normal)]);
        common
            .map(|reading| Common {
                own: under(own, &reading.normal),
                other: under(other, &reading.normal),
                reading,
            })
            .collect()
    }
}

/// A pixel at a normal that two spheres show.
struct Common {
    reading: Reading,
    /// Its channels under the sphere's own light.
    own: Vec<f64>,
    /// The same under the other's.
    other: Vec<f64>,
}
