//! A light mesh with textures: albedo, normals and occlusion ([`Asset`]).
//!
//! 1. The clean mesh is made light ([`simplify`]) and gets smooth normals (`normals`).
//! 2. `unwrap`: it is cut into charts, which are laid out flat side by side.
//! 3. `tangents`: frames for the normal map, by the rule that all renderers share.
//! 4. `bake`: what the views see at each texel's place: the mean of their normals and albedos, by the weights of the
//!    cloud's points. `occlusion`: how much of the sky each vertex sees past the mesh.
//! 5. `texture`: texels beside the charts repeat the nearest one, so that no seam shows when a renderer filters.

mod bake;
mod normals;
mod occlusion;
mod tangents;
mod texture;
mod unwrap;

use crate::error::FusionError;
use crate::memory;
use crate::options::FusionOptions;
use crate::reader::Readers;
use crate::report::AssetReport;
use crate::simplify::simplify;
use crate::views::Stock;
use bake::Baker;
use rilievo_scene::{Asset, Mesh, Observer, StageId};
use texture::Textures;
use unwrap::Unwrapped;

/// Edge of a texel, pixel footprints: what a view tells between its pixels is still there.
const TEXEL_PX: f64 = 0.5;

/// Makes the asset of a mesh; `None` where it has no triangles that could be laid out. `footprint`: of the views' pixels
/// on the surface (world's unit).
pub(crate) fn make(
    mesh: &Mesh,
    stock: &Stock,
    footprint: f64,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<Option<(Asset, AssetReport)>, FusionError> {
    let step = |step: &str| {
        let flow = observer.progress(StageId::Fusion, step, (0, 1));
        flow.ok_or(FusionError::Interrupted)
    };
    step("making a light mesh")?;
    let mut light = mesh.clone();
    let simplified_by = simplify(&mut light, options.asset_faces);
    light.colors.clear();
    normals::smooth(&mut light);
    step("laying the surface out")?;
    let texel = TEXEL_PX * footprint;
    let side = memory::texture_side(options);
    let Some(unwrapped) = unwrap::unwrap(&light, texel, side, observer)? else {
        return Ok(None);
    };
    drop(light);
    let Unwrapped {
        mesh,
        texture_coords,
        size,
        ..
    } = &unwrapped;
    let tangents = tangents::tangents(mesh, texture_coords);
    step("finding what the sky reaches")?;
    let occlusion = occlusion::open_sky(mesh, footprint);
    let baker = Baker {
        unwrapped: &unwrapped,
        tangents: &tangents,
        occlusion: &occlusion,
        views: &stock.views,
        limits: (
            options.depth_tolerance_px * footprint + simplified_by,
            options.normal_tolerance_deg.to_radians().cos(),
        ),
    };
    let readers = Readers::new(&stock.shelf, memory::num_pages(options));
    let mut textures = Textures::new(*size);
    baker.bake(&readers, &mut textures, observer)?;
    drop(readers);
    step("filling the textures' gaps")?;
    let covered = textures.num_covered();
    let report = AssetReport {
        num_triangles: mesh.triangles.len(),
        num_vertices: mesh.vertices.len(),
        num_charts: unwrapped.num_charts,
        texture_size: [size.0, size.1],
        texel: unwrapped.texel,
        is_bounded: size.0 >= side && unwrapped.texel > texel,
        used_share: covered as f64 / (size.0 * size.1) as f64,
        unseen_share: 1.0 - textures.num_seen() as f64 / covered.max(1) as f64,
        simplified_by,
    };
    let (base_color, normal, occlusion) = textures.finish();
    let asset = Asset {
        mesh: unwrapped.mesh,
        texture_coords: unwrapped.texture_coords,
        tangents,
        base_color,
        normal,
        occlusion,
    };
    Ok(Some((asset, report)))
}
