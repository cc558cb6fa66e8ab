//! Stage 3: verified matches to camera poses, sparse points and depth anchors.
