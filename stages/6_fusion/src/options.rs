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

/// Keys that the table `[fusion]` had once, with what to do instead: see [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[];

/// Options of [`crate::run`]. Lengths along and across the surface are in *pixel footprints*
/// `z / f`, the size of a pixel on a surface at depth `z` that faces the camera, so that they need
/// no knowledge of the object's size.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FusionOptions {
    /// Two views agree on a point when their depths differ by no more than this many pixel
    /// footprints. Too small: views that lie on each other only to a few footprints lose points;
    /// too large: false surface near edges survives.
    pub depth_tolerance_px: f64,
    /// Two views agree on a point when their normals differ by no more than this angle, degrees.
    pub normal_tolerance_deg: f64,
    /// Views that must agree on a point, itself included; 1 keeps everything. Where the cameras
    /// leave only one view a choice (`num_views` possible observers below this), it is dropped.
    pub min_num_views: usize,
    /// Surface seen under a larger angle than this to its normal is dropped, degrees: there a
    /// pixel covers several footprints and its depth is a guess.
    pub max_grazing_deg: f64,
    /// Pixels next to the border of the map that are dropped: there the depth is extrapolated.
    pub border_px: usize,
    /// Distance between the points of the cloud, world's unit; 0 keeps about a point per squared
    /// pixel footprint of the views that see the surface best.
    pub spacing: f64,
    /// Whether smooth offsets between the views' depth maps are adjusted away before fusion.
    pub reconcile: bool,
    /// Distance of the nodes of the correction grid, pixels. Too small: the correction follows
    /// detail and noise; too large: it cannot bend as the offsets do.
    pub reconcile_grid_px: f64,
    /// Offsets that the correction may take up: their standard deviation, pixel footprints. The
    /// weight of leaving a map as it is against bringing it onto the others.
    pub reconcile_sigma_px: f64,
    /// Largest offset between views that still belongs to one surface while they are adjusted,
    /// pixel footprints.
    pub reconcile_max_offset_px: f64,
    /// Whether to make a mesh.
    pub mesh: bool,
    /// Edge of the mesh's cells, pixel footprints. Smaller keeps more of the maps' detail and
    /// costs memory with its square.
    pub voxel_px: f64,
    /// Distance from the surface over which the views are averaged, cells. Must exceed the
    /// noise of the depths; large values close narrow grooves.
    pub truncation_voxels: f64,
    /// Triangles that about are left of the mesh, more where its pieces and holes need them; vertices keep their normals.
    /// 0 keeps all.
    pub max_num_triangles: usize,
    /// Whether the mesh is closed where no view saw anything.
    pub watertight: bool,
    /// What the colours show.
    pub color: ColorMode,
    /// Formats in which the caller keeps the mesh.
    pub formats: Vec<MeshFormat>,
    /// Triangles that about are left of the asset's mesh.
    pub asset_faces: usize,
    /// Largest side of the asset's textures, texels. They are smaller where the views tell no more.
    pub asset_texture: usize,
    /// Memory that fusion may take, MiB; the mesh's cells are made larger where it would need more, and the
    /// report says so. Less than one view needs to be loaded is an error. `--memory` sets it.
    pub memory_mib: usize,
}

impl Default for FusionOptions {
    fn default() -> Self {
        Self {
            depth_tolerance_px: 4.0,
            normal_tolerance_deg: 40.0,
            min_num_views: 2,
            max_grazing_deg: 82.0,
            border_px: 1,
            spacing: 0.0,
            reconcile: true,
            reconcile_grid_px: 48.0,
            reconcile_sigma_px: 2.0,
            reconcile_max_offset_px: 8.0,
            mesh: true,
            voxel_px: 1.0,
            truncation_voxels: 4.0,
            max_num_triangles: 0,
            watertight: false,
            color: ColorMode::Photographed,
            formats: vec![
                MeshFormat::Ply,
                MeshFormat::Obj,
                MeshFormat::Glb,
                MeshFormat::Asset,
            ],
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
            depth_tolerance_px in 0.001..=1e4,
            normal_tolerance_deg in 0.0..=180.0,
            min_num_views in 1..=255,
            max_grazing_deg in 0.0..=90.0,
            border_px in 0..=1000,
            spacing in 0.0..=1e6,
            reconcile_grid_px in 4.0..=1e5,
            reconcile_sigma_px in 0.001..=1e4,
            reconcile_max_offset_px in 0.001..=1e4,
            voxel_px in 0.01..=1e4,
            truncation_voxels in 1.5..=50.0,
            max_num_triangles in 0..=u32::MAX as usize,
            asset_faces in 100..=10_000_000,
            asset_texture in 64..=16_384,
            memory_mib in Self::MIN_MEMORY_MIB..=1 << 24,
        )
    }
}
