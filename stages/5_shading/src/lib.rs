//! Stage 5: coupled multi-view shape from shading to depth and normal maps.
