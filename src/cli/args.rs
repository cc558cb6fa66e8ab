//! The arguments of every command.

use super::formats::{ExportFormat, ImportFormat};
use super::parse::{
    export_formats, import_formats, parse_dimensions, parse_known_distance, parse_size, parse_stage,
};
use super::words::{ALIGNMENTS, ENCODINGS, MESH_FORMATS, MODELS, PROJECTIONS, SPLITTINGS, words};
use crate::config::take_over;
use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use clap_complete::Shell;
use rilievo_fusion::{FusionOptions, MeshFormat};
use rilievo_photos::Encoding;
use rilievo_poses::KnownDistance;
use rilievo_scene::StageId;
use rilievo_shading::ShadingModel;
use rilievo_shading::paper::{Projection, Splitting};
use rilievo_synthetic::compare::AlignmentRequest;
use std::path::PathBuf;

/// The photos, and how they were taken.
#[derive(Clone, Debug, Args)]
pub struct PhotoArgs {
    /// A folder of photos, or any number of files
    #[arg(required = true, value_name = "PHOTOS")]
    pub photos: Vec<PathBuf>,
    /// Reads the folders inside a folder too (100CANON, 101CANON); their photos are called by the path below it
    #[arg(long)]
    pub recursive: bool,
    /// Cameras: cameras.json, the folder of a COLMAP model, or another program's file
    #[arg(long, value_name = "FILE|COLMAP_DIR")]
    pub cameras: Option<PathBuf>,
    #[command(flatten)]
    pub encoding: EncodingArgs,
}

/// How images are decoded.
#[derive(Clone, Debug, Args)]
pub struct EncodingArgs {
    /// How samples relate to light
    #[arg(long, value_name = "ENCODING", value_parser = words::<Encoding>(ENCODINGS))]
    pub encoding: Option<Encoding>,
}

/// The configuration file.
#[derive(Clone, Debug, Args)]
pub struct ConfigArgs {
    /// Options of the stages, as TOML: tables `photos`, `features`, `poses`, `lighting`, `shading`
    /// and `fusion`
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
}

/// `rilievo demo`
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for photos, truth and the run
    #[arg(short, long, value_name = "DIR", default_value = "demo")]
    pub output: PathBuf,
    /// Another seed is another object
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub work: WorkArgs,
}

/// What is said of the reference sphere.
#[derive(Clone, Debug, Args)]
pub struct SphereArgs {
    /// Reference sphere: its file, `auto` to find it, or `none`
    #[arg(long, value_name = "FILE|auto|none", default_value = "none")]
    pub sphere: PathBuf,
    /// Radius of the reference sphere
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub sphere_radius: Option<f64>,
}

/// `rilievo check`
#[derive(Debug, Args)]
pub struct CheckArgs {
    #[command(flatten)]
    pub input: PhotoArgs,
    /// Folder of object masks (white on black), named as the photos
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    #[command(flatten)]
    pub sphere: SphereArgs,
    #[command(flatten)]
    pub config: ConfigArgs,
    #[command(flatten)]
    pub work: WorkArgs,
}

/// `rilievo mask`
#[derive(Debug, Args)]
pub struct MaskArgs {
    #[command(flatten)]
    pub input: PhotoArgs,
    /// Folder for the masks; pictures to look at go to DIR-overlays
    #[arg(short, long, value_name = "DIR", default_value = "masks")]
    pub output: PathBuf,
    /// A run of these photos whose poses show the object, at least until stage 3. Without it, masks
    /// are sought before a plain backdrop, and where there is none by poses found in DIR-run
    #[arg(long, value_name = "RUN", conflicts_with = "cameras")]
    pub run: Option<PathBuf>,
    /// Writes over masks that are there already
    #[arg(long)]
    pub overwrite: bool,
    #[command(flatten)]
    pub work: WorkArgs,
}

/// `rilievo import`
#[derive(Debug, Args)]
pub struct ImportArgs {
    /// Another program's cameras: a file or a folder; or an object of DiLiGenT or DiLiGenT-MV
    pub source: PathBuf,
    /// Its format; found out by default. npz is that of IDR and NeuS, transforms of nerfstudio and
    /// instant-ngp, sfmdata of AliceVision
    #[arg(long, value_name = "FORMAT", value_parser = import_formats())]
    pub format: Option<ImportFormat>,
    /// The file to write (cameras.json by default), for diligent the folder (diligent by default)
    #[arg(short, long, value_name = "PATH")]
    pub output: Option<PathBuf>,
    /// Folder of the photos. middlebury, npz and others leave out the photos' size, which is read from the
    /// photos then: those in this folder, else those beside the source
    #[arg(long, value_name = "DIR")]
    pub photos: Option<PathBuf>,
    /// Replaces files that are there already
    #[arg(long)]
    pub overwrite: bool,
    /// diligent: the lamp to see the object by, counted from 1; the mean over all lamps by default
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub lamp: Option<u16>,
}

