//! A light mesh with textures: `asset.glb`, and a folder with the same as OBJ and single images.
//!
//! | file | holds |
//! |---|---|
//! | `asset.glb` | all of it; metres, y up; textures as 8-bit PNG |
//! | `asset/asset.obj`, `asset.mtl` | the mesh in the frame of `cameras.json`, and what its material takes from where |
//! | `asset/base_color.png`, `.exr` | what the base colour shows: 8-bit sRGB, and linear in floats |
//! | `asset/normal.png` | tangent-space normals, 16 bits, OpenGL convention (green up), tangents by MikkTSpace |
//! | `asset/occlusion.png` | share of a uniform sky that reaches the place, 8 bits |

use super::check::check;
use super::glb::{AssetImages, ViewerFrame, write_asset_glb};
use super::obj::{Textured, write_obj};
use crate::error::IoError;
use crate::exr_maps::write_linear_half;
use crate::files::{read_regular, write_pieces};
use crate::mask::encode_png;
use image::ExtendedColorType;
use rilievo_scene::{Asset, LinearImage, Mesh, WorldCoordinates, srgb};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Names of an asset's files, from the folder on that holds them.
pub const ASSET_FILES: [&str; 7] = [
    "asset.glb",
    "asset/asset.obj",
    "asset/asset.mtl",
    "asset/base_color.png",
    "asset/base_color.exr",
    "asset/normal.png",
    "asset/occlusion.png",
];

/// Writes an asset to the paths of its files' names ([`ASSET_FILES`]).
///
/// # Errors
/// When a file cannot be written, or the asset is inconsistent.
pub fn write_asset<E: From<IoError>>(
    asset: &Asset,
    world: WorldCoordinates,
    frame: &ViewerFrame,
    path: &dyn Fn(&str) -> Result<PathBuf, E>,
) -> Result<(), E> {
    let glb = path("asset.glb")?;
    check_asset(&glb, asset)?;
    let images = images(&glb, asset)?;
    write_asset_glb(&glb, asset, &images, world, frame)?;
    let textured = Textured {
        material: ("asset.mtl", "matte"),
        coords: &asset.texture_coords,
    };
    write_obj(
        &path("asset/asset.obj")?,
        &asset.mesh,
        Some(textured),
        world,
    )?;
    let write = |name: &str, bytes: &[u8]| -> Result<(), E> {
        Ok(write_pieces(&path(name)?, |out| out.write_all(bytes))?)
    };
    let material = format!("# Base colour: {}.\n{MATERIAL}", asset.shows.sentence());
    write("asset/asset.mtl", material.as_bytes())?;
    write("asset/base_color.png", &images.base_color)?;
    let size = (asset.normal.width, asset.normal.height);
    let deep = asset.normal.data.iter().flatten();
    let deep: Vec<u8> = deep.flat_map(|v| v.to_ne_bytes()).collect();
    let normal = png(&glb, &deep, size, ExtendedColorType::Rgb16)?;
    write("asset/normal.png", &normal)?;
    let occlusion = png(&glb, &asset.occlusion.data, size, ExtendedColorType::L8)?;
    write("asset/occlusion.png", &occlusion)?;
    let colors = asset.base_color.data.iter().flatten();
    let linear = LinearImage {
        width: size.0,
        height: size.1,
        channels: 3,
        data: colors.map(|&v| share(v)).collect(),
    };
    Ok(write_linear_half(&path("asset/base_color.exr")?, &linear)?)
}

/// An asset's mesh, without its textures, in the world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AssetMesh {
    /// Without colours.
    pub mesh: Mesh,
    /// As of [`Asset`].
    pub texture_coords: Vec<[f32; 2]>,
    /// As of [`Asset`].
    pub tangents: Vec<[f32; 4]>,
}

