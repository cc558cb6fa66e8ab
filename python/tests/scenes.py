"""A bump before a camera, lit by harmonics, with exact depth, normals and image; and files of it for the command line."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

#: Nine coefficients for each of three channels: red light from the left, green from above, blue from the right. Three
#: directions determine a normal.
LIGHTING = np.array(
    [
        [-0.35, 0.05, -0.35, 0.25, 0.02, -0.03, 0.01, 0.02, 0.01],
        [0.02, -0.35, -0.35, 0.25, 0.02, -0.03, 0.01, 0.02, 0.01],
        [0.30, 0.10, -0.36, 0.26, 0.02, -0.02, 0.02, 0.01, 0.01],
    ]
)


@dataclass
class Scene:
    """Arrays of one view: depth in metres, normals in the camera's frame, a linear image of three channels."""

    K: np.ndarray
    depth: np.ndarray
    normals: np.ndarray
    image: np.ndarray
    mask: np.ndarray


def basis(n: np.ndarray) -> np.ndarray:
    """The harmonics at normals."""
    a, b, c = n[..., 0], n[..., 1], n[..., 2]
    return np.stack([a, b, c, np.ones_like(a), a * b, a * c, b * c, a * a - b * b, 3 * c * c - 1], axis=-1)


def bump(width: int = 96, height: int = 72, focal: float = 120.0) -> Scene:
    """A bump of 8 cm on a wall at 1 m, normals from the derivatives of its depth."""
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    y, x = np.mgrid[:height, :width]
    u, v = (x - cx) / focal, (y - cy) / focal
    su, sv = 0.15, 0.12
    hill = 0.08 * np.exp(-((u / su) ** 2) - (v / sv) ** 2)
    z = 1.0 - hill
    z_u, z_v = 2 * u / su**2 * hill, 2 * v / sv**2 * hill
    # Tangents of P = z (u, v, 1) along u and v.
    along_u = np.stack([z + u * z_u, v * z_u, z_u], axis=-1)
    along_v = np.stack([u * z_v, z + v * z_v, z_v], axis=-1)
    n = np.cross(along_v, along_u)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    mask = np.ones((height, width), dtype=bool)
    mask[:3] = mask[-3:] = mask[:, :3] = mask[:, -3:] = False
    image = basis(n) @ LIGHTING.T
    K = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    assert image.min() > 0 and image.max() < 1
    return Scene(K, z, n, np.ascontiguousarray(image), mask)


def angles_deg(found: np.ndarray, true: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Angles between normals inside a mask, degrees."""
    return np.degrees(np.arccos(np.clip((found * true).sum(axis=-1), -1, 1)))[mask]


def write_exr(path: Path, channels: dict[str, np.ndarray]) -> None:
    """An OpenEXR file, 32-bit floats, uncompressed."""
    height, width = next(iter(channels.values())).shape
    names = sorted(channels)
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listed = b"".join(n.encode() + b"\0" + struct.pack("<iBBBBii", 2, 0, 0, 0, 0, 1, 1) for n in names) + b"\0"
    attributes = [
        ("channels", "chlist", listed),
        ("compression", "compression", b"\0"),
        ("dataWindow", "box2i", box),
        ("displayWindow", "box2i", box),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]
    header = struct.pack("<ii", 20000630, 2)
    for name, kind, value in attributes:
        header += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    header += b"\0"
    size = 4 * width * len(names)
    first = len(header) + 8 * height
    table = b"".join(struct.pack("<Q", first + y * (8 + size)) for y in range(height))
    rows = b""
    for y in range(height):
        rows += struct.pack("<ii", y, size)
        rows += b"".join(channels[n][y].astype("<f4").tobytes() for n in names)
    path.write_bytes(header + table + rows)


def write_png(path: Path, mask: np.ndarray) -> None:
    """A mask as an 8-bit grey PNG."""
    height, width = mask.shape

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + (255 * row.astype(np.uint8)).tobytes() for row in mask)
    head = struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)
    chunks = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)


def write_scene(folder: Path, scene: Scene, start: np.ndarray) -> list[str]:
    """The files of a scene; the arguments of `rilievo shade` for them."""
    height, width = scene.mask.shape
    write_exr(folder / "image.exr", dict(zip("RGB", np.moveaxis(scene.image, -1, 0))))
    write_exr(folder / "start.exr", {"Z": start})
    write_png(folder / "mask.png", scene.mask)
    camera = {"width": width, "height": height, "K": scene.K.tolist()}
    (folder / "camera.json").write_text(json.dumps(camera))
    (folder / "lighting.json").write_text(json.dumps({"light": LIGHTING.tolist()}))
    named = {"image": "image.exr", "mask": "mask.png", "camera": "camera.json", "init": "start.exr"}
    return [f"--{name}={folder / file}" for name, file in named.items()] + [f"--lighting={folder / 'lighting.json'}:light"]
