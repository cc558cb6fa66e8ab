//! Ground-truth scenes, a renderer, and gauge-aligned comparison.
