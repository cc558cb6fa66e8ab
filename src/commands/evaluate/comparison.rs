//! A run beside its truth: what is measured between them, and where it is shown.

use super::estimate::Estimate;
use super::optional_file::read_if_there;
use super::table::table;
use super::truth::Truth;
use super::{appearance, errors};
use crate::exit::Failure;
use crate::report;
use crate::store::{create_folder, deviation_file, drop_evaluation};
use rilievo_io::read_cloud_ply;
use rilievo_scene::{Mesh, PointCloud, RigidTransform};
use rilievo_synthetic::compare::{
    self, AlignmentRequest, Evaluation, PixelErrors, TrueSurface, TruthView, compare_maps,
};
use std::path::{Path, PathBuf};

/// A run beside the truth. The run's maps stay on the disk: they are read view by view.
pub struct Comparison {
    /// The run's directory.
    pub(super) run: PathBuf,
    /// What it holds.
    pub(super) estimate: Estimate,
    pub(super) truth: Truth,
    request: AlignmentRequest,
    /// Whether that follows from worlds that lie far apart.
    is_apart: bool,
    /// Truth of the views that have any.
    pub(super) views: Vec<TruthView>,
    /// The run's cloud, if there is one.
    pub(super) cloud: Option<PointCloud>,
    /// The true surface, if there is one.
    pub(super) surface: Option<Mesh>,
}

impl Comparison {
    /// Reads what both hold.
    pub fn open(run: &Path, truth: &Path, request: AlignmentRequest) -> anyhow::Result<Self> {
        let estimate = Estimate::open(run)?;
        let offset = estimate.world.map(|world| world.offset);
        let is_fixed = request == AlignmentRequest::None;
        let truth = Truth::open(truth, offset, is_fixed)?;
        // Two local frames whose worlds lie far apart are not one, however alike their numbers are.
        let is_apart = request == AlignmentRequest::Auto
            && offset.is_some_and(|offset| offset != truth.offset);
        let request = if is_apart {
            AlignmentRequest::Sim3
        } else {
            request
        };
        Ok(Self {
            run: run.to_path_buf(),
            views: truth.views(&estimate.expected)?,
            cloud: read_if_there(&estimate.cloud, read_cloud_ply)?,
            surface: truth.surface()?,
            estimate,
            truth,
            request,
            is_apart,
        })
    }

    /// The numbers.
    ///
    /// # Errors
    /// When a map cannot be read, or what was asked for cannot be aligned.
    pub fn measure(&self) -> anyhow::Result<Evaluation> {
        let posed: Vec<(RigidTransform, &TruthView)> = self
            .views
            .iter()
            .filter_map(|view| Some((self.truth.cameras.find(&view.name)?.cam_from_world?, view)))
            .collect();
        let pair = match (&self.cloud, &self.surface) {
            (Some(cloud), Some(mesh)) => Ok((
                cloud.points.as_slice(),
                TrueSurface {
                    mesh,
                    views: &posed,
                    threshold: None,
                },
            )),
            (None, _) => Err(format!("there is no {}", self.estimate.cloud.display())),
            (_, None) => Err(format!(
                "there is no {}",
                self.truth.surface_file().display()
            )),
        };
        // Without any map, a row of nothing for every view would say nothing.
        let has_maps = self.views.iter().any(|v| self.estimate.has_map(&v.name));
        let compared = if has_maps { &self.views[..] } else { &[] };
        // Reading errors inside the comparison are kept here, since it knows only its own.
        let mut unreadable = None;
        let mut evaluation = compare::evaluate(
            (
                &self.estimate.poses,
                &self.truth.poses(&self.estimate.expected),
            ),
            self.truth.cameras.unit,
            self.request,
            |scale| {
                let mut errors: Vec<(String, PixelErrors)> = Vec::new();
                for view in compared {
                    let maps = self
                        .estimate
                        .depth(&view.name)
                        .and_then(|depth| Ok((depth, self.estimate.normal(&view.name)?)));
                    let (depth, normal) = match maps {
                        Ok(maps) => maps,
                        Err(failure) => {
                            unreadable.get_or_insert(failure);
                            (None, None)
                        }
                    };
                    let compared = compare_maps(view, depth.as_ref(), normal.as_ref(), scale)?;
                    errors.push((view.name.clone(), compared));
                }
                Ok(errors)
            },
            pair,
        )
        .map_err(|error| Failure::NoResult(error.to_string()))?;
        if let Some(failure) = unreadable {
            return Err(failure.into());
        }
        if self.is_apart {
            "the worlds of both lie far apart".clone_into(&mut evaluation.alignment_reason);
        }
        if !has_maps && !self.views.is_empty() {
            let reason = "the result has neither depth nor normals of a view that the truth knows";
            evaluation
                .reasons
                .insert("all".to_owned(), reason.to_owned());
        }
        appearance::compare(&self.estimate, &self.truth, &mut evaluation)?;
        Ok(evaluation)
    }

    /// Shows where the errors lie: a section of the run's report, and `evaluation/deviation.ply`.
    /// `note` gets their places.
    pub fn show(&self, evaluation: &Evaluation, note: &dyn Fn(&str)) -> anyhow::Result<()> {
        drop_evaluation(&self.run)?;
        let maps = errors::maps(&self.estimate, &self.views, evaluation.scale)?;
        let deviations = self.write_deviations(evaluation, note)?;
        // Millimetres where the unit is one of length.
        let (factor, unit) = match evaluation.unit.metres() {
            Some(metres) => (1e3 * metres, "mm"),
            None => (1.0, evaluation.unit.words()),
        };
        let sizes: Vec<f64> = deviations.iter().map(|d| factor * d.abs()).collect();
        if report::add_evaluation(&self.run, &table(evaluation), &maps, (&sizes, unit))? {
            note(&format!(
                "{} are in {}",
                if maps.is_empty() {
                    "these numbers"
                } else {
                    "error maps"
                },
                self.run.join("report.html").display()
            ));
        }
        Ok(())
    }

    /// Writes the cloud coloured by its signed distance from the truth; those distances, none where there is no cloud
    /// or no true surface, or where these lie apart.
    fn write_deviations(
        &self,
        evaluation: &Evaluation,
        note: &dyn Fn(&str),
    ) -> anyhow::Result<Vec<f64>> {
        let (Some(cloud), Some(surface), Some(compared)) =
            (&self.cloud, &self.surface, &evaluation.cloud)
        else {
            return Ok(Vec::new());
        };
        if compared.apart.is_some() {
            return Ok(Vec::new());
        }
        let poses = self.truth.poses(&self.estimate.expected);
        let similarity = compare::align(&self.estimate.poses, &poses, self.request)
            .map_err(|error| Failure::NoResult(error.to_string()))?;
        let max = compared.threshold;
        let deviations = errors::deviations(cloud, surface, &similarity, max / 3.0);
        let path = deviation_file(&self.run);
        let folder = path.parent().unwrap_or(&self.run);
        create_folder(folder)?;
        let world = self.estimate.world.unwrap_or_default();
        errors::write_deviations(&path, cloud, &deviations, max, world)?;
        note(&format!(
            "signed distances of the cloud, blue inside to red outside at {}, are in {}",
            evaluation.unit.length(max, 2),
            path.display()
        ));
        Ok(deviations)
    }
}