/// `rilievo export`
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// A run directory, or a camera file
    pub source: PathBuf,
    /// The format to write; lp writes a run's lighting, the others cameras. npz is that of IDR
    /// and NeuS, transforms of nerfstudio and instant-ngp, sfmdata of AliceVision; blender is a
    /// script that makes the cameras there
    #[arg(long, value_name = "FORMAT", value_parser = export_formats())]
    pub format: ExportFormat,
    /// The file or folder to write
    #[arg(short, long, value_name = "PATH")]
    pub output: PathBuf,
    /// Replaces files that are there already
    #[arg(long)]
    pub overwrite: bool,
}

/// How to work, without any effect on results as long as the memory suffices.
#[derive(Clone, Debug, Args)]
pub struct WorkArgs {
    /// Number of threads; all cores by default. Results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Bounds how many photos are read or searched for keypoints at once (at least one; half of the
    /// free memory by default), how many images stage 3 holds for anchors, what stage 5 works on at
    /// once, and what stage 6 takes for cloud and mesh (4G by default), as 4G or 800M. Stages 5 and
    /// 6 report what they need where that is more; stage 4 takes what a photo asks
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub memory: Option<u64>,
    /// One JSON object a line on stdout
    #[arg(long)]
    pub json: bool,
}

impl WorkArgs {
    /// Gives fusion the memory that was asked for.
    pub fn bound(&self, options: &mut FusionOptions) {
        if let Some(bytes) = self.memory {
            options.memory_mib = ((bytes >> 20) as usize).max(FusionOptions::MIN_MEMORY_MIB);
        }
    }
}

/// `rilievo reconstruct`
#[derive(Debug, Args)]
pub struct ReconstructArgs {
    #[command(flatten)]
    pub input: PhotoArgs,
    /// Run directory: results, and what is needed to go on from there
    #[arg(short, long, value_name = "RUN")]
    pub output: PathBuf,
    /// Folder of object masks (white on black), named as the photos; `none` takes the whole frame.
    /// Without it, masks are proposed after stage 3 and used where they are sure: RUN/masks, with
    /// pictures to look at in RUN/masks-overlays. Where the object turns before a background that stands still,
    /// features.region = "object" (--config) finds the poses from what the masks show alone
    #[arg(long, value_name = "DIR|none")]
    pub masks: Option<PathBuf>,
    #[command(flatten)]
    pub sphere: SphereArgs,
    /// Distance between the camera centres of two photos: makes the model metric without a sphere.
    /// Between marked points instead: table `poses.known_distance` of the config file
    #[arg(long, value_name = "PHOTO,PHOTO,METRES", value_parser = parse_known_distance)]
    pub known_distance: Option<KnownDistance>,
    /// Known lighting; NAME picks one of several in the file
    #[arg(long, value_name = "FILE[:NAME]", conflicts_with = "lighting_shape")]
    pub lighting: Option<String>,
    /// Use a given light, or a calibration photo's, also where the photos contradict it
    #[arg(long)]
    pub trust_lighting: bool,
    /// Fit the lighting on known depth maps, DIR/NAME_depth.exr
    #[arg(long, value_name = "DIR")]
    pub lighting_shape: Option<PathBuf>,
    /// What explains the photos: photo (visibility and the photos' agreement) or paper
    #[arg(long, value_name = "MODEL", value_parser = words::<ShadingModel>(MODELS))]
    pub model: Option<ShadingModel>,
    /// Puts the world where another run, or cameras of the same photos, have it; by default a run that is done once
    /// more, with a photo more, keeps its own where the cameras in common agree
    #[arg(long, value_name = "RUN|CAMERAS")]
    pub frame_of: Option<PathBuf>,
    /// Which pairs of photos are matched: auto (all of up to 20 photos, else those that look alike
    /// and those that follow from what matched), all, sequential (neighbours in the order of
    /// names), or a file of pairs: two file names a line, separated by a comma or white space.
    /// [default: auto]
    #[arg(long, value_name = "all|auto|sequential|FILE")]
    pub pairs: Option<PathBuf>,
    #[command(flatten)]
    pub surface: SurfaceArgs,
    #[command(flatten)]
    pub config: ConfigArgs,
    /// Replaces the results of other photos in RUN
    #[arg(long)]
    pub overwrite: bool,
    /// Ends with exit code 4 where the verdict is that the result is not to be trusted
    #[arg(long)]
    pub strict: bool,
    /// Redo from this stage on, valid or not
    #[arg(long, value_name = "STAGE", value_parser = parse_stage)]
    pub from: Option<StageId>,
    /// Stop after this stage
    #[arg(long, value_name = "STAGE", value_parser = parse_stage)]
    pub until: Option<StageId>,
    #[command(flatten)]
    pub work: WorkArgs,
}

