//! Stage 4: reference sphere or shape to lighting, albedo and scale.
