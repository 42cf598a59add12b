"""One image as the geometry of places needs it: features with their rays in the body, outside the housing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.model import Camera, check_size
from uwgraph.camera.refraction import refractive_index
from uwgraph.places.enhance import Enhancement, Grey
from uwgraph.places.local import LocalFeatures, LocalSettings, features_of
from uwgraph.places.matching import twin_distances
from uwgraph.types import FloatArray

WATER = refractive_index()
"""Refractive index of sea water, for flat ports."""
AHEAD: Final = 0.1
"""Rays at a larger angle to the optical axis than this cosine says are left out."""


@dataclass(frozen=True, eq=False)
class View:
    """An image's features and rays; the rays start at the camera's place ``camera.l_b`` in the body."""

    t_ns: int
    features: LocalFeatures
    camera: Camera
    rays: FloatArray
    """Unit rays in body axes, shape (N, 3)."""
    ray_jacobian: FloatArray
    """Derivative of the rays with respect to the pixels, shape (N, 3, 2)."""
    to_pixels: FloatArray
    """What turns small changes of a ray into pixels, the pseudo-inverse of ``ray_jacobian``, shape (N, 2, 3)."""
    twins: FloatArray
    """Descriptor distance to the most alike feature elsewhere in the same image, shape (N,)."""
    points: FloatArray | None = None
    """With a second camera: places of the features seen from the camera, body axes, shape (N, 3), m; NaN for none."""
    points_cov: FloatArray | None = None
    """Their covariance for matches that are off by one pixel, shape (N, 3, 3), m^2."""

    def __len__(self) -> int:
        return len(self.rays)

    @property
    def pixel(self) -> float:
        """Angle of a pixel, rad, in the middle of the features."""
        return float(np.median(np.linalg.norm(self.ray_jacobian, axis=1))) if len(self) else np.nan

    @property
    def image_plane(self) -> FloatArray:
        """Where the rays meet the plane one before the camera, in the camera's axes, shape (N, 2)."""
        r_s = self.rays @ self.camera.R_bs
        return np.asarray(r_s[:, :2] / r_s[:, 2:])

    def select(self, index: Any) -> View:
        """The view with the features that an index array or a mask picks."""
        features = LocalFeatures(self.features.uv[index], self.features.descriptors[index])
        return View(
            self.t_ns,
            features,
            self.camera,
            self.rays[index],
            self.ray_jacobian[index],
            self.to_pixels[index],
            self.twins[index],
            None if self.points is None else self.points[index],
            None if self.points_cov is None else self.points_cov[index],
        )


def view_of(
    t_ns: int,
    image: NDArray[Any],
    camera: Camera,
    *,
    local: LocalSettings | None = None,
    how: Enhancement = "clahe",
    mask: Grey | None = None,
    n: float = WATER,
) -> View:
    """The view of one image (H, W) or (H, W, 3), of 8 or 16 bits, taken in a medium of refractive index ``n``.

    Features that the camera's model does not reach, or more than 84 degrees off its axis, are left out.

    Raises
    ------
    DataError
        When the image is not of the camera's size.
    ConfigError
        When the array is no image.
    """
    check_size(camera, image)
    return view_of_features(t_ns, features_of(image, how, local, mask), camera, n=n)


def view_of_features(t_ns: int, features: LocalFeatures, camera: Camera, *, n: float = WATER) -> View:
    """The view of features that were found already."""
    rays, jacobian = camera.outside(features.uv, n) if len(features) else (np.zeros((0, 3)), np.zeros((0, 3, 2)))
    seen = np.isfinite(jacobian).all(axis=(1, 2)) & (rays @ camera.R_bs[:, 2] > AHEAD)
    rays, jacobian = rays[seen], jacobian[seen]
    to_pixels = np.linalg.pinv(jacobian).astype(np.float64)
    kept = LocalFeatures(features.uv[seen], features.descriptors[seen])
    return View(t_ns, kept, camera, rays, jacobian, to_pixels, twin_distances(kept))


def blocks(uv: FloatArray, across: int = 6) -> NDArray[np.intp]:
    """Which cell of a grid over the points' extent each point (N, 2) is in, shape (N,)."""
    low, high = uv.min(axis=0), uv.max(axis=0)
    cell = np.minimum(((uv - low) / np.maximum(high - low, 1e-9) * across).astype(np.intp), across - 1)
    return np.asarray(cell @ np.array([1, across]))
