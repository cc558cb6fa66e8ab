//! Depth files whose values stand column by column.
//!
//! An EXR holds its pixels row by row. A depth map that was written from an array stored column by
//! column (as MATLAB and Fortran store theirs) keeps its size, but its values are scrambled: pixel
//! `(x, y)` stands at `x * height + y` of the file's order instead of `y * width + x`.
//!
//! **Test.** Depth is smooth but for its edges, so that few neighbours in a column differ by more
//! than a twentieth, or have a value where the other has none. Read in the wrong order, neighbours in a
//! column are strangers. The order is taken to be wrong only on evidence that no depth map in the
//! right order has: many strangers read by rows, and several times fewer read by columns.

use crate::exit::Failure;
use crate::observe::Console;
use rilievo_io::read_depth;
use rilievo_scene::{DepthMap, StageId};
use std::path::Path;

/// Logarithm of depth by which neighbours differ only across an edge.
const EDGE_LN_DEPTH: f32 = 0.05;
/// Share of strangers in a column from which a map read by rows may be scrambled.
const MIN_STRANGERS: f64 = 0.05;
/// How many times fewer there must be when it is read by columns.
const MIN_RATIO: f64 = 4.0;

/// Reads a depth map in the order that its values stand in, with a warning where that is column by
/// column.
pub fn read(path: &Path, console: &Console) -> Result<DepthMap, Failure> {
    let map = read_depth(path)?;
    let turned = by_columns(&map);
    let (rows, columns) = (strangers(&map), strangers(&turned));
    if rows < MIN_STRANGERS || rows < MIN_RATIO * columns {
        return Ok(map);
    }
    console.warn(
        StageId::Shading,
        format!(
            "{}: its values stand column by column ({:.0} % of neighbours disagree read by rows, {:.1} % by \
             columns) and are read so",
            path.display(),
            100.0 * rows,
            100.0 * columns
        ),
    );
    Ok(turned)
}

fn by_columns(map: &DepthMap) -> DepthMap {
    DepthMap::from_fn(map.width, map.height, |x, y| map.data[x * map.height + y])
}

/// Share of vertical neighbours, at least one of them with a value, that do not belong together.
fn strangers(map: &DepthMap) -> f64 {
    let has = |z: f32| z.is_finite() && z > 0.0;
    let (mut num, mut num_strangers) = (0_usize, 0_usize);
    for (&above, &below) in map.data.iter().zip(map.data.iter().skip(map.width)) {
        match (has(above), has(below)) {
            (false, false) => continue,
            (true, true) if (above / below).ln().abs() < EDGE_LN_DEPTH => {}
            _ => num_strangers += 1,
        }
        num += 1;
    }
    num_strangers as f64 / num.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball before a far wall, with a gap without values beside it.
    fn scene(width: usize, height: usize) -> DepthMap {
        DepthMap::from_fn(width, height, |x, y| {
            let (u, v) = (
                x as f32 / height as f32 - 0.7,
                y as f32 / height as f32 - 0.5,
            );
            let squared = u * u + v * v;
            if squared < 0.1 {
                1000.0 - 300.0 * (0.1 - squared).sqrt()
            } else if squared < 0.13 {
                0.0
            } else {
                2000.0 + 100.0 * v
            }
        })
    }

    fn scrambled(map: &DepthMap) -> DepthMap {
        let mut out = map.clone();
        for y in 0..map.height {
            for x in 0..map.width {
                out.data[x * map.height + y] = *map.at(x, y);
            }
        }
        out
    }

    #[test]
    fn a_map_in_order_has_few_strangers_and_a_scrambled_one_many() {
        for (width, height) in [(160, 120), (120, 160), (640, 480)] {
            let map = scene(width, height);
            let right = strangers(&map);
            let wrong = strangers(&scrambled(&map));
            assert!(right < 0.5 * MIN_STRANGERS, "{right}");
            assert!(wrong > 2.0 * MIN_STRANGERS, "{wrong}");
            assert!(wrong > 2.0 * MIN_RATIO * right, "{wrong} against {right}");
            assert_eq!(by_columns(&scrambled(&map)).data, map.data);
        }
    }
}
