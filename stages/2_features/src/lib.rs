//! Stage 2: linear photos to keypoints and verified matches.
