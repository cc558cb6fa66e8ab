use super::*;
use rilievo_scene::{CloudPoint, Mesh, PointCloud, Unit};
use std::path::PathBuf;

fn at(folder: &tempfile::TempDir) -> PathBuf {
    folder.path().join("it.ply")
}

fn tetrahedron() -> Mesh {
    Mesh {
        vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.5]],
        normals: vec![[0.0, 0.0, -1.0]; 4],
        colors: vec![[1, 2, 255]; 4],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    }
}

#[test]
fn meshes_survive_the_disk() {
    let folder = tempfile::tempdir().unwrap();
    let bare = Mesh {
        normals: Vec::new(),
        colors: Vec::new(),
        ..tetrahedron()
    };
    for mesh in [tetrahedron(), bare, Mesh::default()] {
        write_mesh_ply(&at(&folder), &mesh, Unit::Metre).unwrap();
        let back = read_mesh_ply(&at(&folder)).unwrap();
        assert_eq!(back.vertices, mesh.vertices);
        assert_eq!(back.triangles, mesh.triangles);
        assert_eq!(back.normals, mesh.normals);
        assert_eq!(back.colors, mesh.colors);
    }
    let text = std::fs::read(at(&folder)).unwrap();
    assert!(String::from_utf8_lossy(&text).contains("comment unit metre"));
}

/// xorshift64: any sequence without structure will do.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn byte(&mut self) -> u8 {
        (self.next() >> 32) as u8
    }

    /// From zero to one.
    fn share(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1 << 24) as f32
    }
}

/// Rounds of the tests by random content.
const NUM_ROUNDS: u64 = 256;

#[test]
fn clouds_survive_the_disk() {
    let folder = tempfile::tempdir().unwrap();
    for round in 1..=NUM_ROUNDS {
        let mut random = Random(round);
        let mut point = || CloudPoint {
            position: [(); 3].map(|()| 2e6 * random.share() - 1e6),
            normal: [(); 3].map(|()| 2.0 * random.share() - 1.0),
            color: [(); 3].map(|()| random.byte()),
            confidence: random.share(),
            num_views: random.byte(),
        };
        let points = (0..round % 40).map(|_| point()).collect();
        let cloud = PointCloud { points };
        write_cloud_ply(&at(&folder), &cloud, Unit::Arbitrary).unwrap();
        let back = read_cloud_ply(&at(&folder)).unwrap();
        assert_eq!(back, cloud, "round {round}");
    }
}

#[test]
fn arbitrary_bodies_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    for round in 1..=NUM_ROUNDS {
        let mut random = Random(round);
        let body: Vec<u8> = (0..round % 200).map(|_| random.byte()).collect();
        // Counts of all sizes.
        let count = random.next() >> (round % 64);
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            let mut bytes = format!(
                "ply\nformat {format} 1.0\nelement vertex {count}\nproperty float x\n\
                 property double y\nproperty int z\nelement face 3\n\
                 property list uint int vertex_index\nend_header\n"
            )
            .into_bytes();
            bytes.extend(&body);
            std::fs::write(at(&folder), &bytes).unwrap();
            let _ = read_mesh_ply(&at(&folder));
        }
    }
}

#[test]
fn other_programs_files_are_understood() {
    let folder = tempfile::tempdir().unwrap();
    let ascii = "ply\r\nformat ascii 1.0\r\ncomment made by hand\r\nobj_info x\r\n\
        element camera 1\r\nproperty list uchar float params\r\n\
        element vertex 4\r\nproperty double y\r\nproperty double x\r\nproperty double z\r\n\
        property float red\r\nproperty float green\r\nproperty float blue\r\n\
        element face 1\r\nproperty int flag\r\nproperty list uchar uint vertex_index\r\n\
        end_header\r\n2 0.5 0.5\r\n0 0 0 1 0 0\r\n0 1 0 1 0 0\r\n1 1 0 1 0 0\r\n1 0 0 1 0 0\r\n\
        7 4 0 1 2 3\r\n";
    std::fs::write(at(&folder), ascii).unwrap();
    let mesh = read_mesh_ply(&at(&folder)).unwrap();
    assert_eq!(mesh.vertices[1], [1.0, 0.0, 0.0]);
    assert_eq!(mesh.colors[0], [255, 0, 0]);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);

    let mut big = b"ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float x\n\
        property short y\nproperty uchar z\nend_header\n"
        .to_vec();
    big.extend(1.5f32.to_be_bytes());
    big.extend((-2i16).to_be_bytes());
    big.push(3);
    std::fs::write(at(&folder), &big).unwrap();
    let cloud = read_cloud_ply(&at(&folder)).unwrap();
    assert_eq!(cloud.points[0].position, [1.5, -2.0, 3.0]);
}

#[test]
fn damage_is_told_and_no_part_panics() {
    let folder = tempfile::tempdir().unwrap();
    write_mesh_ply(&at(&folder), &tetrahedron(), Unit::Metre).unwrap();
    let whole = std::fs::read(at(&folder)).unwrap();
    for end in 0..whole.len() {
        std::fs::write(at(&folder), &whole[..end]).unwrap();
        let error = read_mesh_ply(&at(&folder)).unwrap_err();
        assert_eq!(error.path, at(&folder), "{end} bytes");
    }
    for (text, expected) in [
        ("Dear Sir", "not a PLY"),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
            "x, y and z",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex x\nend_header\n",
            "line 3",
        ),
        ("ply\nelement vertex 0\nend_header\n", "no format"),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
             property float z\nelement face 1\nproperty list uchar int vertex_indices\n\
             end_header\n0 0 0\n3 0 0 1\n",
            "vertex 1 of 1",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
             property float z\nend_header\n0 nan 0\n",
            "vertex 0 lies at",
        ),
    ] {
        std::fs::write(at(&folder), text).unwrap();
        let message = read_mesh_ply(&at(&folder)).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let lopsided = Mesh {
        colors: vec![[0; 3]],
        ..tetrahedron()
    };
    assert!(write_mesh_ply(&at(&folder), &lopsided, Unit::Metre).is_err());
}
