//! What the fits of the light are made on.

use nalgebra::{UnitQuaternion, Vector3};

/// What a photo shows of a surface point with a known normal.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Unit normal.
    pub normal: Vector3<f64>,
    /// Linear intensity of every channel.
    pub values: Vec<f64>,
    /// Which channels are not clipped.
    pub usable: Vec<bool>,
}

impl Reading {
    /// A pixel whose channels are clipped from `limit` on.
    pub fn of_pixel(normal: Vector3<f64>, pixel: &[f32], limit: f64) -> Self {
        let values: Vec<f64> = pixel.iter().map(|&v| f64::from(v)).collect();
        let usable = values.iter().map(|&v| v.is_finite() && v < limit);
        Self {
            normal,
            usable: usable.collect(),
            values,
        }
    }

    /// Whether no channel is clipped.
    pub fn is_whole(&self) -> bool {
        !self.usable.contains(&false)
    }

    /// Sum of the channels.
    pub fn brightness(&self) -> f64 {
        self.values.iter().sum()
    }

    /// In another frame, divided by a gain per channel.
    pub fn turned(&self, rotation: &UnitQuaternion<f64>, gain: &[f64]) -> Self {
        Self {
            normal: rotation * self.normal,
            values: self.values.iter().zip(gain).map(|(v, g)| v / g).collect(),
            usable: self.usable.clone(),
        }
    }
}
