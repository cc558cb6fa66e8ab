//! The object in posed photos.
//!
//! # Problem
//! Of every photo, the pixels that show the object, without a user's hand and before backdrops of any kind: a printed mat,
//! a table, a room.
//!
//! # Steps
//! 1. [`SeenPoints::part`]: the matched points in space are parted. The object is the largest connected group of points in
//!    the middle of what the cameras look at, before every plane that has nothing behind it (mat, table, wall). Other
//!    groups before such a plane (a reference sphere) are beside it.
//! 2. [`sketch`]: in each photo the projected points of the object, and those of everything else, teach what either
//!    looks like, and a graph cut draws the border along the photo's edges (GrabCut: Rother, Kolmogorov, Blake 2004,
//!    OpenCV's) on a small image.
//! 3. [`Consensus`]: every place around the object is voted on by all sketches. In each photo the [`outline`] is cut
//!    again, with what the votes say of it, and drawn once more in a band around the border on a larger image.
//! 4. What the others' outlines leave of a photo's own, what of the object's points lies in it, and what of it lies near
//!    such points say how sure it is.
//!
//! Photos without poses: [`propose_mask`], where the object stands before a plain backdrop; [`surroundings`], where it was
//! cut out.

mod backdrop;
mod consensus;
mod cut;
mod cut_out;
mod error;
mod outline;
mod points;
mod raster;

pub use backdrop::{Backdrop, MaskProposal, propose_mask};
pub use consensus::{Consensus, Sketch};
pub use cut_out::{Surroundings, surroundings};
pub use error::SegmentationError;
pub use outline::{Outline, outline, sketch};
pub use points::{ObjectPoints, SeenPoints};
