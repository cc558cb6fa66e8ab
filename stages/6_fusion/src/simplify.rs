//! A mesh of fewer triangles: edges are collapsed where that changes the surface least, by quadric
//! error metrics.
//!
//! Source: Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH
//! 1997; as the library meshoptimizer does it. Vertices that stay keep their places, normals and
//! colours, so that a light mesh is still lit as the dense one.

use crate::pieces::drop_unused;
use meshopt::{SimplifyOptions, simplify_decoder, simplify_scale_decoder, simplify_sloppy_decoder};
use rayon::prelude::*;
use rilievo_scene::Mesh;
use rilievo_scene::cloud::renumber;

/// Triangles that [`coarsen`] looks at together: about 100 bytes each.
const CHUNK: usize = 1 << 18;
/// Share of the deviation that the first of two rounds may use up.
const FIRST_SHARE: f64 = 0.75;

/// Takes triangles away where the surface is flat, as long as it moves by no more than `deviation`,
/// as the quadrics estimate it; returns by how much it did, world's unit. Chunks of triangles that
/// follow each other are looked at alone, with borders that stay; a second round has its borders
/// elsewhere. So the memory does not grow with the mesh.
pub(crate) fn coarsen(mesh: &mut Mesh, deviation: f64) -> f64 {
    let mut moved = 0.0;
    for (first, share) in [(CHUNK, FIRST_SHARE), (CHUNK / 2, 1.0)] {
        let is_whole = mesh.triangles.len() <= CHUNK;
        let (first, share, options) = match is_whole {
            true => (CHUNK, 1.0, SimplifyOptions::ErrorAbsolute),
            false => {
                let options = SimplifyOptions::ErrorAbsolute | SimplifyOptions::LockBorder;
                (first, share, options)
            }
        };
        let allowed = (share * deviation - moved) as f32;
        let (head, tail) = mesh.triangles.split_at(first.min(mesh.triangles.len()));
        let chunks: Vec<&[[u32; 3]]> = std::iter::once(head).chain(tail.chunks(CHUNK)).collect();
        let vertices = &mesh.vertices;
        let coarser = chunks.into_par_iter().map(|chunk| {
            let mut used = chunk.as_flattened().to_vec();
            used.sort_unstable();
            used.dedup();
            let number = |v: &u32| used.partition_point(|other| other < v) as u32;
            let corners: Vec<u32> = chunk.as_flattened().iter().map(number).collect();
            let places: Vec<[f32; 3]> = used.iter().map(|&v| vertices[v as usize]).collect();
            let mut error = 0.0;
            let kept = simplify_decoder(&corners, &places, 0, allowed, options, Some(&mut error));
            let triangles = kept.as_chunks::<3>().0.iter();
            let triangles = triangles.map(|t| t.map(|v| used[v as usize]));
            (triangles.collect::<Vec<[u32; 3]>>(), f64::from(error))
        });
        let (triangles, errors): (Vec<_>, Vec<f64>) = coarser.unzip();
        moved += errors.into_iter().fold(0.0, f64::max);
        mesh.triangles = triangles.concat();
        if is_whole {
            break;
        }
    }
    tidy(mesh);
    moved
}

/// Leaves about `max_num_triangles`, more where the surface's pieces and holes need them; returns
/// by how much the surface moved, as the quadrics estimate it, world's unit.
pub(crate) fn simplify(mesh: &mut Mesh, max_num_triangles: usize) -> f64 {
    if mesh.triangles.len() <= max_num_triangles {
        return 0.0;
    }
    let mut error = 0.0;
    let kept = simplify_decoder(
        mesh.triangles.as_flattened(),
        &mesh.vertices,
        max_num_triangles.saturating_mul(3),
        f32::MAX,
        SimplifyOptions::ErrorAbsolute,
        Some(&mut error),
    );
    mesh.triangles = kept.as_chunks::<3>().0.to_vec();
    tidy(mesh);
    f64::from(error)
}

