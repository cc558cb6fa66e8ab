//! The reference sphere in perspective: outline, normals, position, detection.
//!
//! # Problem
//! A sphere of radius `R` at `C` (camera frame) is met by the rays within the half-angle
//! `a = asin(R / |C|)` of the axis `u = C / |C|`: a cone. Its outline in the picture is an ellipse,
//! displaced from the image of the centre and elongated away from the optical axis;
//! treating it as orthographic turns all normals by the angle off the axis.
//!
//! * [`SphereInCamera`]: normals, outline and ellipse of a known sphere.
//! * [`OutlineCone`]: the cone from outline points, masks, ellipses or circles.
//! * `locate`: one centre, and the world's scale, from marks in many posed views.
//! * `several`: the world's scale from several spheres.
//! * [`locate_request`]: all spheres from what the user said, refined on the images.
//! * `refine`: outline points at sub-pixel precision on the image.
//! * `detect`: finding spheres without marks.

mod around;
mod cone;
mod confirm;
mod consensus;
mod detect;
mod error;
mod known;
mod locate;
#[cfg(test)]
mod locate_tests;
mod mark;
mod options;
mod outline_fit;
mod posed_image;
mod refine;
mod refit;
mod request;
mod several;
mod shading;

pub use cone::{OutlineCone, SphereInCamera};
pub use confirm::MarkEvidence;
pub use detect::detect_in_photo;
pub use error::SphereError;
pub use locate::{ScaleEstimate, SphereFit, ViewAgreement, WorldScale};
pub use mark::{check_marked_points, cone_from_mark, outline_of_mark};
pub use options::SphereOptions;
pub use request::{LocatedSpheres, locate_request};
pub use several::{CommonScale, ScaleContradiction, ScaleOutcome};
