//! Stage 1: decoded photos to linear images with intrinsics, masks and a preflight.
