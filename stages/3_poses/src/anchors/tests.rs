//! Tests of the anchors as a whole.
