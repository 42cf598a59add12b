"""Views of a simulated floor: points seen by a camera twice, with the truth; and rendered images of a flat texture."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.camera.model import DOWN_FORWARD, Camera
from uwgraph.places.aids import Sounding
from uwgraph.places.local import LocalFeatures
from uwgraph.places.matching import Matches
from uwgraph.places.view import View, view_of_features
from uwgraph.types import FloatArray

N_WATER = 1.34
LENS = (-0.1, 0.02, 0.0, 0.0)
CAMERA = Camera(
    "pinhole",
    (500.0, 500.0),
    (319.5, 239.5),
    (640, 480),
    LENS,
    DOWN_FORWARD,
    port="flat",
    l_b=np.array([0.4, 0.1, 0.2]),
)
RIGHT = replace(CAMERA, l_b=CAMERA.l_b + np.array([0.0, 0.2, 0.0]))
DOWN = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Pair:
    """Two views of the same points and the truth."""

    a: View
    b: View
    matches: Matches
    R: FloatArray
    p: FloatArray
    range_a: float
    range_b: float

    def soundings(self, rng, sigma=0.02):
        """Ranges of an echo sounder at the body's origin, with noise."""
        return tuple(
            Sounding(r + rng.normal(0.0, sigma), sigma, np.zeros(3), DOWN) for r in (self.range_a, self.range_b)
        )

    def error(self, motion):
        """The motion's error in the tangent of its covariance, shape (6,)."""
        R = Rotation.from_rotvec(motion.rotvec).as_matrix()
        return np.r_[Rotation.from_matrix(R.T @ self.R).as_rotvec(), R.T @ (self.p - motion.p)]

    def nees(self, motion):
        e = self.error(motion)
        return e @ np.linalg.solve(motion.cov, e) / 6.0


def pixels_of(camera, X):
    """Pixels (N, 2) of points (N, 3) seen from the camera in body axes, through its port; NaN outside the image."""
    uv = np.tile(np.array(camera.c), (len(X), 1))
    toward = X / np.linalg.norm(X, axis=1, keepdims=True)
    for _ in range(12):
        r, J = camera.outside(uv, N_WATER)
        uv = uv + np.clip(np.einsum("nij,nj->ni", np.linalg.pinv(J), toward - r), -120.0, 120.0)
        uv = np.clip(uv, -100.0, np.array(camera.size) + 100.0)
    seen = (camera.outside(uv, N_WATER)[0] * toward).sum(axis=1) > 1.0 - 1e-12
    seen &= ((uv >= 0.0) & (uv <= np.array(camera.size) - 1.0)).all(axis=1)
    return np.where(seen[:, None], uv, np.nan)


def motion_of(rng, way):
    """A rotation, mostly of heading, and a translation, mostly forward."""
    R = Rotation.from_rotvec(rng.normal(0.0, np.radians([2.0, 2.0, 8.0]))).as_matrix()
    return R, np.array([way, 0.0, 0.0]) + rng.normal(0.0, 0.05, 3)


def floor_points(rng, camera, count=220, altitude=2.0, relief=0.0, slope_deg=2.0):
    """Points of a floor that the camera sees, (N, 3) from the camera in body axes, and the floor's normal (3,)."""
    normal = Rotation.from_rotvec(rng.normal(0.0, np.radians([slope_deg, slope_deg, 0.0]))).as_matrix() @ DOWN
    rays, _ = camera.outside(rng.uniform([0, 0], np.array(camera.size) - 1.0, (count, 2)), N_WATER)
    X = rays * (altitude / (rays @ normal))[:, None]
    return X * (1.0 + relief * rng.normal(size=(count, 1))), normal


def pair_of(rng, camera=CAMERA, way=0.5, relief=0.0, noise=0.5, wrong=0.1, altitude=2.0, **floor):
    """Two views of a floor; a part ``wrong`` of the matches is anywhere."""
    R, p = motion_of(rng, way)
    X, normal = floor_points(rng, camera, altitude=altitude, relief=relief, **floor)
    c = p + R @ camera.l_b - camera.l_b
    uv_a, uv_b = pixels_of(camera, X), pixels_of(camera, (X - c) @ R)
    both = np.isfinite(uv_a[:, 0]) & np.isfinite(uv_b[:, 0])
    uv_a, uv_b = uv_a[both], uv_b[both]
    bad = rng.random(len(uv_b)) < wrong
    uv_b[bad] = rng.uniform([0, 0], np.array(camera.size) - 1.0, (bad.sum(), 2))
    a, b = (features_view(t, uv + rng.normal(0.0, noise, uv.shape), camera) for t, uv in ((0, uv_a), (1, uv_b)))
    everything = np.arange(len(a))
    range_a = (altitude + normal @ camera.l_b) / normal[2]
    range_b = (altitude + normal @ camera.l_b - normal @ p) / (normal @ R[:, 2])
    return Pair(a, b, Matches(everything, everything, np.ones(len(a), np.bool_)), R, p, range_a, range_b)


def features_view(t_ns, uv, camera, descriptors=None):
    """A view of features at given pixels; each its own descriptor where none is given."""
    if descriptors is None:
        descriptors = np.eye(128, dtype=np.float32)[np.arange(len(uv)) % 128]
    return view_of_features(t_ns, LocalFeatures(uv, descriptors), camera, n=N_WATER)


FLAT = Camera("pinhole", (400.0, 400.0), (159.5, 119.5), (320, 240), R_bs=DOWN_FORWARD)


def texture(rng, side=1200):
    """A floor without repetition: noise of several scales, uint8."""
    total = sum(
        cv2.resize(rng.normal(0.0, 1.0, (side // s, side // s)), (side, side), interpolation=cv2.INTER_CUBIC) * s**0.5
        for s in (2, 5, 12, 30)
    )
    return np.clip(128.0 + 18.0 * total, 0.0, 255.0).astype(np.uint8)


def tiles(side=1200, period=24):
    """A floor of equal tiles, uint8: one tile with a pattern of its own, again and again."""
    rng = np.random.default_rng(5)
    tile = np.clip(110.0 + 25.0 * cv2.resize(rng.normal(size=(8, 8)), (period, period)), 0, 255)
    tile[:3], tile[:, :3] = 220.0, 220.0
    return np.tile(tile.astype(np.uint8), (side // period, side // period))


def seen_from(floor, x, y, heading=0.0, altitude=1.5, metres=3.0, noise=None, camera=FLAT):
    """The image (H, W) of a flat floor, ``metres`` wide around the origin, from (x, y) forward and right, m."""
    K = camera.matrix
    R = Rotation.from_euler("z", heading).as_matrix() @ camera.R_bs
    scale = len(floor) / metres
    to_texture = np.array([[0.0, scale, len(floor) / 2], [-scale, 0.0, len(floor) / 2], [0.0, 0.0, 1.0]])
    on_floor = np.array([[altitude * R[0, 0], altitude * R[0, 1], altitude * R[0, 2] + x],
                         [altitude * R[1, 0], altitude * R[1, 1], altitude * R[1, 2] + y],
                         [0.0, 0.0, 1.0]])  # fmt: skip
    H = to_texture @ on_floor @ np.linalg.inv(K)
    image = cv2.warpPerspective(floor, H, camera.size, flags=cv2.INTER_AREA | cv2.WARP_INVERSE_MAP)
    if noise is None:
        return image
    return np.clip(image + noise.normal(0.0, 3.0, image.shape), 0, 255).astype(np.uint8)
