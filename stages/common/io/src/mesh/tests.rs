use super::*;
use crate::error::IoError;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rilievo_scene::{
    Asset, BaseColor, Intrinsics, Mesh, PhotoIdx, PosedView, PosedViews, Raster, RigidTransform,
    Unit, WorldCoordinates, WorldFrame,
};
use std::path::Path;

fn triangle() -> Mesh {
    Mesh {
        vertices: vec![[0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [0.0, 0.25, 1.0]],
        normals: vec![[0.0, 0.0, -1.0]; 3],
        colors: vec![[255, 0, 128]; 3],
        triangles: vec![[0, 2, 1]],
    }
}

/// A camera in the origin that looks along z, its y axis down, as in a world without gravity.
fn views() -> PosedViews {
    PosedViews {
        views: vec![PosedView {
            photo: PhotoIdx(0),
            name: "a".into(),
            file_name: "a.png".into(),
            intrinsics: Intrinsics::pinhole(4, 4, 4.0, 1.5, 1.5),
            cam_from_world: RigidTransform::identity(),
        }],
        ..PosedViews::default()
    }
}

#[test]
fn viewers_get_y_up_and_the_front_towards_them() {
    let frame = ViewerFrame::from_views(&views());
    let expected = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    assert!((frame.rotation - expected).norm() < 1e-12, "{frame:?}");
    // Turned anywhere, the rotation stays one, and up stays up.
    let mut turned = views();
    let rotation = Rotation3::from_euler_angles(0.3, -1.2, 2.0);
    turned.views[0].cam_from_world.rotation = rotation.into();
    let frame = ViewerFrame::from_views(&turned).rotation;
    assert!((frame.determinant() - 1.0).abs() < 1e-12, "{frame}");
    let up = frame * (rotation.inverse() * -Vector3::y());
    assert!((up - Vector3::y()).norm() < 1e-12, "{up}");
    assert_eq!(
        ViewerFrame::from_views(&PosedViews::default()).rotation,
        Matrix3::identity()
    );
    // Of a level world z is up and -y the front, wherever the cameras look.
    turned.frame = WorldFrame::Level;
    let frame = ViewerFrame::from_views(&turned).rotation;
    assert_eq!(frame * Vector3::z(), Vector3::y());
    assert_eq!(frame * -Vector3::y(), Vector3::z());
    assert_eq!(frame.determinant(), 1.0);
}

#[test]
fn glb_holds_what_its_json_says() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.glb");
    let frame = ViewerFrame::from_views(&views());
    write_mesh_glb(&path, &triangle(), Unit::Metre, &frame).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!((word(4), word(8)), (2, bytes.len()));
    let length = word(12);
    assert_eq!((&bytes[16..20], length % 4), (&b"JSON"[..], 0));
    let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let binary = 28 + length;
    assert_eq!(&bytes[24 + length..binary], b"BIN\0");
    assert_eq!(json["buffers"][0]["byteLength"], word(20 + length));
    assert_eq!(binary + word(20 + length), bytes.len());
    assert_eq!(json["asset"]["extras"]["unit"], "metre");
    let offset = |attribute: usize| {
        json["bufferViews"][attribute]["byteOffset"]
            .as_u64()
            .unwrap() as usize
            + binary
    };
    let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    // The third vertex: up in the picture is up in the file.
    let at = offset(0) + 24;
    assert_eq!(
        [float(at), float(at + 4), float(at + 8)],
        [0.0, -0.25, -1.0]
    );
    assert_eq!(float(offset(1) + 8), 1.0, "the normal towards the viewer");
    let color: Vec<u16> = bytes[offset(2)..offset(2) + 8]
        .chunks(2)
        .map(|b| u16::from_le_bytes([b[0], b[1]]))
        .collect();
    // sRGB 128 is linear 0.2159.
    assert_eq!(color, [65535, 0, 14146, 65535]);
    assert_eq!(
        [word(offset(3)), word(offset(3) + 4), word(offset(3) + 8)],
        [0, 2, 1]
    );
    assert_eq!(json["accessors"][0]["max"][0], 0.5);
}

#[test]
fn obj_counts_from_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.obj");
    write_mesh_obj(&path, &triangle(), Unit::Arbitrary).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.starts_with("# unit arbitrary\n"), "{text}");
    assert!(
        text.contains("\nv 0.5 0 1 1.0000 0.0000 0.5020\n"),
        "{text}"
    );
    assert!(text.ends_with("\nf 1//1 3//3 2//2\n"), "{text}");
}

#[test]
fn broken_meshes_and_full_disks_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.glb");
    let frame = ViewerFrame::from_views(&views());
    let mut mesh = triangle();
    mesh.triangles.push([0, 1, 7]);
    let error = write_mesh_glb(&path, &mesh, Unit::Metre, &frame).unwrap_err();
    assert!(error.to_string().contains("vertex 7 of 3"), "{error}");
    assert!(!path.exists());
    let error = write_mesh_glb(&path, &Mesh::default(), Unit::Metre, &frame).unwrap_err();
    assert!(error.to_string().contains("no triangles"), "{error}");
    mesh = triangle();
    mesh.colors.pop();
    assert!(write_mesh_obj(&path, &mesh, Unit::Metre).is_err());
    // A device that is always full, where the system has one.
    let full = Path::new("/dev/full");
    if full.exists() {
        let error = write_mesh_obj(full, &triangle(), Unit::Metre).unwrap_err();
        assert_eq!(error.kind, crate::IoErrorKind::Write);
    }
}

