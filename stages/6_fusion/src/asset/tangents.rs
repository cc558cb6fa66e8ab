//! Tangents for the normal map, by the rule that renderers and bakers share.
//!
//! Source: Mikkelsen, "Simulation of wrinkled surfaces revisited", 2008, and his program
//! MikkTSpace, which glTF 2.0 (3.7.2.1) names. The second texture coordinate is turned up for it,
//! as in the programs that write glTF.

use bevy_mikktspace::{Geometry, TangentSpace, generate_tangents};
use nalgebra::Vector3;
use rilievo_scene::Mesh;

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
        if let Some(space) = tangent_space {
            let vertex = self.vertex(face, vert);
            self.tangents[vertex] = space.tangent_encoded();
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

fn any_along(normal: [f32; 3]) -> [f32; 4] {
    let normal = Vector3::from(normal);
    let axis = match normal.x.abs() < 0.7 {
        true => Vector3::x(),
        false => Vector3::y(),
    };
    let along = (axis - normal * normal.dot(&axis)).try_normalize(0.0);
    let [x, y, z]: [f32; 3] = along.unwrap_or(axis).into();
    [x, y, z, 1.0]
}
