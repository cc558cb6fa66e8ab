//! NumPy arrays as the library's rasters, and back. What does not fit is refused by the argument's name.
//!
//! Values are copied while Python's lock is held: another thread of the caller may change an array afterwards.

use crate::failures::{unusable, wrong_type};
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rilievo::embedded::{DepthMap, LinearImage, Mask, NormalMap, Raster, Samples};

/// An argument with the name by which it is refused.
pub struct Argument<'a, 'py> {
    /// Its name, as the caller knows it.
    pub name: String,
    /// Its value.
    pub value: &'a Bound<'py, PyAny>,
}

/// Columns and rows.
pub type Size = (usize, usize);

impl<'py> Argument<'_, 'py> {
    fn py(&self) -> Python<'py> {
        self.value.py()
    }

    /// What it is in words, for a refusal.
    fn words(&self) -> String {
        match self.value.cast::<PyUntypedArray>() {
            Ok(array) => {
                let shape: Vec<String> = array.shape().iter().map(usize::to_string).collect();
                let dtype = array.dtype().to_string();
                let comma = if shape.len() == 1 { "," } else { "" };
                format!("shape ({}{comma}) and dtype {dtype}", shape.join(", "))
            }
            Err(_) => {
                let name = self.value.get_type().name();
                name.map_or("another type".to_owned(), |name| format!("type {name}"))
            }
        }
    }

    /// The exception for values or a shape.
    pub fn unusable(&self, wanted: &str) -> PyErr {
        let words = self.words();
        unusable(
            self.py(),
            format!("{}: {wanted}; it has {words}", self.name),
        )
    }

    fn wrong_type(&self, wanted: &str) -> PyErr {
        let words = self.words();
        wrong_type(
            self.py(),
            format!("{}: {wanted}; it has {words}", self.name),
        )
    }

    /// The values row by row, where they are of type `T`.
    fn values<T: Element + Clone>(&self) -> PyResult<Option<Vec<T>>> {
        let Ok(array) = self.value.cast::<PyArrayDyn<T>>() else {
            return Ok(None);
        };
        if !array.is_c_contiguous() || !array.is_aligned() {
            let wanted = "its values must lie row by row without gaps; numpy.ascontiguousarray makes such an array";
            return Err(self.unusable(wanted));
        }
        let values = array.to_vec();
        let values = values.map_err(|error| self.unusable(&error.to_string()))?;
        Ok(Some(values))
    }

    /// Values of either floating type, all finite, in single precision.
    fn floats(&self) -> PyResult<Option<Vec<f32>>> {
        let values = match self.values::<f32>()? {
            Some(values) => values,
            None => match self.values::<f64>()? {
                Some(values) => values.into_iter().map(|value| value as f32).collect(),
                None => return Ok(None),
            },
        };
        let num_bad = values.iter().filter(|value| !value.is_finite()).count();
        if num_bad > 0 {
            let wanted = format!("{num_bad} of its values are not finite (NaN or infinite)");
            return Err(self.unusable(&wanted));
        }
        Ok(Some(values))
    }

    /// The shape of an array.
    fn shape(&self) -> PyResult<Vec<usize>> {
        let array = self.value.cast::<PyUntypedArray>();
        let array = array.map_err(|_| self.wrong_type("it must be a numpy.ndarray"))?;
        Ok(array.shape().to_vec())
    }

    /// An image: columns and rows, channels, samples.
    pub fn image(&self) -> PyResult<(Size, usize, Samples)> {
        let (height, width, channels) = match *self.shape()? {
            [height, width] => (height, width, 1),
            [height, width, channels @ (1 | 3)] => (height, width, channels),
            _ => {
                let wanted = "an image has the shape (height, width) or (height, width, 3)";
                return Err(self.unusable(wanted));
            }
        };
        if height == 0 || width == 0 {
            return Err(self.unusable("the image is empty"));
        }
        let samples = if let Some(values) = self.values::<u8>()? {
            Samples::U8(values)
        } else if let Some(values) = self.values::<u16>()? {
            Samples::U16(values)
        } else if let Some(values) = self.floats()? {
            Samples::F32(values)
        } else {
            let wanted =
                "an image is of dtype float32 or float64 (linear, 1 is white), uint8 or uint16";
            return Err(self.wrong_type(wanted));
        };
        Ok(((width, height), channels, samples))
    }

    /// Refuses another shape than the image's.
    fn of_size(&self, (width, height): Size) -> PyResult<()> {
        if self.shape()? == [height, width] {
            return Ok(());
        }
        Err(self.unusable(&format!(
            "it must have the image's shape ({height}, {width})"
        )))
    }

    /// A mask of an image.
    pub fn mask(&self, size: Size) -> PyResult<Mask> {
        self.of_size(size)?;
        let data = if let Some(values) = self.values::<bool>()? {
            values
        } else if let Some(values) = self.values::<u8>()? {
            values.into_iter().map(|value| value != 0).collect()
        } else {
            return Err(self.wrong_type("a mask is of dtype bool or uint8"));
        };
        if data.iter().all(|inside| !inside) {
            return Err(self.unusable("no pixel is inside this mask"));
        }
        self.raster(size, data)
    }

    /// A depth map of an image.
    pub fn depth(&self, size: Size) -> PyResult<DepthMap> {
        self.of_size(size)?;
        let data = self.floats()?;
        let data = data.ok_or_else(|| self.wrong_type("depth is of dtype float32 or float64"))?;
        if data.iter().any(|&depth| depth < 0.0) {
            return Err(self.unusable("depth is positive, and 0 where there is none"));
        }
        if data.iter().all(|&depth| depth == 0.0) {
            return Err(self.unusable("it has no depth but 0, which is none"));
        }
        self.raster(size, data)
    }

    fn raster<T>(&self, (width, height): Size, data: Vec<T>) -> PyResult<Raster<T>> {
        Raster::from_vec(width, height, data).ok_or_else(|| self.unusable("its size is wrong"))
    }

    /// Rows of `N` numbers in double precision.
    pub fn rows<const N: usize>(&self) -> PyResult<Vec<[f64; N]>> {
        let values = self.values::<f64>()?;
        let values = values.ok_or_else(|| self.wrong_type("it must be of dtype float64"))?;
        let shape = self.shape()?;
        if !matches!(*shape, [_, columns] if columns == N) {
            return Err(self.unusable(&format!("it must have the shape (n, {N})")));
        }
        if !values.iter().all(|value| value.is_finite()) {
            return Err(self.unusable("its values must be finite"));
        }
        Ok(values.as_chunks::<N>().0.to_vec())
    }
}

