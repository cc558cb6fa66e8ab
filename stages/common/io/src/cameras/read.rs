//! Reading and checking camera files.

use super::entry::{CameraEntry, CameraFile};
use super::lens::LensModel;
use crate::colmap;
use crate::error::IoError;
use crate::json::{self, Node};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use rilievo_scene::{Distortion, Intrinsics, RigidTransform, Unit};
use std::collections::HashSet;
use std::path::Path;

/// How far `RᵀR` may be from the identity: rotations written with four digits pass and are made
/// orthonormal, anything scaled, sheared or transposed row by row does not.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// Skew over focal length beyond which `K` is of no camera of ours; matrices of 32 bits leave 1e-7.
const MAX_SKEW: f64 = 1e-6;

/// Reads `cameras.json`, a `camera.json` of one view, or a COLMAP model folder (text or binary).
///
/// # Errors
/// When a file cannot be read or holds a value that cannot be a camera; names the key.
pub fn read_cameras(path: &Path) -> Result<CameraFile, IoError> {
    if path.is_dir() {
        return colmap::read_model(path).and_then(|model| model.to_camera_file(path));
    }
    let value = json::read(path)?;
    let root = Node::root(path, &value);
    let object = root.object()?;
    let is_single = ["K", "width", "height"]
        .iter()
        .any(|&key| object.contains_key(key));
    let mut file = CameraFile {
        unit: unit(&root)?,
        ..CameraFile::default()
    };
    if is_single && root.opt("cameras")?.is_none() {
        file.cameras.push(camera(&root)?);
        return Ok(file);
    }

    let mut names = HashSet::new();
    for node in root.get("cameras")?.array()? {
        let entry = camera(&node)?;
        let name = node.get("image")?;
        if !names.insert(name.text()?) {
            return Err(name.refuse("appears twice"));
        }
        file.cameras.push(entry);
    }
    for node in root.list("unregistered")? {
        let reason = node.opt_as("reason", Node::text)?.unwrap_or_default();
        let image = node.get("image")?.text()?;
        file.unregistered
            .push((image.to_owned(), reason.to_owned()));
    }
    file.extra = object
        .iter()
        .filter(|(key, _)| !matches!(key.as_str(), "unit" | "cameras" | "unregistered"))
        .map(|(key, value)| (key.clone(), value.clone()))
        .collect();
    Ok(file)
}

/// The unit of a file; absent is arbitrary.
pub(crate) fn unit(root: &Node<'_>) -> Result<Unit, IoError> {
    let Some(node) = root.opt("unit")? else {
        return Ok(Unit::Arbitrary);
    };
    Unit::of_name(node.text()?).ok_or_else(|| {
        let known = Unit::ALL.map(|unit| format!("\"{}\"", unit.name()));
        node.refuse(format!("is not a unit; say one of {}", known.join(", ")))
    })
}

fn camera(node: &Node<'_>) -> Result<CameraEntry, IoError> {
    let image = node.opt_as("image", |name| name.text().map(str::to_owned))?;
    let k = node.get("K")?;
    let size = (node.get("width")?.count()?, node.get("height")?.count()?);
    let intrinsics = Intrinsics {
        distortion: distortion(node)?,
        ..intrinsics_of(&k.matrix()?, size).map_err(|reason| k.refuse(reason))?
    };
    intrinsics
        .check_lens()
        .map_err(|reason| node.refuse(format!("has a lens that cannot be used: {reason}")))?;
    let rotation = node.opt("world_from_camera_rotation")?;
    let center = node.opt("camera_center")?;
    let cam_from_world = match (rotation, center) {
        (Some(rotation), Some(center)) => {
            let pose = rigid_from_world_pose(&rotation.matrix()?, center.numbers()?);
            Some(pose.map_err(|reason| rotation.refuse(reason))?)
        }
        (None, None) => None,
        (Some(node), None) => return Err(node.refuse("stands without \"camera_center\"")),
        (None, Some(node)) => {
            return Err(node.refuse("stands without \"world_from_camera_rotation\""));
        }
    };
    Ok(CameraEntry {
        image,
        intrinsics,
        cam_from_world,
    })
}