/// Reads the mesh of an `asset.glb` that was written in a frame.
///
/// # Errors
/// When the file cannot be read, or is no such asset.
pub fn read_asset_mesh(path: &Path, frame: &ViewerFrame) -> Result<AssetMesh, IoError> {
    let bytes = read_regular(path)?;
    let other =
        |reason: &str| IoError::input(path, format!("is no asset of this program: {reason}"));
    let gltf::Gltf { document, blob } =
        gltf::Gltf::from_slice(&bytes).map_err(|error| other(&error.to_string()))?;
    let mesh = document.meshes().next();
    let primitive = mesh.and_then(|mesh| mesh.primitives().next());
    let primitive = primitive.ok_or_else(|| other("it has no mesh"))?;
    let reader = primitive.reader(|_| blob.as_deref());
    let parts = || {
        let back = |v: [f32; 3]| frame.turn_back(v);
        let indices: Vec<u32> = reader.read_indices()?.into_u32().collect();
        Some(AssetMesh {
            mesh: Mesh {
                vertices: reader.read_positions()?.map(back).collect(),
                normals: reader.read_normals()?.map(back).collect(),
                colors: Vec::new(),
                triangles: indices.as_chunks::<3>().0.to_vec(),
            },
            texture_coords: reader.read_tex_coords(0)?.into_f32().collect(),
            tangents: (reader.read_tangents()?)
                .map(|[x, y, z, sign]| {
                    let [x, y, z] = back([x, y, z]);
                    [x, y, z, sign]
                })
                .collect(),
        })
    };
    let found = parts().ok_or_else(|| other("its vertices lack something"))?;
    check(path, &found.mesh)?;
    let num = found.mesh.vertices.len();
    match found.texture_coords.len() == num && found.tangents.len() == num {
        true => Ok(found),
        false => Err(other("its vertices lack something")),
    }
}

/// What an OBJ's reader finds of the material. The format has no name for normal maps: some readers
/// take `norm`, Blender `map_Bump`.
const MATERIAL: &str = "\
# Normal map: tangent space, OpenGL convention (green up), tangents by MikkTSpace.
newmtl matte
Ka 0 0 0
Kd 1 1 1
Ks 0 0 0
Pr 1
Pm 0
illum 1
map_Kd base_color.png
norm normal.png
map_Bump normal.png
map_Ka occlusion.png
";

fn share(value: u16) -> f32 {
    f32::from(value) / f32::from(u16::MAX)
}

fn check_asset(path: &Path, asset: &Asset) -> Result<(), IoError> {
    check(path, &asset.mesh)?;
    let num = asset.mesh.vertices.len();
    let lengths = [
        ("normals", asset.mesh.normals.len()),
        ("texture coordinates", asset.texture_coords.len()),
        ("tangents", asset.tangents.len()),
    ];
    for (what, len) in lengths {
        if len != num {
            return Err(IoError::write(
                path,
                format!("{len} {what} for {num} vertices"),
            ));
        }
    }
    let same =
        asset.base_color.same_size(&asset.normal) && asset.base_color.same_size(&asset.occlusion);
    match same {
        true => Ok(()),
        false => Err(IoError::write(path, "the textures are of different sizes")),
    }
}

fn images(path: &Path, asset: &Asset) -> Result<AssetImages, IoError> {
    let size = (asset.normal.width, asset.normal.height);
    let rgb = |bytes: Vec<u8>| png(path, &bytes, size, ExtendedColorType::Rgb8);
    let colors = asset.base_color.data.iter().flatten();
    let normals = asset.normal.data.iter().flatten();
    // 8-bit viewers take 128 for zero.
    let byte = |v: &u16| (f32::from(*v) * 255.0 / f32::from(u16::MAX)).round() as u8;
    let occlusion = asset.occlusion.data.iter();
    Ok(AssetImages {
        base_color: rgb(colors.map(|&v| srgb::encode_byte(share(v))).collect())?,
        normal: rgb(normals.map(byte).collect())?,
        occlusion: rgb(occlusion.flat_map(|&open| [open, 255, 0]).collect())?,
    })
}

fn png(
    path: &Path,
    bytes: &[u8],
    (width, height): (usize, usize),
    color: ExtendedColorType,
) -> Result<Vec<u8>, IoError> {
    encode_png(bytes, width, height, color).map_err(|reason| IoError::write(path, reason))
}
