//! Stage 6: depth and normal maps of all views to one oriented point cloud and a mesh.
