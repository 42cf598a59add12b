"""Two views of a plane, and of what stands out of it: residuals in pixels.

X is a point seen from camera a, in the body axes of a; camera b is at c and its body is turned by R (b to a). The plane
is pi . X = 1, so that a ray r of a meets it at X = r / (pi . r), and b sees it along R^T (r - c (pi . r)), which is the
plane-induced homography (Hartley & Zisserman, Multiple View Geometry, 13.1) for any rays, refracted or not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from gtsam import Rot3

from uwgraph.places.view import View
from uwgraph.types import FloatArray

FEWEST: Final = 12
"""Points of a floor."""
CHANCES: Final = 20
"""Planes that are looked at, those with the most points first."""
STRIP: Final = 0.3
"""Points that are spread by less than this part of the floor's distance, 1-sigma, across the longest way through them,
may lie where a floor would meet a wall."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """R (body b to body a), c (camera a to camera b) and the plane, in the body axes of a; lengths of any unit."""

    R: FloatArray
    """Shape (3, 3)."""
    c: FloatArray
    """Shape (3,)."""
    plane: FloatArray | None = None
    """pi with pi . X = 1 for the plane's points, shape (3,); None where no plane was seen."""

    def moved(self, x: FloatArray) -> Geometry:
        """After a small rotation in the axes of b x[:3], a change of c x[3:6] and of the plane x[6:9]."""
        R = self.R @ Rot3.Expmap(x[:3]).matrix()
        return Geometry(R, self.c + x[3:6], None if self.plane is None else self.plane + x[6:9])

    def scaled(self, scale: float) -> Geometry:
        """In a unit that is ``scale`` times smaller."""
        return Geometry(self.R, scale * self.c, None if self.plane is None else self.plane / scale)


def transfer(g: Geometry, a: View, b: View) -> tuple[FloatArray, FloatArray]:
    """Pixels between where b sees the points and where the plane says so, over the share of a's own errors, (N, 2).

    Divided by sqrt(1 + |dv/du|^2 / 2), so that errors of one pixel in both images are one pixel here. With the
    derivative by the changes of :meth:`Geometry.moved`, shape (N, 2, 9).
    """
    assert g.plane is not None
    H = g.R.T @ (np.eye(3) - np.outer(g.c, g.plane))
    Y = a.rays @ H.T
    depth = np.linalg.norm(Y, axis=1)
    toward = Y / depth[:, None]
    M = (b.to_pixels @ H) @ a.ray_jacobian / depth[:, None, None]
    share = 1.0 / np.sqrt(1.0 + 0.5 * (M * M).sum(axis=(1, 2)))
    e = share[:, None] * np.einsum("nij,nj->ni", b.to_pixels, toward - b.rays)
    by_Y = b.to_pixels - (b.to_pixels @ toward[:, :, None]) * toward[:, None, :]
    by_Y *= (share / depth)[:, None, None]
    J = np.empty((len(Y), 2, 9))
    J[:, :, :3] = np.cross(by_Y, Y[:, None, :])  # Y moves by Y x theta
    J[:, :, 3:6] = -(by_Y @ g.R.T) * (a.rays @ g.plane)[:, None, None]
    J[:, :, 6:] = -(by_Y @ (g.R.T @ g.c))[:, :, None] * a.rays[:, None, :]
    return e, J


def epipolar(g: Geometry, a: View, b: View) -> tuple[FloatArray, FloatArray]:
    """Sampson's distance of every match from the epipolar constraint c . (r_a x R r_b) = 0, pixels, shape (N,).

    With the derivative of its numerator by rotation and c, over the denominator, shape (N, 6).
    """
    length = max(float(np.linalg.norm(g.c)), 1e-12)
    c = g.c / length
    r_b = b.rays @ g.R.T
    across_a, across_b = np.cross(r_b, c), np.cross(c, a.rays)  # derivatives with respect to either ray
    value = (across_b * r_b).sum(axis=1)
    by_a = np.einsum("ni,nik->nk", across_a, a.ray_jacobian)
    by_b = np.einsum("ni,nik->nk", across_b @ g.R, b.ray_jacobian)
    slope = np.maximum(np.sqrt((by_a**2).sum(axis=1) + (by_b**2).sum(axis=1)), 1e-12)
    J = np.empty((len(value), 6))
    J[:, :3] = np.cross(b.rays, across_b @ g.R)
    J[:, 3:] = (np.cross(a.rays, r_b) - value[:, None] * c) / length
    return value / slope, J / slope[:, None]


