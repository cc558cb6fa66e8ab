//! Tests of the stage as a whole.

mod damaged;
mod rendered_sphere;
mod several_spheres;
mod shape;
mod studio;
