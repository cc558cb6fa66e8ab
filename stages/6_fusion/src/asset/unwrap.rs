//! A mesh laid out flat: charts without overlap, side by side on one texture.

use crate::error::FusionError;
use rilievo_scene::{Mesh, Observer, StageId};
use uvunwrap::{Density, Error, MeshInput, Options, generate_with_progress};

/// Texels around each chart that belong to it.
const PADDING: u32 = 3;
/// Smallest side of a texture.
const MIN_SIDE: usize = 64;
/// Share of a texture that charts of a curved surface cover.
const USED: f64 = 0.62;

/// A mesh with texture coordinates.
pub(super) struct Unwrapped {
    /// Its vertices on seams are there once for each side.
    pub mesh: Mesh,
    pub texture_coords: Vec<[f32; 2]>,
    /// Columns and rows of the texture.
    pub size: (usize, usize),
    pub num_charts: usize,
    /// Edge of a texel on the surface, world's unit.
    pub texel: f64,
}

/// Lays a mesh out on a texture of `texel` (world's unit) a texel or less, or of more where it would
/// be larger than `max_side` texels. The sides are powers of two, which every renderer takes as they
/// are; it rescales others. `None` where no triangle can be laid out.
pub(super) fn unwrap(
    mesh: &Mesh,
    texel: f64,
    max_side: usize,
    observer: &dyn Observer,
) -> Result<Option<Unwrapped>, FusionError> {
    let num_texels = area(mesh) / (texel * texel) / USED;
    if !(num_texels > 0.0 && num_texels.is_finite()) {
        return Ok(None);
    }
    let max_side = max_side.max(MIN_SIDE);
    let wanted = (num_texels.sqrt().ceil() as usize).clamp(MIN_SIDE, max_side);
    let mut side = wanted.next_power_of_two().min(max_side);
    let input = MeshInput::new(&mesh.vertices, mesh.triangles.as_flattened());
    let go_on = |progress: uvunwrap::Progress| {
        let done = (
            progress.done,
            progress.total.unwrap_or(0).max(progress.done),
        );
        let flow = observer.progress(StageId::Fusion, "laying the surface out", done);
        flow.ok_or(()).is_ok()
    };
    let atlas = loop {
        let options = Options {
            density: Density::Auto {
                page_size: side as u32,
            },
            padding: PADDING,
            ..Options::default()
        };
        match generate_with_progress(&[input], &options, go_on) {
            Ok(atlas) if atlas.page_count == 1 => break Some(atlas),
            Err(Error::Cancelled) => return Err(FusionError::Interrupted),
            // The room between many small charts takes more than their area.
            _ if side < max_side => side = (2 * side).min(max_side),
            // Nothing fits: there is a mesh, and no asset.
            _ => break None,
        }
    };
    let Some((atlas, laid)) = atlas.and_then(|mut atlas| {
        let laid = atlas.meshes.pop()?;
        (!laid.indices.is_empty() && atlas.texels_per_unit > 0.0).then_some((atlas, laid))
    }) else {
        return Ok(None);
    };
    // What the charts do not fill of the texture is to their right and below.
    let filled = [atlas.width, atlas.height].map(f64::from);
    let size = [atlas.width, atlas.height].map(u32::next_power_of_two);
    let share = [0, 1].map(|k| (filled[k] / f64::from(size[k])) as f32);
    let pick = |from: &[[f32; 3]]| -> Vec<[f32; 3]> {
        let vertices = laid.vertices.iter();
        vertices.map(|v| from[v.xref as usize]).collect()
    };
    Ok(Some(Unwrapped {
        // The library looks at its charts from below where v points down.
        texture_coords: (laid.vertices.iter())
            .map(|v| [v.uv[0] * share[0], (1.0 - v.uv[1]) * share[1]])
            .collect(),
        mesh: Mesh {
            vertices: pick(&mesh.vertices),
            normals: pick(&mesh.normals),
            colors: Vec::new(),
            triangles: laid.indices.as_chunks::<3>().0.to_vec(),
        },
        size: (size[0] as usize, size[1] as usize),
        num_charts: atlas.chart_count as usize,
        texel: 1.0 / f64::from(atlas.texels_per_unit),
    }))
}

fn area(mesh: &Mesh) -> f64 {
    let areas = mesh.triangles.iter().map(|&[a, b, c]| {
        let [a, b, c] = [a, b, c].map(|v| mesh.vertex(v));
        0.5 * (b - a).cross(&(c - a)).norm()
    });
    areas.sum()
}
