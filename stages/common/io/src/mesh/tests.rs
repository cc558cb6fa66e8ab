use super::*;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rilievo_scene::{
    Intrinsics, Mesh, PhotoIdx, PosedView, PosedViews, RigidTransform, Unit, WorldFrame,
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
