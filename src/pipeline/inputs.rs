//! The files that a request names, found and checked before anything is computed.

use super::photo_files::{PhotoFile, photo_files};
use super::request::{LightingInput, Request};
use super::spheres::SphereInputs;
use crate::exit::{Failure, Problem};
use crate::paths::text_of;
use crate::store::{hash_file, hash_json};
use rayon::prelude::*;
use rilievo_io::{
    CameraEntry, CameraFile, CameraFormat, IoError, MaskNames, import_cameras, read_cameras,
    read_lighting,
};
use rilievo_poses::ReferenceFrame;
use rilievo_scene::{
    RigidTransform, StageId, Unit, WorldCoordinates, artifact_name, first_and_more,
};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};

/// One photo file with what belongs to it.
#[derive(Clone, Debug)]
pub struct PhotoInput {
    pub path: PathBuf,
    /// Its name with ending, of one in a subfolder its path below the folder that was given.
    pub file_name: String,
    /// [`artifact_name`] of that.
    pub name: String,
    /// Content hash.
    pub hash: String,
    /// Its mask with content hash, where masks were given.
    pub mask: Option<(PathBuf, String)>,
    /// Its camera, where cameras were given.
    pub camera: Option<CameraEntry>,
}

/// Everything that comes from outside the run directory.
#[derive(Clone, Debug)]
pub struct Inputs {
    /// Photos, ordered by file name.
    pub photos: Vec<PhotoInput>,
    /// Photos that cannot be read; the others go on without them.
    pub unreadable: Vec<Problem>,
    /// Files that were passed over because they are no photos.
    pub skipped: Vec<Problem>,
    /// Things that the user should know (cameras of photos that are not there).
    pub warnings: Vec<String>,
    /// What the coordinates of given cameras mean here: metres, where they state a unit of length.
    pub given_world: WorldCoordinates,
    /// The unit in which they were given.
    pub given_unit: Unit,
    /// Cameras whose frame is to be taken over.
    pub frame_of: Option<ReferenceFrame>,
    /// What was said of the reference spheres.
    pub spheres: SphereInputs,
    /// Content hashes of the lighting's files, by role.
    pub lighting_hashes: BTreeMap<String, String>,
}

impl Inputs {
    /// Finds the files of a request and their content hashes.
    ///
    /// # Errors
    /// [`Failure::Input`] with every file that makes the request impossible.
    pub fn scan(request: &Request) -> Result<Self, Failure> {
        let (files, skipped) = photo_files(request)?;
        let mut cameras = request.cameras.as_deref().map(any_cameras).transpose()?;
        let given_unit = cameras
            .as_ref()
            .map_or(Unit::Arbitrary, |cameras| cameras.unit);
        if let Some(cameras) = &mut cameras {
            cameras.to_metres();
        }
        let masks = request.masks.as_deref().map(MaskFolder::open).transpose()?;
        let (mut photos, unreadable) = photo_inputs(files, cameras.as_ref(), masks.as_ref())?;
        let of_masks = |photo: &PhotoInput| photo.mask.as_ref().map(|(path, _)| path.clone());
        refuse_shared(&photos, "mask", of_masks)?;
        let of_cameras =
            |photo: &PhotoInput| photo.camera.as_ref()?.image.clone().map(PathBuf::from);
        refuse_shared(&photos, "camera", of_cameras)?;
        let given_world = match &cameras {
            Some(cameras) => localized(&mut photos, cameras),
            None => Unit::Arbitrary.into(),
        };
        let mut warnings = Vec::new();
        if let (Some(cameras), Some(path)) = (&cameras, &request.cameras) {
            warnings.extend(without_camera(&photos, cameras, path)?);
        }
        warnings.extend(twins(&photos));
        let spheres = SphereInputs::scan(&request.sphere)?;
        let lighting_hashes = lighting_inputs(&request.lighting, &photos)?;
        Ok(Self {
            photos,
            unreadable,
            skipped,
            warnings,
            given_world,
            given_unit,
            frame_of: request.frame_of.as_deref().map(frame_of).transpose()?,
            spheres,
            lighting_hashes,
        })
    }

    /// What decides a photo's share of stage 1, apart from options.
    pub fn photo_hash(photo: &PhotoInput) -> String {
        let camera = photo.camera.as_ref().map(|camera| {
            let pose = camera.cam_from_world;
            (camera.intrinsics, pose)
        });
        let mask = photo.mask.as_ref().map(|(_, hash)| hash);
        hash_json(&(&photo.file_name, &photo.hash, mask, camera))
    }
}

