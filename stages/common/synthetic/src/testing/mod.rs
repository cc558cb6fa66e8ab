//! What the tests of all crates build their worlds from: photos in memory, cameras, spheres, light,
//! damage, and the data folder beside the repository.
//!
//! [`Scene`](crate::Scene) and [`Renderer`](crate::Renderer) photograph a whole object; here is what
//! suffices where a test renders its own few pixels, or none.

mod masks;
pub mod mat_file;
mod mutated;
mod photos;
mod posed_sphere;
mod random;
mod shared_data;
mod surfaces;

pub use masks::overlap;
pub use mutated::mutated;
pub use photos::{
    Impatient, PAPER_LIGHT, PosedPhotos, in_memory, linear_of, look_at, photo, posed_view,
    rendered_photo, tinted_light, true_sphere,
};
pub use posed_sphere::{SphereWorld, sphere_world};
pub use random::Random;
pub use shared_data::{not_tested, shared_data};
pub use surfaces::{Maps, anchors_on_grid, on_sphere, painted};
