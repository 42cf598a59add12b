"""The camera of the SUBVO pool, from the pool's own tiles.

The recording's camera file is unusable (a focal length of 12 572 pixels for an image 640 wide). The floor and the walls
are square mosaic tiles, however: each image shows a calibration target, whose unit of length is one tile.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from uwgraph.camera.images import read_image
from uwgraph.camera.model import Camera
from uwgraph.types import FloatArray

SIZE = (640, 360)
EVERY = 5
"""Every so many images one is looked at."""
FEWEST = 120
"""Tiles of a target."""
SLOPPY = 2.0
"""Targets that fit worse than so many times the median are no planes of tiles, or were counted wrongly."""


@dataclass(frozen=True)
class PoolCamera:
    """The camera and where it is, lengths in tiles."""

    camera: Camera
    """Body axes: forward, right, down, level over the floor."""
    height: float
    """Over the floor, tiles."""
    height_sigma: float
    """Its standard deviation over the images that show enough of the floor."""
    targets: int
    rms_px: float


def calibrated(files: list[Path]) -> PoolCamera:
    """Focal length, principal point and two coefficients of distortion, as of a chessboard (Zhang, PAMI 2000)."""
    targets = [t for t in (lattice(tile_centres(f)) for f in files[::EVERY]) if len(t[0]) >= FEWEST]
    K = np.array([[SIZE[0], 0.0, 319.5], [0.0, SIZE[0], 179.5], [0.0, 0.0, 1.0]])
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    while True:
        corners = [np.c_[ij, np.zeros(len(ij))].astype(np.float32) for _, ij in targets]
        seen = [uv.astype(np.float32) for uv, _ in targets]
        rms, M, k, turns, places, _, _, each = cv2.calibrateCameraExtended(
            corners, seen, SIZE, K.copy(), np.zeros(5), flags=flags
        )
        good = each.ravel() < SLOPPY * np.median(each)
        if good.all():
            break
        targets = [t for t, use in zip(targets, good, strict=True) if use]
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    heights = (normals * np.array([p.ravel() for p in places])).sum(axis=1)
    normals, heights = normals * np.sign(heights)[:, None], np.abs(heights)
    floor = normals[:, 1] > 0.8  # walls are upright
    down = normals[floor].mean(axis=0)
    down /= np.linalg.norm(down)
    ahead = np.array([0.0, 0.0, 1.0]) - down[2] * down
    ahead /= np.linalg.norm(ahead)
    R_bs = np.array([ahead, np.cross(down, ahead), down])
    camera = Camera("pinhole", (M[0, 0], M[1, 1]), (M[0, 2], M[1, 2]), SIZE, (*k.ravel()[:2], 0.0, 0.0), R_bs)
    return PoolCamera(camera, float(np.median(heights[floor])), float(heights[floor].std()), len(targets), float(rms))


def tile_centres(file: Path) -> FloatArray:
    """Middles of the dark convex patches between bright joints, pixels, shape (N, 2)."""
    grey = cv2.resize(
        cv2.cvtColor(read_image(file), cv2.COLOR_RGB2GRAY), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC
    )
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.5)
    dark = cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, 41, 3)
    count, labels, boxes, centres = cv2.connectedComponentsWithStats(dark, connectivity=4)
    found = []
    for i in range(1, count):
        x, y, w, h, area = boxes[i]
        inside = x > 2 and y > 2 and x + w < grey.shape[1] - 2 and y + h < grey.shape[0] - 2
        if not (inside and 60 < area < 6000 and area > 0.45 * w * h):
            continue
        outline, _ = cv2.findContours((labels[y : y + h, x : x + w] == i).astype(np.uint8), cv2.RETR_EXTERNAL, 2)
        hull = cv2.convexHull(outline[0])
        if area > 0.85 * (cv2.contourArea(hull) + 0.5 * cv2.arcLength(hull, True) + 1.0):
            found.append(centres[i])
    return (np.array(found).reshape(-1, 2) + 0.5) / 2.0 - 0.5


def lattice(points: FloatArray, seeds: int = 60) -> tuple[FloatArray, FloatArray]:
    """The most points (M, 2) that can be counted as columns and rows (M, 2) of one lattice, from many seeds."""
    if len(points) < FEWEST:
        return points[:0], points[:0]
    tree = cKDTree(points)
    _, near = tree.query(points, 5)
    best: dict[tuple[int, int], int] = {}
    for seed in np.random.default_rng(0).permutation(len(points))[:seeds]:
        steps = points[near[seed, 1:]] - points[seed]
        u, length = steps[0], np.linalg.norm(steps, axis=1)
        sine = np.abs(u[0] * steps[:, 1] - u[1] * steps[:, 0]) / (length[0] * length)
        if sine.max() > 0.5:
            grown = _grown(points, tree, int(seed), u, steps[int(sine.argmax())])
            best = max(best, grown, key=len)
    return points[list(best.values())], np.array(list(best.keys()), dtype=float).reshape(-1, 2)


def _grown(points: FloatArray, tree: cKDTree, seed: int, u: FloatArray, v: FloatArray) -> dict[tuple[int, int], int]:
    """Places of the lattice and their points, from neighbour to neighbour; the steps u and v follow the perspective."""
    place, steps, taken, queue = {(0, 0): seed}, {(0, 0): (u, v)}, {seed}, [(0, 0)]
    while queue:
        at = queue.pop(0)
        u, v = steps[at]
        reach = 0.22 * min(np.linalg.norm(u), np.linalg.norm(v))
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            to = (at[0] + di, at[1] + dj)
            far, i = tree.query(points[place[at]] + di * u + dj * v)
            if to in place or far > reach or i in taken:
                continue
            gone = points[i] - points[place[at]]
            steps[to] = (0.5 * (u + (di * gone if di else u)), 0.5 * (v + (dj * gone if dj else v)))
            place[to] = i
            taken.add(i)
            queue.append(to)
    return place
