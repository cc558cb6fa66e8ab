//! OpenMVS's depth data `*.dmap`, type `DR`: maps with the camera that they belong to.
//!
//! ```text
//! "DR"  u8 content (1 depth, 2 normals, 4 confidence, 8 views)  u8
//! u32 image width, height   u32 map width, height   f32 nearest, farthest depth
//! u16 n, n bytes: image's file name   u32 n, n × u32: image ids
//! f64 K[9], R[9], C[3]      at the image's size; X_cam = R (X − C)
//! f32 depth[]   f32 normal[][3]   …
//! ```
//!
//! Source: OpenMVS, `libs/MVS/Interface.h` and `DepthMap.cpp` (`ExportDepthDataRaw`).

use super::pixels::{floats, num_pixels};
use crate::cameras::rigid_from_world_pose;
use crate::error::IoError;
use crate::files::read_regular;
use nalgebra::Matrix3;
use rilievo_scene::{DepthMap, Distortion, Intrinsics, NormalMap, Raster, RigidTransform};
use std::path::Path;

/// What a file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct DmapFile {
    /// File name of the image, without folders.
    pub image: String,
    /// Camera at the maps' size.
    pub intrinsics: Intrinsics,
    /// Its pose.
    pub cam_from_world: RigidTransform,
    /// Depth along the axis, 0 where there is none.
    pub depth: DepthMap,
    /// Normals, where the file has them.
    pub normal: Option<NormalMap>,
}

struct Bytes<'a> {
    path: &'a Path,
    rest: &'a [u8],
}

impl<'a> Bytes<'a> {
    fn take(&mut self, num: usize) -> Result<&'a [u8], IoError> {
        let (taken, rest) = self
            .rest
            .split_at_checked(num)
            .ok_or_else(|| IoError::input(self.path, "the file ends too early"))?;
        self.rest = rest;
        Ok(taken)
    }

    fn u16(&mut self) -> Result<usize, IoError> {
        let b = self.take(2)?;
        Ok(u16::from_le_bytes([b[0], b[1]]).into())
    }

    fn u32(&mut self) -> Result<usize, IoError> {
        let b = self.take(4)?;
        Ok(u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)
    }

    fn doubles<const N: usize>(&mut self) -> Result<[f64; N], IoError> {
        let bytes = self.take(8 * N)?;
        let mut values = [0.0; N];
        for (value, b) in values.iter_mut().zip(bytes.chunks_exact(8)) {
            *value = f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]);
            if !value.is_finite() {
                let reason = format!("its camera holds {value}, which is no finite number");
                return Err(IoError::input(self.path, reason));
            }
        }
        Ok(values)
    }
}

/// Reads a file.
///
/// # Errors
/// When it cannot be read, is damaged, or of the newer, quantised kind.
pub fn read_dmap(path: &Path) -> Result<DmapFile, IoError> {
    let content = read_regular(path)?;
    let mut bytes = Bytes {
        path,
        rest: &content,
    };
    let refuse = |reason: String| IoError::input(path, reason);
    let kind = bytes.take(2)?;
    if kind != b"DR" {
        let error = match kind {
            b"D2" => refuse("is quantised depth data (D2)".to_owned())
                .with_hint("write it as floats (DR)"),
            _ => refuse("is no OpenMVS depth data: it does not begin with DR".to_owned()),
        };
        return Err(error);
    }
    let content_bits = bytes.take(2)?[0];
    if content_bits & 1 == 0 {
        return Err(refuse("holds no depth".to_owned()));
    }
    let (image_width, image_height) = (bytes.u32()?, bytes.u32()?);
    let (width, height) = (bytes.u32()?, bytes.u32()?);
    bytes.take(8)?;
    let num = num_pixels(path, width, height)?;
    num_pixels(path, image_width, image_height)?;
    let length = bytes.u16()?;
    let name = String::from_utf8_lossy(bytes.take(length)?).into_owned();
    let num_ids = bytes.u32()?;
    bytes.take(num_ids.saturating_mul(4))?;
    let k = bytes.doubles::<9>()?;
    let r = bytes.doubles::<9>()?;
    let c = bytes.doubles::<3>()?;
    if k[0] <= 0.0 || k[4] <= 0.0 || k[1] != 0.0 {
        return Err(refuse(format!(
            "K has the focal lengths {}, {} and skew {}",
            k[0], k[4], k[1]
        )));
    }
    let pose = rigid_from_world_pose(&Matrix3::from_row_slice(&r).transpose(), c)
        .map_err(|reason| refuse(format!("the camera's rotation {reason}")))?;
    let depth = floats(bytes.take(4 * num)?).collect();
    let normal = if content_bits & 2 == 0 {
        None
    } else {
        let values: Vec<f32> = floats(bytes.take(12 * num)?).collect();
        Some(Raster {
            width,
            height,
            data: values.chunks_exact(3).map(|n| [n[0], n[1], n[2]]).collect(),
        })
    };
    // The image's pixels are averaged in blocks, whose centres lie between the pixels' centres.
    let (sx, sy) = (
        width as f64 / image_width as f64,
        height as f64 / image_height as f64,
    );
    Ok(DmapFile {
        image: crate::cameras::last_part(&name).to_owned(),
        intrinsics: Intrinsics {
            width,
            height,
            fx: k[0] * sx,
            fy: k[4] * sy,
            cx: (k[2] + 0.5) * sx - 0.5,
            cy: (k[5] + 0.5) * sy - 0.5,
            distortion: Distortion::default(),
        },
        cam_from_world: pose,
        depth: Raster {
            width,
            height,
            data: depth,
        },
        normal,
    })
}