/// Drops what collapsed edges leave behind: vertices that no triangle uses, and the two sides of what
/// has become flat, triangles of the same corners that look opposite ways. Both run through each of
/// their edges, against each other: a closed mesh stays closed without them.
fn tidy(mesh: &mut Mesh) {
    let numbered = mesh.triangles.iter().zip(0_u32..);
    let places = numbered.map(|(t, number)| {
        let mut corners = *t;
        corners.sort_unstable();
        // Else the triangle in ascending order looks the other way.
        let is_turn = (0..3).any(|k| [t[k], t[(k + 1) % 3], t[(k + 2) % 3]] == corners);
        (corners, is_turn, number)
    });
    let mut places: Vec<([u32; 3], bool, u32)> = places.collect();
    places.sort_unstable();
    let mut is_flat = vec![false; mesh.triangles.len()];
    for same in places.chunk_by(|a, b| a.0 == b.0) {
        let (over, turned) = same.split_at(same.partition_point(|(_, is_turn, _)| !is_turn));
        for (one, other) in over.iter().zip(turned) {
            is_flat[one.2 as usize] = true;
            is_flat[other.2 as usize] = true;
        }
    }
    drop(places);
    let mut flat = is_flat.iter();
    mesh.triangles.retain(|_| flat.next() == Some(&false));
    let index = vec![0; mesh.vertices.len()];
    drop_unused(mesh, index);
}

