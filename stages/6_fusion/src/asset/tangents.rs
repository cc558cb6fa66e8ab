//! Tangents for the normal map, by the rule that renderers and bakers share.
//!
//! Source: Mikkelsen, "Simulation of wrinkled surfaces revisited", 2008, and his program
//! MikkTSpace, which glTF 2.0 (3.7.2.1) names. The second texture coordinate is turned up for it,
//! as in the programs that write glTF.

use bevy_mikktspace::{Geometry, TangentSpace, generate_tangents};
use nalgebra::Vector3;
use rilievo_scene::Mesh;

/// Shorter ones across the normal, of unit length as found, are rounding.
const MIN_TANGENT: f32 = 1e-3;

struct Surface<'a> {
    mesh: &'a Mesh,
    texture_coords: &'a [[f32; 2]],
    tangents: Vec<[f32; 4]>,
}

impl Surface<'_> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.mesh.triangles[face][corner] as usize
    }
}

impl Geometry for Surface<'_> {
    fn num_faces(&self) -> usize {
        self.mesh.triangles.len()
    }

    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }

    fn position(&self, face: usize, vert: usize) -> [f32; 3] {
        self.mesh.vertices[self.vertex(face, vert)]
    }

    fn normal(&self, face: usize, vert: usize) -> [f32; 3] {
        self.mesh.normals[self.vertex(face, vert)]
    }

    fn tex_coord(&self, face: usize, vert: usize) -> [f32; 2] {
        let [u, v] = self.texture_coords[self.vertex(face, vert)];
        [u, 1.0 - v]
    }

    fn set_tangent(&mut self, tangent_space: Option<TangentSpace>, face: usize, vert: usize) {
        let vertex = self.vertex(face, vert);
        let encoded = tangent_space.map(|space| space.tangent_encoded());
        if let Some(tangent) = encoded.and_then(|t| across(self.mesh.normals[vertex], t)) {
            self.tangents[vertex] = tangent;
        }
    }
}

/// Unit tangents of the vertices and the sign of their bitangents. Where triangles have no area on
/// the texture, any direction along the surface.
pub(super) fn tangents(mesh: &Mesh, texture_coords: &[[f32; 2]]) -> Vec<[f32; 4]> {
    let mut surface = Surface {
        mesh,
        texture_coords,
        tangents: mesh.normals.iter().map(|n| any_along(*n)).collect(),
    };
    // It has no way to fail as yet; what it leaves out keeps any direction.
    let _ = generate_tangents(&mut surface);
    surface.tangents
}

/// A tangent across the normal and of unit length, with its bitangent's sign; `None` where the
/// library found no direction, as around triangles without area on the texture.
fn across(normal: [f32; 3], [x, y, z, sign]: [f32; 4]) -> Option<[f32; 4]> {
    let (normal, tangent) = (Vector3::from(normal), Vector3::new(x, y, z));
    let [x, y, z] = (tangent - normal * normal.dot(&tangent))
        .try_normalize(MIN_TANGENT)?
        .into();
    Some([x, y, z, sign])
}

fn any_along(normal: [f32; 3]) -> [f32; 4] {
    let axis = match normal[0].abs() < 0.7 {
        true => [1.0, 0.0, 0.0, 1.0],
        false => [0.0, 1.0, 0.0, 1.0],
    };
    across(normal, axis).unwrap_or(axis)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_without_area_on_the_texture_have_unit_tangents_across_their_normals() {
        // The first has its corners in one point of the texture, the second on a line, the third none in space.
        let mesh = Mesh {
            vertices: vec![
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [1.0, 1.0, 0.0],
                [1.0, 1.0, 0.0],
            ],
            normals: vec![[0.0, 0.6, 0.8]; 5],
            colors: Vec::new(),
            triangles: vec![[0, 1, 2], [1, 3, 2], [3, 4, 3]],
        };
        for coords in [
            [[0.5, 0.5]; 5],
            [[0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [0.4, 0.4], [0.4, 0.4]],
            [[0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.1, 0.9], [0.1, 0.9]],
        ] {
            for (tangent, normal) in tangents(&mesh, &coords).iter().zip(&mesh.normals) {
                let [x, y, z, sign] = *tangent;
                let tangent = Vector3::new(x, y, z);
                assert!((tangent.norm() - 1.0).abs() < 1e-5, "{tangent}");
                assert!(
                    tangent.dot(&Vector3::from(*normal)).abs() < 1e-5,
                    "{tangent}"
                );
                assert_eq!(sign.abs(), 1.0);
            }
        }
    }
}