/// What the fused surface shall be like.
#[derive(Clone, Debug, Args)]
pub struct SurfaceArgs {
    /// Distance between the points of the cloud, in metres (the cameras' unit where it is another);
    /// by default about one point a pixel of the best view, or as fine as the relief that the photos
    /// resolve. It thins the cloud only: the mesh keeps its resolution
    #[arg(long, value_name = "LENGTH")]
    pub spacing: Option<f64>,
    /// Leaves about N triangles of the mesh, such as 200000 for the web and phones; its vertices
    /// keep the normals of the dense mesh. By default flat places are coarser, as far as that moves
    /// the surface by no more than a tenth of a pixel
    #[arg(long, value_name = "N", conflicts_with = "full", value_parser = RangedU64ValueParser::<usize>::new().range(100..))]
    pub triangles: Option<usize>,
    /// Keeps all triangles of the mesh and all points of the cloud, as fine as the photos' pixels
    /// everywhere
    #[arg(long)]
    pub full: bool,
    /// Closes the mesh where no view saw anything
    #[arg(long)]
    pub watertight: bool,
    /// Triangles of the asset, the light mesh with textures. [default: 100000]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(100..=10_000_000))]
    pub faces: Option<usize>,
    /// Largest side of the asset's textures; they are smaller where the photos show no more.
    /// [default: 4096]
    #[arg(long, value_name = "TEXELS", value_parser = RangedU64ValueParser::<usize>::new().range(64..=16_384))]
    pub texture: Option<usize>,
    /// Formats of the mesh, separated by commas. ply is always there. [default: ply,asset]
    #[arg(long, value_name = "FORMATS", value_delimiter = ',', value_parser = words::<MeshFormat>(MESH_FORMATS))]
    pub formats: Option<Vec<MeshFormat>>,
}

impl SurfaceArgs {
    /// Takes over what the command line says.
    pub fn apply(&self, options: &mut FusionOptions) {
        take_over(&mut options.spacing, self.spacing);
        options.watertight |= self.watertight;
        options.full |= self.full;
        take_over(&mut options.max_num_triangles, self.triangles);
        take_over(&mut options.asset_faces, self.faces);
        take_over(&mut options.asset_texture, self.texture);
        take_over(&mut options.formats, self.formats.clone());
    }
}

/// `rilievo fuse`
#[derive(Debug, Args)]
pub struct FuseArgs {
    /// Folder of the maps: COLMAP's dense workspace, OpenMVS's *.dmap, or OpenEXR (depth/NAME.exr
    /// with normal/NAME.exr, or NAME_depth.exr with NAME_normal.exr)
    #[arg(value_name = "MAPS")]
    pub maps: PathBuf,
    /// Cameras of the maps, where they do not lie beside them
    #[arg(long, value_name = "FILE|COLMAP_DIR")]
    pub cameras: Option<PathBuf>,
    /// Photos, for the colours
    #[arg(long, value_name = "DIR")]
    pub photos: Option<PathBuf>,
    /// Metres in one unit of the maps and cameras, where they do not say
    #[arg(long, value_name = "METRES")]
    pub scale: Option<f64>,
    #[command(flatten)]
    pub surface: SurfaceArgs,
    #[command(flatten)]
    pub config: ConfigArgs,
    /// Writes over files in DIR that no earlier `rilievo fuse` wrote
    #[arg(long)]
    pub overwrite: bool,
    /// Folder for cloud.ply, mesh.ply, asset.glb, asset/, report.json, and mesh.obj, mesh.glb where asked for
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    #[command(flatten)]
    pub work: WorkArgs,
}

/// `rilievo run`
#[derive(Debug, Args)]
pub struct RunArgs {
    /// The stage: 5_shading, 5 or shading
    #[arg(value_parser = parse_stage)]
    pub stage: StageId,
    /// The run directory
    pub run: PathBuf,
    #[command(flatten)]
    pub work: WorkArgs,
}

/// `rilievo status`
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// The run directory
    pub run: PathBuf,
    /// Reads every file and compares it with what was written
    #[arg(long)]
    pub verify: bool,
    /// As JSON
    #[arg(long)]
    pub json: bool,
}

/// `rilievo why`, `rilievo clean`
#[derive(Debug, Args)]
pub struct StageArgs {
    /// The run directory
    pub run: PathBuf,
    /// The stage: 5_shading, 5 or shading
    #[arg(value_parser = parse_stage)]
    pub stage: StageId,
}

