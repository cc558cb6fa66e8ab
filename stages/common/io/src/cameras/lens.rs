//! Lens models by their coefficients, as `cameras.json`, COLMAP and nerfstudio list them.

use rilievo_scene::Distortion;

/// A model of a lens's distortion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensModel {
    /// k1 k2 p1 p2 k3 k4 k5 k6; missing ones are zero, here and below.
    OpenCv,
    /// k1 k2 k3 k4 of the angle from the axis.
    Fisheye,
    /// k1 k2 p1 p2 k3 k4 sx sy of the angle from the axis.
    ThinPrismFisheye,
}

impl LensModel {
    pub(crate) const ALL: [Self; 3] = [Self::OpenCv, Self::Fisheye, Self::ThinPrismFisheye];

    /// Its name in `cameras.json`.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::OpenCv => "opencv",
            Self::Fisheye => "opencv_fisheye",
            Self::ThinPrismFisheye => "thin_prism_fisheye",
        }
    }

    /// Most coefficients that it takes.
    pub(crate) fn num_coefficients(self) -> usize {
        if self == Self::Fisheye { 4 } else { 8 }
    }

    /// The distortion of the first of its coefficients.
    pub(crate) fn distortion(self, coefficients: &[f64]) -> Distortion {
        let mut all = [0.0; 8];
        for (value, coefficient) in all.iter_mut().zip(coefficients) {
            *value = *coefficient;
        }
        let [k1, k2, p1, p2, k3, k4, k5, k6] = all;
        let plain = Distortion::plain([k1, k2, p1, p2, k3]);
        match self {
            Self::OpenCv => Distortion {
                denominator: [k4, k5, k6],
                ..plain
            },
            Self::Fisheye => Distortion {
                k1,
                k2,
                k3: p1,
                k4: p2,
                fisheye: true,
                ..Distortion::default()
            },
            Self::ThinPrismFisheye => Distortion {
                k4,
                prism: [k5, k6],
                fisheye: true,
                ..plain
            },
        }
    }

    /// The model of a distortion and its coefficients, as few as there can be: five or eight of OpenCV.
    pub(crate) fn of(d: &Distortion) -> (Self, Vec<f64>) {
        let [k4, k5, k6] = d.denominator;
        let [s1, s2] = d.prism;
        if d.is_plain() {
            return (Self::OpenCv, vec![d.k1, d.k2, d.p1, d.p2, d.k3]);
        }
        if !d.fisheye {
            let all = vec![d.k1, d.k2, d.p1, d.p2, d.k3, k4, k5, k6];
            return (Self::OpenCv, all);
        }
        if [d.p1, d.p2, s1, s2] == [0.0; 4] {
            return (Self::Fisheye, vec![d.k1, d.k2, d.k3, d.k4]);
        }
        let all = vec![d.k1, d.k2, d.p1, d.p2, d.k3, d.k4, s1, s2];
        (Self::ThinPrismFisheye, all)
    }
}
