//! The frame of an earlier result, or of other cameras, where the cameras in common agree.
//!
//! # Equations
//! `x_ref = s R x + t`: `R` is the rotation nearest to the mean of `R_refᵢᵀ Rᵢ` over the cameras in common, `s` the
//! ratio of their centres' spreads (1 between metric worlds), `t` takes the mean centre to the other. Cameras that
//! differ most (a photo that was replaced) are left out one by one, as long as most remain.

use crate::level::move_world;
use crate::options::ReferenceFrame;
use crate::report::PosesReport;
use crate::scale::multiply;
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rilievo_scene::{PosedViews, RigidTransform, Scale, ScaleSource, Unit};

/// Differences up to which cameras agree, degrees and share of the centres' spread: a photo more bends an arc of others
/// by less; wrong poses differ by more.
const MAX_TURN_DEG: f64 = 2.0;
const MAX_SHIFT: f64 = 0.05;
/// Shift relative to the spread below which the worlds are the same but for rounding.
const SAME_WORLD: f64 = 1e-9;

/// A camera's pose in both worlds.
struct Common {
    reference: RigidTransform,
    own: RigidTransform,
}

/// The rotation nearest to a sum of rotations; `None` where they cancel each other.
fn nearest_rotation(sum: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = sum.svd(true, true);
    let (mut u, v_t) = (svd.u?, svd.v_t?);
    if (u * v_t).determinant() < 0.0 {
        u.column_mut(2).neg_mut();
    }
    let rotation = Rotation3::from_matrix_unchecked(u * v_t);
    let is_determined = svd.singular_values[1] > f64::EPSILON * svd.singular_values[0];
    is_determined.then(|| UnitQuaternion::from_rotation_matrix(&rotation))
}

/// How one world lies in the other.
struct Alignment {
    scale: f64,
    ref_from_own: RigidTransform,
    /// Spread of the centres in the reference.
    spread: f64,
}

impl Alignment {
    /// Of two cameras or more at different places.
    fn of(common: &[&Common], is_scaled: bool) -> Option<Self> {
        let num = common.len() as f64;
        let mut turns = Matrix3::zeros();
        let [mut middle_ref, mut middle_own] = [Vector3::zeros(); 2];
        for c in common {
            turns += (c.reference.rotation.inverse() * c.own.rotation)
                .to_rotation_matrix()
                .matrix();
            middle_ref += c.reference.center_in_source().coords / num;
            middle_own += c.own.center_in_source().coords / num;
        }
        let spread = |of: fn(&Common) -> &RigidTransform, middle: &Vector3<f64>| {
            let squares = common.iter();
            let squares =
                squares.map(|c| (of(c).center_in_source().coords - middle).norm_squared());
            (squares.sum::<f64>() / num).sqrt()
        };
        let spread_ref = spread(|c| &c.reference, &middle_ref);
        let spread_own = spread(|c| &c.own, &middle_own);
        if spread_ref <= 0.0 || spread_own <= 0.0 {
            return None;
        }
        let scale = if is_scaled {
            spread_ref / spread_own
        } else {
            1.0
        };
        let rotation = nearest_rotation(&turns)?;
        Some(Self {
            scale,
            ref_from_own: RigidTransform {
                rotation,
                translation: middle_ref - rotation * middle_own * scale,
            },
            spread: spread_ref,
        })
    }

    /// A camera's turn, degrees, and its shift as a share of the spread.
    fn difference(&self, c: &Common) -> (f64, f64) {
        let turned = c.reference.rotation * self.ref_from_own.rotation;
        let own = Point3::from(c.own.center_in_source().coords * self.scale);
        let shift = (c.reference.center_in_source() - self.ref_from_own.apply(&own)).norm();
        (
            turned.angle_to(&c.own.rotation).to_degrees(),
            shift / self.spread,
        )
    }
}

/// Puts the result into the reference's world; what to say of it, if anything.
pub(crate) fn apply(
    reference: &ReferenceFrame,
    knows_object: bool,
    posed: &mut PosedViews,
    report: &mut PosesReport,
) -> Option<String> {
    let whose = match reference.is_asked {
        true => "of --frame-of",
        false => "of the result before",
    };
    let not_taken = |why: &str| Some(format!("the frame {whose} is not taken over: {why}"));
    // Where the object stands was not known then.
    if !reference.is_asked && knows_object && !reference.knows_object {
        return None;
    }
    let is_scaled = posed.scale.source == ScaleSource::Gauge;
    if !is_scaled && reference.world.unit != posed.scale.unit {
        return not_taken("its lengths have another unit");
    }
    let common: Vec<Common> = posed
        .views
        .iter()
        .filter_map(|view| {
            let same = reference
                .cameras
                .iter()
                .find(|(name, _)| *name == view.file_name)?;
            Some(Common {
                reference: same.1,
                own: view.cam_from_world,
            })
        })
        .collect();
    if !reference.is_asked && common.len() < 2 {
        return None;
    }
    let mut kept: Vec<&Common> = common.iter().collect();
    let found = loop {
        if kept.len() < 2 || 2 * kept.len() <= common.len() {
            break None;
        }
        let Some(alignment) = Alignment::of(&kept, is_scaled) else {
            break None;
        };
        let excess = |c: &Common| {
            let (turn, shift) = alignment.difference(c);
            (turn / MAX_TURN_DEG).max(shift / MAX_SHIFT)
        };
        let worst = (0..kept.len()).max_by(|&a, &b| excess(kept[a]).total_cmp(&excess(kept[b])))?;
        if excess(kept[worst]) <= 1.0 {
            break Some(alignment);
        }
        kept.remove(worst);
    };
    let Some(alignment) = found else {
        return not_taken(&format!(
            "of {} photos in common fewer than two, or not most of them, agree on it",
            common.len()
        ));
    };
    let num = kept.len();
    let shift = kept
        .iter()
        .map(|c| alignment.difference(c).1)
        .fold(0.0, f64::max);
    posed.frame = reference.world.frame;
    posed.offset = reference.world.offset;
    report.offset = posed.coordinates().offset();
    report.num_frame_cameras = Some(num);
    let identity = Alignment {
        scale: 1.0,
        ref_from_own: RigidTransform::identity(),
        spread: alignment.spread,
    };
    if kept.iter().all(|c| identity.difference(c).1 < SAME_WORLD) {
        return None;
    }
    if is_scaled {
        multiply(posed, report, alignment.scale);
        posed.offset = reference.world.offset;
    }
    // A size that the user no longer states is not kept.
    if is_scaled && reference.is_asked && reference.world.unit == Unit::Metre {
        posed.scale = Scale {
            unit: Unit::Metre,
            source: ScaleSource::GivenPoses,
            relative_sigma: None,
        };
        report.scale = posed.scale;
    }
    move_world(&alignment.ref_from_own, posed, report.vertical.as_mut());
    Some(format!(
        "the frame {whose} is kept: {num} cameras in common agree on it to {:.2} % of the distances between them",
        100.0 * shift
    ))
}