/// A map as an array of its shape.
pub fn map_array<T: Element>(py: Python<'_>, map: Raster<T>) -> PyResult<Bound<'_, PyAny>> {
    let shape = [map.height, map.width];
    Ok(PyArray1::from_vec(py, map.data).reshape(shape)?.into_any())
}

/// Normals as an array `(height, width, 3)`.
pub fn normal_array(py: Python<'_>, map: NormalMap) -> PyResult<Bound<'_, PyAny>> {
    let shape = [map.height, map.width, 3];
    let values = map.data.into_flattened();
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.into_any())
}

/// An image as an array `(height, width)`, of more channels than one `(height, width, channels)`.
pub fn image_array(py: Python<'_>, image: LinearImage) -> PyResult<Bound<'_, PyAny>> {
    let (height, width, channels) = (image.height, image.width, image.channels);
    let values = PyArray1::from_vec(py, image.data);
    Ok(match channels {
        1 => values.reshape([height, width])?.into_any(),
        _ => values.reshape([height, width, channels])?.into_any(),
    })
}

/// Rows of three values as an array `(n, 3)`.
pub fn triples_array<T: Element>(py: Python<'_>, rows: Vec<[T; 3]>) -> PyResult<Bound<'_, PyAny>> {
    let shape = [rows.len(), 3];
    let values = PyArray1::from_vec(py, rows.into_flattened());
    Ok(values.reshape(shape)?.into_any())
}
