//! The facts that stage 6 reports.

use rilievo_scene::BaseColor;
use serde::{Deserialize, Serialize};

/// How far overlapping views lie apart along the surface's normal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Layering {
    /// Pairs of pixels that see one surface: those that were measured.
    pub num_pairs: usize,
    /// Pairs farther apart than `tolerance`: one surface hides another, or a map is wrong.
    pub num_apart: usize,
    /// Root mean square distance, world's unit.
    pub rms: f64,
    /// Median of the absolute distance, world's unit.
    pub median: f64,
    /// 90 % quantile of the absolute distance, world's unit.
    pub p90: f64,
    /// Root mean square distance of the smooth part (the mean over windows of 48 pixels), world's
    /// unit: what an offset between maps causes, and noise does not.
    pub smooth_rms: f64,
    /// Mean pixel footprint, world's unit, for comparison.
    pub footprint: f64,
    /// Distance up to which two pixels count as one surface, world's unit: four standard deviations
    /// of the distances, between one footprint and four.
    pub tolerance: f64,
}

/// One view's share of the result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewFusion {
    /// The photo's name without ending.
    pub name: String,
    /// Pixels with a depth.
    pub num_depths: usize,
    /// Pixels dropped because their values are not finite or not positive.
    pub num_invalid: usize,
    /// Pixels dropped at the border of the map or at a depth edge.
    pub num_border: usize,
    /// Pixels dropped because the surface is seen too obliquely.
    pub num_grazing: usize,
    /// Pixels dropped because another view sees through them or too few agree.
    pub num_inconsistent: usize,
    /// Points of the cloud that come from this view.
    pub num_points: usize,
}

/// The mesh in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MeshReport {
    /// Vertices.
    pub num_vertices: usize,
    /// Triangles.
    pub num_triangles: usize,
    /// Smallest and largest coordinates of the vertices.
    pub bounds: Option<[[f32; 3]; 2]>,
    /// Edge of a cell, world's unit.
    pub voxel: f64,
    /// Factor by which the cells are larger than asked for, to stay within the memory; 1: not.
    pub coarsened_by: f64,
    /// What the cells take, beside the memory, MiB.
    pub memory_mib: f64,
    /// Pieces that hang together.
    pub num_pieces: usize,
    /// Pieces that were too small to be surface and were dropped.
    pub num_dropped_pieces: usize,
    /// Share of the triangles that were dropped with them.
    pub dropped_share: f64,
    /// Edges that more than two triangles shared, before their sheets were separated.
    pub num_separated_edges: usize,
    /// Holes that were closed by a smooth surface.
    pub num_closed_holes: usize,
    /// Area of what closes them, world's unit squared.
    pub closed_area: f64,
    /// Loops in which the surface ends.
    pub num_open_loops: usize,
    /// Length of these together, world's unit.
    pub boundary_length: f64,
    /// Triangles before it was made lighter, where it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub num_triangles_before: Option<usize>,
    /// By how much that moved the surface, as the quadrics estimate it, world's unit.
    pub simplified_by: f64,
    /// Mean distance of the vertices from the mean of the views' surfaces, as the cloud's points
    /// are, world's unit.
    pub mean_distance_to_cloud: Option<f64>,
}

/// The asset in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AssetReport {
    /// What the base colour shows.
    pub shows: BaseColor,
    /// Triangles.
    pub num_triangles: usize,
    /// Vertices, those on seams once for each side.
    pub num_vertices: usize,
    /// Pieces of the surface that are laid out flat.
    pub num_charts: usize,
    /// Columns and rows of the textures.
    pub texture_size: [usize; 2],
    /// Edge of a texel on the surface, world's unit.
    pub texel: f64,
    /// Whether the texels are larger than the views' pixels, so that the textures are no larger
    /// than allowed.
    pub is_bounded: bool,
    /// Share of the textures that surface covers.
    pub used_share: f64,
    /// Share of that which no view sees: there the colours repeat what lies around, and the normals
    /// are the light mesh's.
    pub unseen_share: f64,
    /// By how much the light mesh moved the surface, as the quadrics estimate it, world's unit.
    pub simplified_by: f64,
}

/// Report of [`crate::run`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FusionReport {
    /// Points of the cloud.
    pub num_points: usize,
    /// Distance between them, world's unit; 0 where none was asked for and the maps hold relief down to
    /// the pixels.
    pub spacing: f64,
    /// Mean number of views that agree on a point.
    pub mean_num_views: f64,
    /// Points that another view covers: it sees surface there that faces the same way, within 30
    /// pixel footprints of the point along the normal. All points count, also those that a spacing
    /// thins out.
    pub num_covered: usize,
    /// Share of those points from which most views that cover them have their surfaces farther than
    /// three pixel footprints: where it is large, the views' surfaces are two walls and not one. A
    /// single view counts little, for relief may hide a point from it. `None` where no point is
    /// covered.
    pub share_apart: Option<f64>,
    /// Distance between views; reports up to version 9 have it after a correction.
    #[serde(alias = "layering_after")]
    pub layering: Layering,
    /// Every view.
    pub views: Vec<ViewFusion>,
    /// The mesh, where one was made.
    pub mesh: Option<MeshReport>,
    /// The asset, where one was made.
    pub asset: Option<AssetReport>,
}