/// The camera of a matrix `K`, without distortion; the reason where it is none.
pub(crate) fn intrinsics_of(k: &Matrix3<f64>, size: (usize, usize)) -> Result<Intrinsics, String> {
    let (fx, fy) = (k[(0, 0)], k[(1, 1)]);
    // Written so that NaN is refused too.
    if !(fx > 0.0 && fy > 0.0) {
        return Err(format!(
            "has a focal length that is not greater than zero, {fx} or {fy} (axes are x right, y \
             down, z forward: nothing is mirrored in K)"
        ));
    }
    let skew = k[(0, 1)];
    if skew.abs() > MAX_SKEW * fx {
        return Err(format!("has the skew {skew}, which no photo's pixels have"));
    }
    if [k[(1, 0)], k[(2, 0)], k[(2, 1)], k[(2, 2)]] != [0.0, 0.0, 0.0, 1.0] {
        return Err("is not of the form [[fx,0,cx],[0,fy,cy],[0,0,1]]".to_owned());
    }
    Ok(Intrinsics::undistorted(
        size,
        [fx, fy, k[(0, 2)], k[(1, 2)]],
    ))
}

/// The matrix `K` of a camera.
pub(crate) fn matrix_of(camera: &Intrinsics) -> Matrix3<f64> {
    let Intrinsics { fx, fy, cx, cy, .. } = *camera;
    Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
}

fn distortion(node: &Node<'_>) -> Result<Distortion, IoError> {
    let Some(node) = node.opt("distortion")? else {
        return Ok(Distortion::default());
    };
    let mut lens = LensModel::OpenCv;
    if let Some(model) = node.opt("model")? {
        let name = model.text()?;
        if name == "none" {
            return Ok(Distortion::default());
        }
        let known = LensModel::ALL.into_iter().find(|lens| lens.name() == name);
        lens = known.ok_or_else(|| {
            let names = LensModel::ALL.map(|lens| format!("\"{}\"", lens.name()));
            let reason = format!("is not a known model; say {} or \"none\"", names.join(", "));
            model.refuse(reason)
        })?;
    }
    let mut values = Vec::new();
    for coefficient in node.get("coefficients")?.array()? {
        let number = coefficient.number()?;
        if values.len() < lens.num_coefficients() {
            values.push(number);
        } else if number != 0.0 {
            return Err(coefficient.refuse(format!(
                "is beyond the {} coefficients that {} has",
                lens.num_coefficients(),
                lens.name()
            )));
        }
    }
    Ok(lens.distortion(&values))
}

/// [`rigid_from_world_pose`] of a camera that is given by `x_cam = R x_world + t`.
pub(crate) fn rigid_from_camera_pose(
    rotation: &Matrix3<f64>,
    translation: &Vector3<f64>,
) -> Result<RigidTransform, String> {
    let world_from_camera = rotation.transpose();
    let center = -(world_from_camera * translation);
    rigid_from_world_pose(&world_from_camera, center.into())
}

/// `cam_from_world` of a rotation matrix and a centre in the world; the reason where the matrix is
/// no rotation.
pub(crate) fn rigid_from_world_pose(
    world_from_camera: &Matrix3<f64>,
    center: [f64; 3],
) -> Result<RigidTransform, String> {
    let defect = (world_from_camera.transpose() * world_from_camera - Matrix3::identity()).amax();
    if defect.is_nan() || defect > ORTHONORMAL_TOLERANCE {
        return Err(format!(
            "is not a rotation: its rows are not orthonormal (off by {defect:.2e})"
        ));
    }
    if world_from_camera.determinant() < 0.0 {
        return Err(
            "has mirrored axes (determinant -1); the camera's axes are x right, y down, z forward"
                .to_owned(),
        );
    }
    // The nearest rotation, in the sense of the Frobenius norm.
    let svd = world_from_camera.svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) if defect > 1e-12 => u * v_t,
        _ => *world_from_camera,
    };
    Ok(RigidTransform::from_world_pose(
        Rotation3::from_matrix_unchecked(rotation),
        Point3::from(center),
    ))
}
