//! A light mesh with textures: albedo, normals and occlusion ([`Asset`]).
//!
//! 1. The clean mesh is made light ([`lightened`]) and gets smooth normals (`normals`).
//! 2. `unwrap`: it is cut into charts, which are laid out flat side by side.
//! 3. `tangents`: frames for the normal map, by the rule that all renderers share.
//! 4. `bake`: what the views see at each texel's place: the mean of their normals and albedos, by
//!    the weights of the cloud's points. `occlusion`: how much of the sky each vertex sees past the
//!    mesh.
//! 5. `texture`: texels beside the charts repeat the nearest one, so that no seam shows when a
//!    renderer filters.

mod bake;
mod normals;
mod occlusion;
mod tangents;
mod texture;
mod unwrap;

use crate::error::{FusionError, warn};
use crate::memory;
use crate::options::FusionOptions;
use crate::report::{AssetReport, MeshReport};
use crate::sight::{DEPTH_TOLERANCE_PX, min_normal_cosine};
use crate::simplify::lightened;
use crate::views::LoadedViews;
use bake::Baker;
use rilievo_scene::{Asset, Mesh, Observer, PageCaches, StageId};
use texture::Textures;
use unwrap::Unwrapped;

/// Edge of a texel, pixel footprints: what a view resolves between its pixels is still there.
const TEXEL_PX: f64 = 0.5;

/// Share of the surface that no view sees from which on a warning names it.
const MAX_UNSEEN: f64 = 0.1;

/// Makes the asset of a mesh; `None` where it has no triangles that could be laid out.
pub(crate) fn make(
    (mesh, mesh_report): (&Mesh, &MeshReport),
    loaded: &LoadedViews,
    options: &FusionOptions,
    observer: &dyn Observer,
) -> Result<Option<(Asset, AssetReport)>, FusionError> {
    let step = |step: &str| {
        let flow = observer.progress(StageId::Fusion, step, (0, 1));
        flow.ok_or(FusionError::Interrupted)
    };
    let footprint = loaded.median_footprint;
    step("making a light mesh")?;
    let (faces, dense) = memory::asset_triangles(options);
    if faces < options.asset_faces.min(mesh.triangles.len()) {
        let message = format!(
            "the asset has no more than {faces} triangles, to stay within {} MiB; raise the memory for more",
            options.memory_mib
        );
        warn(observer, message)?;
    }
    let (mut light, moved) = lightened(mesh, faces, dense);
    let simplified_by = mesh_report.simplified_by + moved;
    normals::smooth(&mut light);
    step("laying the surface out")?;
    let texel = TEXEL_PX * footprint;
    let (allowed, side) = memory::texture_sides(options);
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
    let is_bounded = size.0 >= side && unwrapped.texel > texel;
    if is_bounded && side < allowed {
        let message = format!(
            "the asset's textures are no larger than {side} texels a side, to stay within {} MiB; raise the memory for \
             more detail",
            options.memory_mib
        );
        warn(observer, message)?;
    }
    let tangents = tangents::tangents(mesh, texture_coords);
    step("finding what the sky reaches")?;
    let occlusion = occlusion::open_sky(mesh, footprint);
    let baker = Baker {
        unwrapped: &unwrapped,
        tangents: &tangents,
        occlusion: &occlusion,
        views: &loaded.views,
        limits: (
            mesh_report.voxel.max(DEPTH_TOLERANCE_PX * footprint) + simplified_by,
            min_normal_cosine(),
        ),
    };
    let caches = PageCaches::new(&loaded.store, memory::num_pages(options));
    let mut textures = Textures::new(*size);
    baker.bake(&caches, &mut textures, observer)?;
    drop(caches);
    step("filling the textures' gaps")?;
    let covered = textures.num_covered();
    let unseen_share = 1.0 - textures.num_seen() as f64 / covered.max(1) as f64;
    if unseen_share > MAX_UNSEEN {
        let message = format!(
            "no photo sees {:.0} % of the asset's surface: its textures are made up there from what lies around",
            100.0 * unseen_share
        );
        warn(observer, message)?;
    }
    let report = AssetReport {
        shows: loaded.asset_shows,
        num_triangles: mesh.triangles.len(),
        num_vertices: mesh.vertices.len(),
        num_charts: unwrapped.num_charts,
        texture_size: [size.0, size.1],
        texel: unwrapped.texel,
        is_bounded,
        used_share: covered as f64 / (size.0 * size.1) as f64,
        unseen_share,
        simplified_by,
    };
    let (base_color, normal, occlusion) = textures.finish();
    let asset = Asset {
        mesh: unwrapped.mesh,
        texture_coords: unwrapped.texture_coords,
        tangents,
        shows: loaded.asset_shows,
        base_color,
        normal,
        occlusion,
    };
    Ok(Some((asset, report)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Silent;

    /// The first triangles of a cube.
    fn of_cube(num: usize) -> Mesh {
        let corner = |i: u32| [i & 1, i >> 1 & 1, i >> 2].map(|c| c as f32 - 0.5);
        let faces = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        let triangles = faces
            .iter()
            .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
        let vertices: Vec<[f32; 3]> = (0..8).map(corner).collect();
        Mesh {
            normals: vertices.clone(),
            vertices,
            colors: Vec::new(),
            triangles: triangles.take(num).collect(),
        }
    }

    /// What Khronos' validator asks of an asset's vertices.
    #[test]
    fn the_smallest_meshes_are_laid_out_with_frames_of_unit_vectors() {
        // A triangle, a square, a cube with a hole and a whole one.
        for num in [1, 2, 11, 12] {
            let mut mesh = of_cube(num);
            normals::smooth(&mut mesh);
            let laid = unwrap::unwrap(&mesh, 0.01, 1024, &Silent)
                .expect("in time")
                .expect("laid out");
            assert_eq!(laid.mesh.triangles.len(), num);
            assert!(laid.size.0.is_power_of_two() && laid.size.1.is_power_of_two());
            let tangents = tangents::tangents(&laid.mesh, &laid.texture_coords);
            for (v, tangent) in tangents.iter().enumerate() {
                let length = |t: &[f32]| t.iter().map(|c| c * c).sum::<f32>().sqrt();
                assert!(
                    (length(&tangent[..3]) - 1.0).abs() < 1e-5,
                    "{num}: {tangent:?}"
                );
                assert!((length(&laid.mesh.normals[v]) - 1.0).abs() < 1e-5, "{num}");
                assert_eq!(tangent[3].abs(), 1.0);
                assert!(
                    laid.texture_coords[v]
                        .iter()
                        .all(|c| (0.0..=1.0).contains(c)),
                    "{num}"
                );
            }
        }
    }
}
