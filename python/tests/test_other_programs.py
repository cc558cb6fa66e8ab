"""Files that other programs open: clouds and meshes in trimesh and meshio, COLMAP models in pycolmap."""

from __future__ import annotations

import json
from pathlib import Path

import meshio
import numpy as np
import pycolmap
import pytest
import trimesh


@pytest.fixture(scope="module")
def surface(command_line, photographed, tmp_path_factory) -> Path:
    """All files of a surface."""
    out = tmp_path_factory.mktemp("surface") / "fused"
    command_line("fuse", photographed / "truth", "-o", out, "--formats", "obj,glb,asset", "--faces", 2000)
    return out


def mesh_of(path: Path) -> trimesh.Trimesh:
    """The one mesh of a file, as it lies there."""
    mesh = trimesh.load(path, process=False, force="mesh")
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def report_of(surface: Path) -> dict:
    return json.loads((surface / "report.json").read_text())["report"]


def corners(mesh: trimesh.Trimesh) -> np.ndarray:
    """Corners of the triangles, however the vertices are numbered."""
    return np.asarray(mesh.vertices)[mesh.faces]


def test_trimesh_and_meshio_read_the_ply(surface):
    facts = report_of(surface)["mesh"]
    ours, theirs = mesh_of(surface / "mesh.ply"), meshio.read(surface / "mesh.ply")
    assert ours.faces.shape == (facts["num_triangles"], 3)
    assert len(ours.vertices) == facts["num_vertices"]
    assert np.allclose(ours.bounds, facts["bounds"], atol=1e-6)
    assert np.array_equal(theirs.points, ours.vertices) and np.array_equal(theirs.cells_dict["triangle"], ours.faces)
    # No part of the surface is folded flat: a triangle and its reverse.
    assert len(np.unique(np.sort(ours.faces, axis=1), axis=0)) == len(ours.faces)
    normals = np.stack([theirs.point_data[name] for name in ("nx", "ny", "nz")], axis=1)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)
    # Normals look where the triangles do.
    along = (normals[ours.faces].mean(axis=1) * ours.face_normals).sum(axis=1)
    assert np.average(along > 0, weights=ours.area_faces) > 0.99
    assert ours.visual.kind == "vertex"


def test_trimesh_reads_the_cloud(surface):
    cloud = trimesh.load(surface / "cloud.ply")
    assert len(cloud.vertices) == report_of(surface)["num_points"]
    low, high = mesh_of(surface / "mesh.ply").bounds
    margin = 0.05 * (high - low).max()
    assert (cloud.vertices > low - margin).all() and (cloud.vertices < high + margin).all()


def test_obj_and_glb_are_the_ply(surface):
    ply = mesh_of(surface / "mesh.ply")
    size = ply.extents.max()
    obj, theirs = mesh_of(surface / "mesh.obj"), meshio.read(surface / "mesh.obj")
    assert np.abs(corners(obj) - corners(ply)).max() < 1e-6 * size
    # meshio takes the colours behind a place for further coordinates.
    assert np.abs(theirs.points[theirs.cells_dict["triangle"], :3] - corners(ply)).max() < 1e-6 * size
    # glTF has y up: turned about, of the same shape.
    glb = mesh_of(surface / "mesh.glb")
    assert glb.faces.shape == ply.faces.shape and np.isclose(glb.area, ply.area, rtol=1e-4)
    edges = [np.linalg.norm(np.roll(corners(mesh), 1, axis=1) - corners(mesh), axis=2) for mesh in (glb, ply)]
    assert np.abs(edges[0] - edges[1]).max() < 1e-5 * size


def test_the_asset_has_its_textures(surface):
    facts = report_of(surface)["asset"]
    asset = mesh_of(surface / "asset.glb")
    assert asset.faces.shape == (facts["num_triangles"], 3)
    material = asset.visual.material
    for texture in (material.baseColorTexture, material.normalTexture, material.occlusionTexture):
        assert list(texture.size) == facts["texture_size"]
        assert all(side & (side - 1) == 0 for side in texture.size)
    coords = np.asarray(asset.visual.uv)
    assert coords.shape == (facts["num_vertices"], 2) and coords.min() >= 0 and coords.max() <= 1
    obj = mesh_of(surface / "asset" / "asset.obj")
    assert obj.faces.shape == asset.faces.shape and np.isclose(obj.area, asset.area, rtol=1e-3)


@pytest.mark.parametrize("more", [[], ["--full"], ["--triangles", 3000], ["--triangles", 300]])
def test_a_watertight_mesh_is_so_for_trimesh(command_line, photographed, tmp_path, more):
    maps = photographed / "truth"
    command_line("fuse", maps, "-o", tmp_path / "fused", "--formats", "ply", "--watertight", *more)
    # Equal vertices are joined, as trimesh does by itself.
    mesh = trimesh.load(tmp_path / "fused" / "mesh.ply")
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0


@pytest.mark.parametrize("format", ["colmap", "colmap-binary", None])
def test_pycolmap_reads_the_cameras(command_line, run_of_command_line, tmp_path, format):
    run = run_of_command_line[0]
    model = run / "3_poses" / "sparse"
    if format:
        model = tmp_path / "model"
        command_line("export", run, "--format", format, "-o", model)
    found = pycolmap.Reconstruction(model)
    ours = {camera["image"]: camera for camera in json.loads((run / "3_poses" / "cameras.json").read_text())["cameras"]}
    assert sorted(image.name for image in found.images.values()) == sorted(ours)
    for image in found.images.values():
        camera = ours[image.name]
        assert np.allclose(image.projection_center(), camera["camera_center"], atol=1e-6)
        # COLMAP's pixels have their corners at integers.
        K = found.cameras[image.camera_id].calibration_matrix()
        K[:2, 2] -= 0.5
        assert np.allclose(K, camera["K"], atol=1e-3)
    if not format:
        assert found.num_points3D() > 20
        assert found.compute_mean_reprojection_error() < 2
