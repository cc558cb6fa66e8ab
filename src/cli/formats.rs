//! What `rilievo import` reads and `rilievo export` writes.

use rilievo_io::CameraFormat;

/// What `rilievo import` reads.
#[derive(Clone, Copy, Debug)]
pub enum ImportFormat {
    /// Cameras.
    Cameras(CameraFormat),
    /// An object of DiLiGenT or DiLiGenT-MV.
    Diligent,
}

/// What `rilievo export` writes.
#[derive(Clone, Copy, Debug)]
pub enum ExportFormat {
    /// Cameras.
    Cameras(CameraFormat),
    /// A run's lighting, for programs of reflectance transformation imaging.
    Lp,
    /// A script that makes the cameras in Blender.
    Blender,
}