def pixels_off_plane(g: Geometry, a: View, b: View) -> FloatArray:
    """Length of the residuals of :func:`transfer`, shape (N,); infinite for what lies behind."""
    assert g.plane is not None
    return np.where(a.rays @ g.plane > 0.0, np.linalg.norm(transfer(g, a, b)[0], axis=1), np.inf)


def inverse_depths(g: Geometry, a: View, b: View) -> tuple[FloatArray, FloatArray]:
    """One over the distance of every match from a, shape (N,), and the pixels that it moves in b per unit of it.

    The least-squares solution of b's ray along R^T (r_a - c rho): linear in rho, with an error that is Gaussian.
    """
    at = np.einsum("nij,nj->ni", b.to_pixels, a.rays @ g.R)
    by = np.einsum("nij,j->ni", b.to_pixels, g.R.T @ g.c)
    rho = (at * by).sum(axis=1) / np.maximum((by * by).sum(axis=1), 1e-18)
    return np.asarray(rho), np.linalg.norm(by, axis=1) / np.linalg.norm(a.rays - rho[:, None] * g.c, axis=1)


def planes_of(H: FloatArray, a: View, R_bs_b: FloatArray) -> list[Geometry]:
    """What motions and planes a homography between image planes (b <- a) can be; lengths in distances of the plane.

    Up to two remain of four, those with the points before the camera (Malis & Vargas, INRIA RR-6303, 2007).
    """
    _, rotations, ways, normals = cv2.decomposeHomographyMat(H, np.eye(3))
    found: list[Geometry] = []
    for R_ba, t, normal in zip(rotations, ways, normals, strict=True):
        R_s = np.asarray(R_ba).T
        if not normal.any():  # the camera only turned: any plane before it does
            normal = a.camera.R_bs.T @ a.rays.mean(axis=0)
            normal /= np.linalg.norm(normal)
        sign = float(np.sign(np.median(a.rays @ a.camera.R_bs @ normal.ravel()))) or 1.0
        plane, c = a.camera.R_bs @ normal.ravel() * sign, -a.camera.R_bs @ R_s @ t.ravel() * sign
        g = Geometry(a.camera.R_bs @ R_s @ R_bs_b.T, c, plane)
        new = all(np.abs(other.plane - plane).max() > 1e-6 for other in found if other.plane is not None)
        if new and np.mean(a.rays @ plane > 0.0) > 0.9 and 1.0 - plane @ c > 0.05:
            found.append(g)
    return found


def floor_of(
    g: Geometry, a: View, b: View, floor: FloatArray, flattest: float, threshold: float, seed: int = 0
) -> FloatArray | None:
    """The plane with most matches within ``threshold`` pixels, across ``floor`` up to an angle of this cosine; or None.

    Planes through three inverse depths each: pi . r = rho is linear.
    """
    rho, pixels = inverse_depths(g, a, b)
    near = np.flatnonzero((rho > 0.0) & (pixels * rho > 2.0 * threshold))
    if len(near) < FEWEST:
        return None
    rng = np.random.default_rng(seed)
    picks = near[rng.integers(0, len(near), (400, 3))]
    rows = a.rays[picks]
    proper = np.abs(np.linalg.det(rows)) > 1e-4
    planes = np.linalg.solve(rows[proper], rho[picks[proper]][..., None])[..., 0]
    planes = planes[planes @ floor > flattest * np.linalg.norm(planes, axis=1)]
    agree = np.abs(planes @ a.rays[near].T - rho[near]) * pixels[near] < threshold
    for k in np.argsort(-agree.sum(axis=1), kind="stable")[:CHANCES]:
        on = near[agree[k]]
        if len(on) < FEWEST:
            return None
        if _across(planes[k], a.rays[on]) > STRIP:
            weight = pixels[on]
            return np.asarray(np.linalg.lstsq(a.rays[on] * weight[:, None], rho[on] * weight, rcond=None)[0])
    return None


def _across(plane: FloatArray, rays: FloatArray) -> float:
    """Standard deviation of the points where rays meet a plane, along their narrow side, in distances of the plane."""
    points = rays / (rays @ plane)[:, None] * np.linalg.norm(plane)
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points.T))[1], 0.0)))  # the least is across the plane
