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
use crate::bytes::Bytes;
use crate::cameras::{intrinsics_of, last_part, rigid_from_world_pose};
use crate::error::IoError;
use crate::files::read_regular;
use nalgebra::Matrix3;
use rilievo_scene::{DepthMap, Intrinsics, NormalMap, Raster, RigidTransform};
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

/// Reads a file.
///
/// # Errors
/// When it cannot be read, is damaged, or of the newer, quantised kind.
pub fn read_dmap(path: &Path) -> Result<DmapFile, IoError> {
    let content = read_regular(path)?;
    let mut bytes = Bytes::new(path, &content);
    let refuse = |reason: &str| IoError::input(path, reason);
    match &bytes.take()? {
        b"DR" => {}
        b"D2" => {
            return Err(refuse("is quantised depth data (D2)").with_hint("write it as floats (DR)"));
        }
        _ => {
            return Err(refuse(
                "is no OpenMVS depth data: it does not begin with DR",
            ));
        }
    }
    let [content_bits, _] = bytes.take()?;
    if content_bits & 1 == 0 {
        return Err(refuse("holds no depth"));
    }
    let mut size = || Ok((bytes.u32()? as usize, bytes.u32()? as usize));
    let (image_width, image_height) = size()?;
    let (width, height) = size()?;
    bytes.take::<8>()?;
    let num = num_pixels(path, width, height)?;
    num_pixels(path, image_width, image_height)?;
    let length = bytes.u16()?.into();
    let name = String::from_utf8_lossy(bytes.piece(length)?).into_owned();
    let num_ids = bytes.u32()? as usize;
    bytes.piece(num_ids.saturating_mul(4))?;
    let k = Matrix3::from_row_slice(&bytes.numbers::<9>()?);
    let r = Matrix3::from_row_slice(&bytes.numbers::<9>()?);
    let center = bytes.numbers()?;
    let camera = intrinsics_of(&k, (image_width, image_height))
        .map_err(|reason| refuse(&format!("K {reason}")))?;
    let pose = rigid_from_world_pose(&r.transpose(), center)
        .map_err(|reason| refuse(&format!("the camera's rotation {reason}")))?;
    let depth = Raster {
        width,
        height,
        data: floats(bytes.piece(4 * num)?).collect(),
    };
    let mut normal = None;
    if content_bits & 2 != 0 {
        let values: Vec<f32> = floats(bytes.piece(12 * num)?).collect();
        normal = Some(Raster {
            width,
            height,
            data: values.as_chunks().0.to_vec(),
        });
    }
    // The image's pixels are averaged in blocks, whose centres lie between the pixels' centres.
    let (sx, sy) = (
        width as f64 / image_width as f64,
        height as f64 / image_height as f64,
    );
    Ok(DmapFile {
        image: last_part(&name).to_owned(),
        intrinsics: Intrinsics {
            width,
            height,
            fx: camera.fx * sx,
            fy: camera.fy * sy,
            cx: (camera.cx + 0.5) * sx - 0.5,
            cy: (camera.cy + 0.5) * sy - 0.5,
            ..camera
        },
        cam_from_world: pose,
        depth,
        normal,
    })
}