/// The photos that can be read, ordered by file name, with their masks and cameras; and those that
/// cannot.
fn photo_inputs(
    files: Vec<PhotoFile>,
    cameras: Option<&CameraFile>,
    masks: Option<&MaskFolder>,
) -> Result<(Vec<PhotoInput>, Vec<Problem>), Failure> {
    let cameras = cameras.map(CameraFile::index);
    let mut problems = Vec::new();
    let mut unreadable = Vec::new();
    let mut photos = Vec::with_capacity(files.len());
    let mut by_name = BTreeMap::<String, PathBuf>::new();
    let hashes: Vec<_> = files.par_iter().map(|file| hash_file(&file.path)).collect();
    for (file, hash) in files.into_iter().zip(hashes) {
        // Without one, it may also be the photo's own alpha channel, which only decoding shows.
        let mask = masks.and_then(|folder| folder.find(&file));
        let PhotoFile {
            path,
            name: file_name,
        } = file;
        let name = artifact_name(&file_name);
        if let Some(other) = by_name.insert(name.clone(), path.clone()) {
            problems.push(Problem {
                file: path,
                reason: format!(
                    "has the same name as {}; names tell results apart, so rename one, or give the folder above both \
                     and --recursive",
                    other.display()
                ),
            });
            continue;
        }
        let hash = match (hash, unfit_name(&name)) {
            (Ok(hash), None) => hash,
            (Err(error), _) => {
                let reason = format!("cannot be read: {}", error.reason);
                unreadable.push(Problem { file: path, reason });
                continue;
            }
            (_, Some(reason)) => {
                unreadable.push(Problem { file: path, reason });
                continue;
            }
        };
        let hashed = |mask: PathBuf| hash_file(&mask).map(|hash| (mask, hash));
        let mask = mask.map(hashed).transpose()?;
        let camera = cameras.as_ref();
        let in_folder = || within_folder(&path, &file_name);
        let found =
            camera.and_then(|index| index.find(&file_name).or_else(|| index.find(&in_folder()?)));
        let camera = found.cloned();
        photos.push(PhotoInput {
            path,
            file_name,
            name,
            hash,
            mask,
            camera,
        });
    }
    if !problems.is_empty() {
        problems.extend(unreadable);
        return Err(Failure::Input(problems));
    }
    if photos.is_empty() {
        return Err(Failure::Input(unreadable));
    }
    photos.sort_by(|a, b| a.file_name.cmp(&b.file_name));
    Ok((photos, unreadable))
}

/// A photo's name with the folder that it is in, where its name has none.
fn within_folder(path: &Path, file_name: &str) -> Option<String> {
    let folder = path
        .parent()?
        .file_name()
        .filter(|_| !file_name.contains('/'))?;
    Some(format!("{}/{file_name}", text_of(Some(folder))))
}

/// Refuses a mask or a camera that two photos would have by its name.
fn refuse_shared(
    photos: &[PhotoInput],
    what: &str,
    of: impl Fn(&PhotoInput) -> Option<PathBuf>,
) -> Result<(), Failure> {
    let mut owners = BTreeMap::<PathBuf, &str>::new();
    for photo in photos {
        let Some(own) = of(photo) else { continue };
        if let Some(other) = owners.insert(own.clone(), &photo.file_name) {
            let reason = format!(
                "is by its name the {what} of both {other} and {}; name it by the photo's folder too",
                photo.file_name
            );
            return Err(Failure::input(&own, reason));
        }
    }
    Ok(())
}

/// Moves the photos' cameras to a local frame near them, wherever others of the file stand; what its coordinates mean.
fn localized(photos: &mut [PhotoInput], cameras: &CameraFile) -> WorldCoordinates {
    let given = photos.iter_mut().filter_map(|photo| photo.camera.as_mut());
    let mut poses: Vec<&mut RigidTransform> = given
        .filter_map(|camera| camera.cam_from_world.as_mut())
        .collect();
    let world = cameras.local_world(poses.iter().map(|pose| **pose), [0.0; 3]);
    for pose in &mut poses {
        **pose = pose.with_origin_at(world.offset);
    }
    world
}

/// A warning of the photos that a camera file says nothing of.
fn without_camera(
    photos: &[PhotoInput],
    cameras: &CameraFile,
    path: &Path,
) -> Result<Option<String>, Failure> {
    let without: Vec<&str> = photos
        .iter()
        .filter(|photo| photo.camera.is_none())
        .map(|photo| photo.file_name.as_str())
        .collect();
    if without.len() == photos.len() {
        return Err(Failure::input(
            path,
            format!(
                "none of its {} cameras belongs to a photo; the key \"image\" must be a photo's \
                 file name",
                cameras.cameras.len()
            ),
        ));
    }
    Ok((!without.is_empty()).then(|| {
        format!(
            "the camera file has no entry for {}: their focal length comes from EXIF or is guessed",
            first_and_more(without).unwrap_or_default()
        )
    }))
}

/// Cameras of any format that its name and first words show.
fn any_cameras(path: &Path) -> Result<CameraFile, IoError> {
    match CameraFormat::detect(path) {
        Some(format) => import_cameras(path, format, None),
        None => read_cameras(path),
    }
}