fn asset() -> Asset {
    Asset {
        mesh: Mesh {
            colors: Vec::new(),
            ..triangle()
        },
        texture_coords: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 0.5]],
        tangents: vec![[1.0, 0.0, 0.0, -1.0]; 3],
        shows: BaseColor::Albedo,
        base_color: Raster::filled(5, 3, [14_146, 0, 65_535]),
        normal: Raster::from_fn(5, 3, |x, _| [x as u16 * 257, 32_768, 65_535]),
        occlusion: Raster::filled(5, 3, 200),
    }
}

fn write_into(folder: &Path, asset: &Asset) -> Result<(), IoError> {
    std::fs::create_dir_all(folder.join("asset")).unwrap();
    let world = WorldCoordinates::from(Unit::Metre);
    let frame = ViewerFrame::from_views(&views());
    write_asset(asset, world, &frame, &|name| Ok(folder.join(name)))
}

#[test]
fn an_independent_reader_finds_mesh_textures_and_material_of_an_asset() {
    let dir = tempfile::tempdir().unwrap();
    write_into(dir.path(), &asset()).unwrap();
    let bytes = std::fs::read(dir.path().join("asset.glb")).unwrap();
    // It validates against the specification's schema and references.
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(&bytes).unwrap();
    let blob = blob.unwrap();
    let primitive = document
        .meshes()
        .next()
        .unwrap()
        .primitives()
        .next()
        .unwrap();
    let reader = primitive.reader(|_| Some(&blob));
    let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
    assert_eq!(positions[2], [0.0, -0.25, -1.0]);
    assert_eq!(primitive.bounding_box().max[0], 0.5);
    // Turned as the mesh is: y and z point the other way, so that tangent and bitangent still lie
    // along the texture.
    let tangents: Vec<[f32; 4]> = reader.read_tangents().unwrap().collect();
    assert_eq!(tangents[0], [1.0, 0.0, 0.0, -1.0]);
    let coords = reader.read_tex_coords(0).unwrap().into_f32();
    assert_eq!(coords.collect::<Vec<_>>()[2], [0.0, 0.5]);
    let indices = reader.read_indices().unwrap().into_u32();
    assert_eq!(indices.collect::<Vec<_>>(), [0, 2, 1]);
    let material = primitive.material();
    let pbr = material.pbr_metallic_roughness();
    let png = |texture: gltf::Texture<'_>| {
        let gltf::image::Source::View { view, mime_type } = texture.source().source() else {
            panic!("images lie inside");
        };
        assert_eq!(mime_type, "image/png");
        let bytes = &blob[view.offset()..view.offset() + view.length()];
        image::load_from_memory(bytes).unwrap().into_rgb8()
    };
    let base = png(pbr.base_color_texture().unwrap().texture());
    assert_eq!((base.width(), base.height()), (5, 3));
    // Linear .2159 is sRGB 128.
    assert_eq!(base.get_pixel(4, 2).0, [128, 0, 255]);
    let normal = png(material.normal_texture().unwrap().texture());
    assert_eq!(normal.get_pixel(3, 0).0, [3, 128, 255]);
    let packed = png(material.occlusion_texture().unwrap().texture());
    assert_eq!(packed.get_pixel(0, 0).0, [200, 255, 0]);
    let rough = pbr.metallic_roughness_texture().unwrap().texture();
    let occlusion = material.occlusion_texture().unwrap().texture();
    assert_eq!(rough.index(), occlusion.index());
    assert_eq!((pbr.metallic_factor(), pbr.roughness_factor()), (1.0, 1.0));
}

#[test]
fn an_assets_folder_holds_obj_and_images_of_full_depth() {
    let dir = tempfile::tempdir().unwrap();
    write_into(dir.path(), &asset()).unwrap();
    let folder = dir.path().join("asset");
    let text = std::fs::read_to_string(folder.join("asset.obj")).unwrap();
    assert!(text.contains("mtllib asset.mtl\n") && text.contains("usemtl matte\n"));
    // Its texture coordinates begin below.
    assert!(text.contains("\nvt 0 0.5\n"), "{text}");
    assert!(text.ends_with("\nf 1/1/1 3/3/3 2/2/2\n"), "{text}");
    let material = std::fs::read_to_string(folder.join("asset.mtl")).unwrap();
    for line in material.lines().filter(|line| line.ends_with(".png")) {
        let name = line.split(' ').next_back().unwrap();
        assert!(folder.join(name).exists(), "{name}");
    }
    for name in ASSET_FILES {
        assert!(dir.path().join(name).exists(), "{name}");
    }
    let written = std::fs::read_dir(&folder).unwrap().count();
    assert_eq!(written + 1, ASSET_FILES.len());
    let normal = image::open(folder.join("normal.png")).unwrap().into_rgb16();
    assert_eq!(normal.get_pixel(3, 0).0, [771, 32_768, 65_535]);
    let base = crate::exr_maps::read_linear(&folder.join("base_color.exr")).unwrap();
    assert!(
        (base.pixel(0, 0)[0] - 0.2159).abs() < 1e-3,
        "{:?}",
        base.pixel(0, 0)
    );
}

#[test]
fn an_asset_that_contradicts_itself_is_refused_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let mut short = asset();
    short.tangents.pop();
    let error = write_into(dir.path(), &short).unwrap_err();
    assert!(
        error.to_string().contains("2 tangents for 3 vertices"),
        "{error}"
    );
    let mut other = asset();
    other.occlusion = Raster::filled(4, 3, 0);
    let error = write_into(dir.path(), &other).unwrap_err();
    assert!(error.to_string().contains("different sizes"), "{error}");
    assert!(!dir.path().join("asset.glb").exists());
}