/// `rilievo shade`
#[derive(Debug, Args)]
pub struct ShadeArgs {
    /// Several views to be solved together
    #[arg(value_name = "SCENE.json")]
    pub scene: Option<PathBuf>,
    /// Image of a single view
    #[arg(long, value_name = "F", conflicts_with = "scene", requires = "camera")]
    pub image: Option<PathBuf>,
    /// Its mask; the whole frame by default. With a scene of one view, instead of the scene's
    #[arg(long, value_name = "F")]
    pub mask: Option<PathBuf>,
    /// Its camera
    #[arg(long, value_name = "F", conflicts_with = "scene")]
    pub camera: Option<PathBuf>,
    /// Lighting; fitted on the initial or prior shape by default
    #[arg(long, value_name = "FILE[:NAME]")]
    pub lighting: Option<String>,
    /// Start: a depth map, a plane, or the matches
    #[arg(long, value_name = "DEPTH.exr|plane|anchors")]
    pub init: Option<String>,
    /// Measured depth that is to be refined. With a scene of one view, instead of the scene's
    #[arg(long, value_name = "DEPTH.exr")]
    pub prior: Option<PathBuf>,
    /// Weight of the prior: squared difference of log depths against squared intensities
    #[arg(long, value_name = "W", default_value_t = 500.0)]
    pub prior_weight: f64,
    /// Weight of the surface's area; 0 by default
    #[arg(long, value_name = "W")]
    pub area_weight: Option<f64>,
    /// How slopes and depth are separated: full, as in the paper, or not at all
    #[arg(long, value_name = "SPLITTING", value_parser = words::<Splitting>(SPLITTINGS))]
    pub splitting: Option<Splitting>,
    /// Order of the harmonics
    #[arg(long, value_name = "1|2", value_parser = clap::value_parser!(u8).range(1..=2))]
    pub order: Option<u8>,
    /// How a pixel's ray is modelled
    #[arg(long, value_name = "PROJECTION", value_parser = words::<Projection>(PROJECTIONS))]
    pub projection: Option<Projection>,
    #[command(flatten)]
    pub encoding: EncodingArgs,
    #[command(flatten)]
    pub config: ConfigArgs,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    #[command(flatten)]
    pub work: WorkArgs,
}

/// `rilievo evaluate`
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// The run directory
    pub run: PathBuf,
    /// Folder with cameras.json, NAME_depth.exr, NAME_normal.exr, mesh.ply
    #[arg(long, value_name = "DIR", required_unless_present = "halves")]
    pub truth: Option<PathBuf>,
    /// Without a truth: shapes two halves of the photos, each alone, and reports by wavelength what
    /// relief both find; as long as stage 5
    #[arg(long, conflicts_with_all = ["truth", "align"])]
    pub halves: bool,
    /// How the frames are brought together before comparing
    #[arg(long, value_name = "ALIGNMENT", default_value = "auto", value_parser = words::<AlignmentRequest>(ALIGNMENTS))]
    pub align: AlignmentRequest,
    /// As JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// `rilievo synth`
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// Folder to write: photos, masks, sphere masks, truth
    pub output: PathBuf,
    /// Number of photos [default: as `--config` says, else 6]
    #[arg(long, value_name = "N")]
    pub views: Option<usize>,
    /// Size of the photos [default: as `--config` says, else 640x480]
    #[arg(long, value_name = "WxH", value_parser = parse_dimensions)]
    pub size: Option<(usize, usize)>,
    /// Another seed is another object [default: as `--config` says, else 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Windows and lamps this far from the middle of the object, which is .24 m tall [default: as `--config` says, else endlessly far]
    #[arg(long, value_name = "METRES")]
    pub near: Option<f64>,
    /// Sheen of the object, 0 (matte) to 1 (glazed) [default: as `--config` says, else 0]
    #[arg(long, value_name = "SHARE")]
    pub gloss: Option<f64>,
    /// Format of the photos
    #[arg(long, value_enum, default_value_t = SynthFormat::Jpeg)]
    pub format: SynthFormat,
    /// A mesh to photograph instead of a made object: z up, front towards -y, of any size
    #[arg(long, value_name = "FILE.ply")]
    pub mesh: Option<PathBuf>,
    /// Options of scene and photographs, as TOML: tables `scene` and `photographs`; options given
    /// here go before it
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// One JSON object a line on stdout
    #[arg(long)]
    pub json: bool,
}

/// `--format` of `rilievo synth`
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SynthFormat {
    /// 8 bits with the sRGB curve, as a camera writes them
    Jpeg,
    /// Linear, 16 bits
    Tiff,
    /// Linear, 16 bits
    Png,
    /// Linear, 32-bit floating point, not clipped
    Exr,
    /// Camera RAW: one colour a pixel, 14 bits
    Dng,
}

/// `rilievo completions`
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    pub shell: Shell,
}

/// `rilievo man`
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for one page per command: rilievo.1, rilievo-reconstruct.1 and so on
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Replaces other pages of these names
    #[arg(long, requires = "output")]
    pub overwrite: bool,
}
