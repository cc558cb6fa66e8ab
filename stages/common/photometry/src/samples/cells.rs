//! Cells of normals: pixels of a sphere whose normals are nearly equal.

use super::pixels::SphereSamples;
use nalgebra::{UnitQuaternion, Vector3};
use rilievo_scene::{LightSample, ViewIdx};
use std::collections::BTreeMap;

/// Number of cells along an edge of the cube around the unit sphere: about 8° a cell.
const CELLS_PER_EDGE: usize = 12;
/// Number of cells.
pub const NUM_CELLS: usize = 6 * CELLS_PER_EDGE * CELLS_PER_EDGE;

/// Cell of a unit normal on the cube around the sphere.
pub fn cell_of(n: &Vector3<f64>) -> usize {
    let axis = n.iamax();
    let face = 2 * axis + usize::from(n[axis] < 0.0);
    // The arctangent evens out the cells' sizes.
    let coordinate = |k: usize| {
        let angle = (n[(axis + k) % 3] / n[axis].abs()).atan() / std::f64::consts::FRAC_PI_2;
        (((angle + 0.5) * CELLS_PER_EDGE as f64) as usize).min(CELLS_PER_EDGE - 1)
    };
    (face * CELLS_PER_EDGE + coordinate(1)) * CELLS_PER_EDGE + coordinate(2)
}

/// Means of a sphere's pixels over cells of normals in the world; pixels with a clipped channel are left out.
/// `has_gain`: whether the photo is at its view's own exposure.
pub fn light_samples(
    samples: &SphereSamples,
    world_from_cam: &UnitQuaternion<f64>,
    view: ViewIdx,
    (sphere, has_gain): (Option<usize>, bool),
) -> Vec<LightSample> {
    let mut cells: BTreeMap<usize, (Vector3<f64>, [f64; 3], f64)> = BTreeMap::new();
    for reading in samples.readings.iter().filter(|r| r.is_whole()) {
        let normal = world_from_cam * reading.normal;
        let (sum, intensity, count) = cells.entry(cell_of(&normal)).or_default();
        *sum += normal;
        for (c, value) in intensity.iter_mut().enumerate() {
            *value += reading.values[c.min(reading.values.len() - 1)];
        }
        *count += 1.0;
    }
    cells
        .into_values()
        .map(|(sum, intensity, count)| LightSample {
            view,
            sphere,
            normal_in_world: sum.normalize().map(|v| v as f32).into(),
            intensity: intensity.map(|v| (v / count).max(0.0) as f32),
            has_gain,
        })
        .collect()
}
