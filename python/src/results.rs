//! A run directory that is read.

use crate::arrays::{image_array, map_array, normal_array, triples_array};
use crate::failures::raised;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use rilievo::embedded::{self, CommandFailure};

/// What a run directory holds.
#[pyclass(frozen)]
pub struct RunResults(pub embedded::RunResults);

impl RunResults {
    /// Reads without Python's lock.
    fn read<T: Send>(
        &self,
        py: Python<'_>,
        read: impl FnOnce(&embedded::RunResults) -> Result<T, CommandFailure> + Send,
    ) -> PyResult<T> {
        let results = &self.0;
        py.detach(|| read(results))
            .map_err(|failure| raised(py, &failure))
    }
}

/// Name, file name, `fx, fy, cx, cy`, `k1, k2, p1, p2, k3`, width and height, pose row by row `(3, 4)`.
type CameraTuple = (
    String,
    String,
    [f64; 4],
    Vec<f64>,
    (usize, usize),
    [[f64; 4]; 3],
);

#[pymethods]
impl RunResults {
    /// The cameras of the photos that have a pose.
    fn cameras(&self, py: Python<'_>) -> PyResult<Vec<CameraTuple>> {
        let cameras = self.read(py, embedded::RunResults::cameras)?;
        let listed = cameras.into_iter().map(|camera| {
            let (i, d) = (&camera.intrinsics, &camera.intrinsics.distortion);
            let mut coefficients = d.numbers().to_vec();
            coefficients.push(f64::from(d.fisheye));
            if d.is_plain() {
                coefficients.truncate(5);
            }
            (
                camera.name,
                camera.file_name,
                [i.fx, i.fy, i.cx, i.cy],
                coefficients,
                (i.width, i.height),
                embedded::pose_rows(&camera.cam_from_world),
            )
        });
        Ok(listed.collect())
    }

    /// Unit of lengths.
    fn unit(&self, py: Python<'_>) -> PyResult<&'static str> {
        self.read(py, embedded::RunResults::unit)
    }

    fn depth<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        map_array(py, self.read(py, |run| run.depth(name))?)
    }

    fn normal<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        normal_array(py, self.read(py, |run| run.normal(name))?)
    }

    fn albedo<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        image_array(py, self.read(py, |run| run.albedo(name))?)
    }

    fn rendered<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        image_array(py, self.read(py, |run| run.rendered(name))?)
    }

    fn confidence<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        map_array(py, self.read(py, |run| run.confidence(name))?)
    }

    /// Positions, normals, colours, confidence and number of views of all points.
    fn cloud<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let points = self.read(py, embedded::RunResults::cloud)?.points;
        let offset = self.read(py, embedded::RunResults::offset)?;
        let positions = points.iter().map(|p| p.position);
        let positions = if offset == [0.0; 3] {
            triples_array(py, positions.collect())?
        } else {
            // Single precision does not hold coordinates far from the origin.
            let in_world = |p: [f32; 3]| [0, 1, 2].map(|k| f64::from(p[k]) + offset[k]);
            triples_array(py, positions.map(in_world).collect())?
        };
        let arrays = [
            positions,
            triples_array(py, points.iter().map(|p| p.normal).collect())?,
            triples_array(py, points.iter().map(|p| p.color).collect())?,
            PyArray1::from_iter(py, points.iter().map(|p| p.confidence)).into_any(),
            PyArray1::from_iter(py, points.iter().map(|p| p.num_views)).into_any(),
        ];
        PyTuple::new(py, arrays)
    }

    /// The text of `report.json`.
    fn report(&self, py: Python<'_>) -> PyResult<String> {
        self.read(py, embedded::RunResults::report)
    }
}
