//! Spherical harmonics, their rotation and fits, per-pixel lighting.
