#!/usr/bin/env python3
"""Poses alone, this program against COLMAP's Python package, in one run on one machine.

    benches/poses_against_colmap.py SET [VIEWS] [--rilievo target/release/rilievo]

SET holds photos/, intrinsics.json and truth/cameras.json; VIEWS is a list such as 1,2,12,24 (numbers
in the file names; all by default). Both programs get the same photos and the same fixed intrinsics,
use the same number of threads (--threads, 1), and are measured from reading the photos to poses:
CPU and wall seconds, registered photos, errors after a similarity from all centres.

Without the package pycolmap there is nothing to compare with: a message, and the exit code is 0.
"""

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

try:
    import numpy as np
    import pycolmap
except ImportError as error:
    print(f"skipped: {error}; `pip install pycolmap numpy` makes the comparison possible")
    sys.exit(0)


def errors(estimate, truth):
    """Mean error of centres (truth's unit) and rotations (degrees) after a similarity (Umeyama 1991)."""
    names = sorted(set(estimate) & set(truth))
    if len(names) < 3:
        return float("nan"), float("nan")
    a = np.array([estimate[n][1] for n in names])
    b = np.array([truth[n][1] for n in names])
    a0, b0 = a - a.mean(0), b - b.mean(0)
    u, s, vt = np.linalg.svd(b0.T @ a0)
    d = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    turn = u @ d @ vt
    scale = np.trace(np.diag(s) @ d) / (a0**2).sum()
    centers = np.linalg.norm(scale * a0 @ turn.T - b0, axis=1).mean()
    angles = []
    for n in names:
        difference = estimate[n][0] @ turn.T @ truth[n][0].T
        cosine = np.clip((np.trace(difference) - 1) / 2, -1, 1)
        angles.append(np.degrees(np.arccos(cosine)))
    return centers, float(np.mean(angles))


def cameras(path):
    """name -> (rotation cam_from_world, centre) of a cameras.json."""
    return {
        c["image"]: (np.array(c["world_from_camera_rotation"]).T, np.array(c["camera_center"]))
        for c in json.loads(Path(path).read_text())["cameras"]
        if "camera_center" in c
    }


def timed(work):
    """Result of work(), its CPU seconds (children included) and its wall seconds."""

    def cpu():
        own = resource.getrusage(resource.RUSAGE_SELF)
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime

    before, clock = cpu(), time.perf_counter()
    result = work()
    return result, cpu() - before, time.perf_counter() - clock


def rilievo(program, photos, folder, threads, work):
    command = [program, "reconstruct", *map(str, photos), "--cameras", str(folder / "intrinsics.json")]
    command += ["-o", str(work), "--until", "3_poses", "--threads", str(threads)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return cameras(work / "3_poses" / "cameras.json")


def colmap(photos, folder, threads, work):
    pictures = work / "pictures"
    pictures.mkdir(parents=True)
    for photo in photos:
        os.symlink(photo.resolve(), pictures / photo.name)
    given = json.loads((folder / "intrinsics.json").read_text())["cameras"][0]
    k = given["K"]
    # COLMAP's pixel centres lie at halves.
    values = [k[0][0], k[1][1], k[0][2] + 0.5, k[1][2] + 0.5]
    reader = pycolmap.ImageReaderOptions()
    reader.camera_params = ",".join(map(str, values))
    reader.camera_model = "PINHOLE"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = threads
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = threads
    for options in (extraction, matching):
        options.use_gpu = False
    database = work / "database.db"
    pycolmap.extract_features(
        database, pictures, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
        extraction_options=extraction,
    )
    pycolmap.match_exhaustive(database, matching_options=matching)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = threads
    options.ba_refine_focal_length = False
    options.ba_refine_principal_point = False
    options.ba_refine_extra_params = False
    models = pycolmap.incremental_mapping(database, pictures, work / "sparse", options)
    if not models:
        return {}
    model = max(models.values(), key=lambda m: m.num_reg_images())
    found = {}
    for image in model.images.values():
        pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        found[image.name] = (pose.rotation.matrix(), image.projection_center())
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("views", nargs="?", default="")
    parser.add_argument("--rilievo", default="target/release/rilievo")
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    pycolmap.logging.minloglevel = 2
    wanted = {int(v) for v in args.views.split(",") if v}
    photos = sorted((args.set / "photos").iterdir())
    photos = [p for p in photos if not wanted or int(re.sub(r"\D", "", p.stem)) in wanted]
    truth = cameras(args.set / "truth" / "cameras.json")
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        rows = [
            ("rilievo", *timed(lambda: rilievo(args.rilievo, photos, args.set, args.threads, work / "run"))),
            ("COLMAP " + pycolmap.__version__, *timed(lambda: colmap(photos, args.set, args.threads, work / "colmap"))),
        ]
    print(f"{args.set.name}, {len(photos)} photos, {args.threads} thread(s)")
    for name, found, cpu, wall in rows:
        centers, rotation = errors(found, truth)
        print(
            f"{name:16} {len(found)}/{len(photos)} posed, centres {1e3 * centers:.3f} mm, "
            f"rotations {rotation:.4f} deg, {cpu:.1f} CPU s, {wall:.1f} s"
        )


if __name__ == "__main__":
    main()
