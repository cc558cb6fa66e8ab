//! Image, OpenEXR, PLY, COLMAP and JSON formats: everything that crosses the disk.
//!
//! Every reader returns an [`IoError`] that names the file, the key and the value that it refuses,
//! and what to try; no content makes one panic. Every writer writes the whole file to the path it
//! is given and syncs nothing: committing is the caller's. Its error is the system's, where no
//! other is documented.
//!
//! | content | functions |
//! |---|---|
//! | photos (JPEG, PNG, TIFF, OpenEXR, camera RAW) with EXIF | [`decode_photo`], [`set_raw_decoder`] |
//! | masks and their names | [`read_mask`], [`write_mask`], [`mask_names`] |
//! | depth, normals, confidence, linear images as OpenEXR | [`exr_maps`] |
//! | cameras: `cameras.json`, `camera.json`, COLMAP | [`read_cameras`], [`write_cameras`], [`colmap`] |
//! | cameras of other programs | [`adapters`] |
//! | the data sets DiLiGenT and DiLiGenT-MV, MATLAB's arrays | [`read_diligent`], [`read_mat`] |
//! | the reference spheres | [`read_sphere_file`] |
//! | lighting | [`read_lighting`], [`write_lighting`] |
//! | lighting as `.lp` | [`light_file`] |
//! | scenes for shading alone | [`read_scene`], [`read_matches_csv`] |
//! | point clouds and meshes as PLY | [`ply`] |
//! | meshes as OBJ and GLB | [`mesh`] |
//! | depth and normal maps of COLMAP and OpenMVS | [`dense`] |
//! | pictures for people | [`write_preview_png`] |
//! | any regular file, and no other | [`open_regular`], [`read_regular`], [`read_regular_text`] |
//!
//! # Conventions
//! Files follow the conventions of [`rilievo_scene`] (pixel centres at integers, camera x right,
//! y down, z forward, depth along the axis); a format with others is converted here, both ways.

pub mod adapters;
mod bytes;
pub mod cameras;
mod claims;
pub mod colmap;
pub mod dense;
pub mod diligent;
pub mod dng_writer;
pub mod error;
pub mod exr_maps;
pub mod files;
mod json;
pub mod light_export;
pub mod lighting_file;
pub mod mask;
pub mod mask_names;
mod mask_values;
pub mod mat;
pub mod mesh;
mod names;
pub mod photo;
pub mod photo_writer;
pub mod ply;
pub mod preview;
pub mod scene_file;
pub mod sphere_file;
mod words;
mod xml;

pub use adapters::{CameraFormat, blender_file, camera_files, export_cameras, import_cameras};
pub use cameras::{
    CameraEntry, CameraFile, CameraIndex, cameras_file, read_cameras, write_cameras,
};
pub use colmap::write_colmap_text;
pub use dense::{DmapFile, read_colmap_depth, read_colmap_normal, read_dmap};
pub use diligent::{
    DiligentObject, DiligentPhoto, DiligentView, is_diligent, read_diligent, read_diligent_photo,
};
pub use dng_writer::write_photo_dng;
pub use error::{IoError, IoErrorKind};
pub use exr_maps::{
    LinearFile, linear_file, normal_file, read_channel, read_depth, read_linear, read_normal,
    write_channel, write_depth, write_linear, write_linear_half, write_normal,
};
pub use files::{OutputFile, open_regular, read_regular, read_regular_text};
pub use light_export::{light_file, lp_file};
pub use lighting_file::{LightingFile, read_lighting, split_lighting_spec, write_lighting};
pub use mask::{mask_file, read_mask, write_mask};
pub use mask_names::{MaskNames, masks_among};
pub use mat::{MatArray, read_mat};
pub use mesh::{
    ASSET_FILES, AssetMesh, ViewerFrame, read_asset_mesh, write_asset, write_mesh_glb,
    write_mesh_obj,
};
pub use photo::{
    RawDecoder, decode_photo, decode_photo_bytes, decode_raw_here, decoder_is_guarded,
    is_photo_name, photo_size, set_raw_decoder,
};
pub use photo_writer::{write_photo_deep, write_photo_jpeg};
pub use ply::{
    CloudPlyWriter, mesh_ply_file, read_cloud_ply, read_mesh_ply, read_mesh_ply_near,
    write_cloud_ply, write_mesh_ply,
};
pub use preview::{Preview, encode_preview_jpeg, picture_as_jpeg, write_preview_png};
pub use scene_file::{
    SceneFile, SceneMatches, SceneView, read_matches_csv, read_scene, write_matches_csv,
};
pub use sphere_file::{
    MAX_NUM_SPHERES, SPHERE_RADII, SphereFile, SphereFileCalibration, SphereFileEntry,
    SpheresInSet, is_mark_of, read_sphere_file,
};
