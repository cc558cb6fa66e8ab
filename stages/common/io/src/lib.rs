//! Image, OpenEXR, PLY, COLMAP and JSON formats.