/// The frame of the cameras of a run, or of a file.
fn frame_of(path: &Path) -> Result<ReferenceFrame, IoError> {
    let of_run = path.join(StageId::Poses.name()).join("cameras.json");
    let mut cameras = match of_run.is_file() {
        true => read_cameras(&of_run),
        false => any_cameras(path),
    }?;
    cameras.to_metres();
    let world = cameras.localize([0.0; 3]);
    let posed = cameras.cameras.into_iter();
    let posed = posed.filter_map(|camera| Some((camera.image?, camera.cam_from_world?)));
    Ok(ReferenceFrame {
        cameras: posed.collect(),
        world,
        knows_object: true,
        is_asked: true,
    })
}

/// The folder of masks with the names of its files.
struct MaskFolder {
    names: MaskNames,
    files: BTreeMap<String, PathBuf>,
}

impl MaskFolder {
    fn open(folder: &Path) -> Result<Self, Failure> {
        let mut files = BTreeMap::new();
        files_below(folder, "", &mut files)
            .map_err(|error| Failure::input(folder, format!("cannot be read: {error}")))?;
        if files.is_empty() {
            return Err(Failure::input(folder, "the folder of masks is empty"));
        }
        Ok(Self {
            names: MaskNames::new(files.keys()),
            files,
        })
    }

    /// The mask of a photo by its name, which may carry folders; without any, the folder that it is in distinguishes
    /// two masks of one name.
    fn find(&self, photo: &PhotoFile) -> Option<PathBuf> {
        let within = photo.path.parent().and_then(Path::file_name);
        let name = self.names.find(&photo.name, &text_of(within))?;
        self.files.get(name).cloned()
    }
}

/// Files of a folder and of the folders inside it, links to folders left out, by their path below it.
fn files_below(
    folder: &Path,
    prefix: &str,
    files: &mut BTreeMap<String, PathBuf>,
) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)?.flatten() {
        let name = format!("{prefix}{}", text_of(Some(&entry.file_name())));
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            // One that cannot be read holds no mask that can be.
            let _ = files_below(&entry.path(), &format!("{name}/"), files);
        } else {
            files.insert(name, entry.path());
        }
    }
    Ok(())
}

/// Photos of one content: they add nothing, and are likely copied by mistake.
fn twins(photos: &[PhotoInput]) -> Vec<String> {
    let mut by_content = BTreeMap::<&str, &str>::new();
    let mut warnings = Vec::new();
    for photo in photos {
        match by_content.entry(&photo.hash) {
            Entry::Vacant(slot) => {
                slot.insert(&photo.file_name);
            }
            Entry::Occupied(first) => warnings.push(format!(
                "{} has the same content as {}: one of them is a copy and adds nothing",
                photo.file_name,
                first.get()
            )),
        }
    }
    warnings
}

fn lighting_inputs(
    lighting: &LightingInput,
    photos: &[PhotoInput],
) -> Result<BTreeMap<String, String>, Failure> {
    let mut hashes = BTreeMap::new();
    match lighting {
        LightingInput::Found => {}
        LightingInput::File { path, name } => {
            let file = read_lighting(path, name.as_deref())?;
            if !photos
                .iter()
                .any(|photo| file.for_view(&photo.name).is_some())
            {
                return Err(Failure::input(
                    path,
                    "holds no lighting of any photo; its views go by the photos' names (--lighting)",
                ));
            }
            hashes.insert("lighting file".into(), hash_file(path)?);
            if let Some(name) = name {
                hashes.insert("lighting name".into(), name.clone());
            }
        }
        LightingInput::Shape { folder } => {
            let mut found = 0;
            for photo in photos {
                let file = shape_file(folder, &photo.name);
                if file.exists() {
                    found += 1;
                    let role = format!("shape of {}", photo.name);
                    hashes.insert(role, hash_file(&file)?);
                }
            }
            if found == 0 {
                return Err(Failure::input(
                    folder,
                    "holds no NAME_depth.exr of any photo (--lighting-shape)",
                ));
            }
        }
    }
    Ok(hashes)
}

/// Depth map of a photo in the folder of `--lighting-shape`.
pub fn shape_file(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}_depth.exr"))
}

/// Longest name without ending, bytes: file systems take 255 with the longest ending of a result.
const MAX_NAME_BYTES: usize = 255 - ".json".len();

/// Why results cannot be called by a photo's name.
fn unfit_name(name: &str) -> Option<String> {
    if name.len() > MAX_NAME_BYTES {
        return Some(format!(
            "its name has {} bytes; results are called by it, which takes {MAX_NAME_BYTES} at most: \
             rename the photo",
            name.len()
        ));
    }
    name.contains(char::is_control).then(|| {
        "its name holds a control character, which lists of photos cannot: rename the photo"
            .to_owned()
    })
}