/// The same as a mesh of its own, without colours. A mesh of more than `max_num_dense` triangles is
/// thinned on a grid first, which takes little memory.
pub(crate) fn lightened(
    mesh: &Mesh,
    max_num_triangles: usize,
    max_num_dense: usize,
) -> (Mesh, f64) {
    let (mut moved, mut thinned) = (0.0, 0.0);
    let mut corners = mesh.triangles.as_flattened().to_vec();
    if mesh.triangles.len() > max_num_dense {
        let num = max_num_dense.saturating_mul(3);
        corners =
            simplify_sloppy_decoder(&corners, &mesh.vertices, num, f32::MAX, Some(&mut thinned));
        // Its error is a share of the extent.
        thinned *= simplify_scale_decoder(&mesh.vertices);
    }
    if corners.len() > max_num_triangles.saturating_mul(3) {
        corners = simplify_decoder(
            &corners,
            &mesh.vertices,
            max_num_triangles.saturating_mul(3),
            f32::MAX,
            SimplifyOptions::ErrorAbsolute,
            Some(&mut moved),
        );
    }
    let mut triangles = corners.as_chunks::<3>().0.to_vec();
    let used = renumber(&mut triangles, mesh.vertices.len());
    let pick = |from: &[[f32; 3]]| used.iter().map(|&v| from[v]).collect();
    let light = Mesh {
        vertices: pick(&mesh.vertices),
        normals: pick(&mesh.normals),
        colors: Vec::new(),
        triangles,
    };
    (light, f64::from(moved) + f64::from(thinned))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{manifold, rim};
    use std::collections::BTreeMap;

    /// A sphere of radius 1 as a grid of squares over a cube's six sides, each two triangles.
    fn sphere(num: usize) -> Mesh {
        let mut mesh = Mesh::default();
        let mut numbers: BTreeMap<[i64; 3], u32> = BTreeMap::new();
        let half = num as i64;
        for axis in 0..3 {
            for side in [-half, half] {
                for (u, v) in (0..num * num).map(|k| (k % num, k / num)) {
                    let corner = |du: usize, dv: usize| {
                        let mut at = [side; 3];
                        at[(axis + 1) % 3] = 2 * (u + du) as i64 - half;
                        at[(axis + 2) % 3] = 2 * (v + dv) as i64 - half;
                        at
                    };
                    let mut number = |at: [i64; 3]| {
                        *numbers.entry(at).or_insert_with(|| {
                            let at = nalgebra::Vector3::from(at.map(|c| c as f32)).normalize();
                            mesh.vertices.push(at.into());
                            mesh.normals.push(at.into());
                            mesh.colors
                                .push(at.map(|c| (127.0 * (c + 1.0)) as u8).into());
                            mesh.vertices.len() as u32 - 1
                        })
                    };
                    let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                    let [a, b, c, d] = [number(a), number(b), number(c), number(d)];
                    let square = [[a, b, c], [a, c, d]];
                    let turned =
                        square.map(|[a, b, c]| if side < 0 { [a, c, b] } else { [a, b, c] });
                    mesh.triangles.extend(turned);
                }
            }
        }
        mesh
    }

    #[test]
    fn a_light_sphere_is_still_one() {
        let mut mesh = sphere(40);
        let num_before = mesh.triangles.len();
        let error = simplify(&mut mesh, 1000);
        assert!(
            (500..=1000).contains(&mesh.triangles.len()),
            "{}",
            mesh.triangles.len()
        );
        assert!(
            num_before > 19_000 && error > 0.0 && error < 0.02,
            "{error}"
        );
        assert!(rim::boundary_loops(&mesh).is_empty());
        assert_eq!(manifold::separate(&mut mesh), 0);
        for (k, at) in mesh.vertices.iter().enumerate() {
            assert_eq!(*at, mesh.normals[k]);
            assert_eq!(mesh.colors[k], at.map(|c| (127.0 * (c + 1.0)) as u8));
        }
        let mut depths = 0.0;
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| nalgebra::Vector3::from(mesh.vertices[v as usize]));
            let depth = 1.0 - (b - a).cross(&(c - a)).normalize().dot(&a);
            assert!((0.0..0.1).contains(&depth), "{depth}");
            depths += depth;
        }
        // Triangles of equal edges lie 0.005 below the sphere.
        let mean = depths / mesh.triangles.len() as f32;
        assert!(mean < 0.012, "{mean}");
    }

    #[test]
    fn a_light_copy_is_the_same_and_one_too_large_for_its_memory_is_thinned() {
        let dense = sphere(40);
        let mut simplified = dense.clone();
        let error = simplify(&mut simplified, 1000);
        let (light, moved) = lightened(&dense, 1000, usize::MAX);
        assert_eq!(light.triangles.len(), simplified.triangles.len());
        assert_eq!(moved, error);
        let (thinned, moved) = lightened(&dense, 1000, 6000);
        assert!(
            (300..=1000).contains(&thinned.triangles.len()),
            "{}",
            thinned.triangles.len()
        );
        assert!(moved > error && moved < 0.2, "{moved}");
        for at in &thinned.vertices {
            assert!((nalgebra::Vector3::from(*at).norm() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn flat_places_become_coarser_within_the_deviation() {
        // One chunk, and several.
        for num in [100, 260] {
            let mut mesh = sphere(num);
            let num_before = mesh.triangles.len();
            assert_eq!(num_before > CHUNK, num == 260);
            let deviation = 1e-3;
            let moved = coarsen(&mut mesh, deviation);
            assert!(moved > 0.2 * deviation && moved <= deviation, "{moved}");
            // Triangles of equal edges h lie h²/6 below the sphere: some 6000 suffice.
            let num_left = mesh.triangles.len();
            assert!(
                num_left > 1000 && num_left * 10 < num_before,
                "{num_left} of {num_before}"
            );
            assert!(rim::boundary_loops(&mesh).is_empty());
            assert_eq!(manifold::separate(&mut mesh), 0);
            for t in &mesh.triangles {
                let [a, b, c] = t.map(|v| nalgebra::Vector3::from(mesh.vertices[v as usize]));
                let middle = f64::from(((a + b + c) / 3.0).norm());
                assert!(1.0 - middle < 4.0 * deviation, "{middle}");
            }
        }
    }

    #[test]
    fn pieces_that_become_flat_are_dropped() {
        // A tetrahedron far smaller than the deviation, beside a sphere and joined to nothing.
        let mut mesh = sphere(40);
        let num = mesh.vertices.len() as u32;
        let corners = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 0.05],
        ];
        for at in corners {
            mesh.vertices.push(at.map(|c: f32| 2.0 + 1e-2 * c));
            mesh.normals.push([0.0, 0.0, 1.0]);
            mesh.colors.push([0; 3]);
        }
        let sides = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        mesh.triangles.extend(sides.map(|t| t.map(|v| v + num)));
        let before = mesh.clone();
        coarsen(&mut mesh, 2e-3);
        assert!(mesh.vertices.iter().all(|at| at[0] < 1.5));
        assert!(rim::boundary_loops(&mesh).is_empty());
        // A flat pair beside the real triangle of the same corners leaves that one.
        let mut mesh = before.clone();
        let [a, b, c] = mesh.triangles[7];
        mesh.triangles.extend([[b, a, c], [b, c, a]]);
        tidy(&mut mesh);
        let turned = |mesh: &Mesh| {
            let least = |t: &[u32; 3]| (0..3).map(|k| [t[k], t[(k + 1) % 3], t[(k + 2) % 3]]).min();
            let mut all: Vec<_> = mesh.triangles.iter().map(least).collect();
            all.sort_unstable();
            all
        };
        assert_eq!(turned(&mesh), turned(&before));
        assert_eq!(mesh.vertices, before.vertices);
    }

    #[test]
    fn a_mesh_that_is_light_enough_stays() {
        let mut mesh = sphere(4);
        let before = mesh.clone();
        assert_eq!(simplify(&mut mesh, 500), 0.0);
        assert_eq!(mesh, before);
    }
}
