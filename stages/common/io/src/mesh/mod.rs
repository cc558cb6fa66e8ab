//! Meshes for other programs: Wavefront OBJ, binary glTF (GLB) and assets; PLY: [`crate::ply`].
//!
//! | format | frame | unit | colours |
//! |---|---|---|---|
//! | OBJ | that of `cameras.json` | that of `cameras.json`, in a comment | after the position, 0 to 1, sRGB |
//! | GLB | y up, front towards z ([`ViewerFrame`]) | metres; unknown units are named in `asset.extras` | `COLOR_0`, linear |

mod asset;
pub(crate) mod check;
mod glb;
mod obj;

pub use asset::{ASSET_FILES, AssetMesh, read_asset_mesh, write_asset};
pub use glb::{ViewerFrame, write_mesh_glb};
pub use obj::write_mesh_obj;

#[cfg(test)]
mod tests;
