//! Options of stage 6.

use rilievo_scene::{OptionError, RetiredKey, check_ranges};
use serde::{Deserialize, Serialize};

/// What the points' colours show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ColorMode {
    /// The mean of the photos that see the point, light and shadow included.
    #[default]
    Photographed,
    /// The surface's own colour: the albedo of stage 5, or where it made none the photos divided by
    /// the shading that the result explains; falls back to the photos without either.
    Albedo,
}

/// Files in which the mesh is kept besides PLY.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MeshFormat {
    /// Stanford's PLY, which the program itself reads: always there.
    Ply,
    /// Wavefront OBJ.
    Obj,
    /// Binary glTF.
    Glb,
    /// A light mesh with textures ([`rilievo_scene::Asset`]), as binary glTF and as OBJ.
    Asset,
}

/// Keys that the table `[fusion]` had once, with what to do instead: see
/// [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[
    fixed(&["depth_tolerance_px"], "it is fixed at 4 pixel footprints"),
    fixed(&["normal_tolerance_deg"], "it is fixed at 40 degrees"),
    fixed(&["max_grazing_deg"], "it is fixed at 82 degrees"),
    fixed(&["border_px"], "it is fixed at 1 pixel"),
    fixed(&["truncation_voxels"], "it is fixed at 4 cells"),
    fixed(&["reconcile"], UNCORRECTED),
    fixed(&["reconcile_grid_px"], UNCORRECTED),
    fixed(&["reconcile_sigma_px"], UNCORRECTED),
    fixed(&["reconcile_max_offset_px"], UNCORRECTED),
];

const UNCORRECTED: &str =
    "maps are fused as they are: correcting smooth offsets between them brought no accuracy";

const fn fixed(path: &'static [&'static str], instead: &'static str) -> RetiredKey {
    RetiredKey { path, instead }
}

/// Options of [`crate::run`]. Lengths along and across the surface are in *pixel footprints*
/// `z / f`, the size of a pixel on a surface at depth `z` that faces the camera, so that they need
/// no knowledge of the object's size.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FusionOptions {
    /// Views that must agree on a point, its own included; 1 keeps everything. With fewer views
    /// than this all must.
    pub min_num_views: usize,
    /// Distance between the points of the cloud, world's unit; 0 keeps about a point per squared
    /// pixel footprint of the views that see the surface best, fewer where the maps hold no relief
    /// as fine as two pixels.
    pub spacing: f64,
    /// Whether to make a mesh.
    pub mesh: bool,
    /// Edge of the mesh's cells, pixel footprints. Smaller keeps more of the maps' detail and
    /// costs memory with its square.
    pub voxel_px: f64,
    /// Triangles that about are left of the mesh, more where its pieces and holes need them;
    /// vertices keep their normals. 0 does not bound them.
    pub max_num_triangles: usize,
    /// Whether the mesh has all triangles of its cells, and cells and points are as fine as `voxel_px`
    /// and the pixels also where the maps hold no such relief; else flat places are coarser, within
    /// .1 pixel footprints.
    pub full: bool,
    /// Whether the mesh is closed where no view saw anything.
    pub watertight: bool,
    /// What the colours show.
    pub color: ColorMode,
    /// Formats in which the caller keeps the mesh.
    pub formats: Vec<MeshFormat>,
    /// Triangles that about are left of the asset's mesh.
    pub asset_faces: usize,
    /// Largest side of the asset's textures, texels; the power of two below it. They are smaller
    /// where the views resolve no more.
    pub asset_texture: usize,
    /// Memory that fusion may take, MiB; the mesh's cells are made larger where it would need more,
    /// and the report says so. Less than one view needs to be loaded is an error. `--memory` sets
    /// it.
    pub memory_mib: usize,
}

impl Default for FusionOptions {
    fn default() -> Self {
        Self {
            min_num_views: 2,
            spacing: 0.0,
            mesh: true,
            voxel_px: 1.0,
            max_num_triangles: 0,
            full: false,
            watertight: false,
            color: ColorMode::Photographed,
            formats: vec![MeshFormat::Ply, MeshFormat::Asset],
            asset_faces: 100_000,
            asset_texture: 4096,
            memory_mib: 4096,
        }
    }
}

impl FusionOptions {
    /// Least memory that can be asked for, MiB.
    pub const MIN_MEMORY_MIB: usize = 16;

    /// Whether an asset is made.
    pub fn makes_asset(&self) -> bool {
        self.mesh && self.formats.contains(&MeshFormat::Asset)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        check_ranges!(
            self;
            min_num_views in 1..=255,
            spacing in 0.0..=1e6,
            voxel_px in 0.01..=1e4,
            max_num_triangles in 0..=u32::MAX as usize,
            asset_faces in 100..=10_000_000,
            asset_texture in 64..=16_384,
            memory_mib in Self::MIN_MEMORY_MIB..=1 << 24,
        )
    }
}
