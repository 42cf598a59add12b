"""Cameras: from pixels to rays with their Jacobian, and back.

A pixel is (u, v) = (column, row), its centre at whole numbers. The camera frame s has x along growing columns, y along
growing rows (down) and z along the optical axis, as in OpenCV, whose two models are used: ``pinhole`` with radial and
tangential distortion (``cv2.projectPoints``), and ``fisheye``, the Kannala-Brandt polynomial (``cv2.fisheye``). The
fisheye is inverted here, since OpenCV's own inverse passes through tan(theta) and ends at 90 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from uwgraph.camera.refraction import refract, refract_jacobian
from uwgraph.errors import DataError
from uwgraph.types import FloatArray

Model = Literal["pinhole", "fisheye"]
Port = Literal["dome", "flat"]
Analyser = Literal["lens", "sheet", "projected"]

UP_FORWARD: Final = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""R_bs of a camera that looks up (optical axis along -z_b), image top towards the bow, columns growing to port."""


DOWN_FORWARD: Final = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""R_bs of a camera that looks down (optical axis along z_b), image top towards the bow, columns to starboard."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Calibration and mounting of one camera."""

    model: Model
    f: tuple[float, float]
    """Focal lengths along columns and rows, pixels."""
    c: tuple[float, float]
    """Principal point (u, v), pixels."""
    size: tuple[int, int]
    """Image width and height, pixels."""
    distortion: tuple[float, ...] = ()
    """OpenCV's coefficients: k1, k2, p1, p2, k3, ... (pinhole, 4, 5, 8, 12 or 14) or k1..k4 (fisheye); () for none."""
    R_bs: FloatArray = field(default_factory=UP_FORWARD.copy)
    """Rotation camera to body, shape (3, 3)."""
    port: Port = "dome"
    """A dome keeps the rays; a flat port, its normal along the optical axis, bends them."""
    analyser: Analyser = "lens"
    """Where the polarizer sits: behind the lens, as a sheet before it, or the camera's x projected (simulators)."""
    l_b: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Lever arm from the IMU to the camera in the body frame, shape (3,), m."""

    def rays(self, uv: ArrayLike) -> FloatArray:
        """Unit rays in the camera frame, inside the housing, of pixels (N, 2); shape (N, 3); NaN beyond the model."""
        r, _ = self.rays_and_jacobian(uv)
        return r

    def rays_and_jacobian(self, uv: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Unit rays (N, 3) and their derivative with respect to the pixel (N, 3, 2)."""
        uv = np.atleast_2d(np.asarray(uv, dtype=np.float64))
        if self.model == "pinhole":
            return self._pinhole(uv)
        return self._fisheye(uv)

    def project(self, r_s: ArrayLike) -> FloatArray:
        """Pixels (N, 2) of rays (N, 3) in the camera frame, inside the housing; NaN behind a pinhole."""
        r = np.atleast_2d(np.asarray(r_s, dtype=np.float64))
        if self.model == "pinhole":
            uv, _ = cv2.projectPoints(r[:, None], np.zeros(3), np.zeros(3), self.matrix, self.coefficients)
            return np.where(r[:, 2:] > 0.0, np.asarray(uv, dtype=np.float64).reshape(-1, 2), np.nan)
        planar = np.hypot(r[:, 0], r[:, 1])
        theta_d = _kannala_brandt(np.arctan2(planar, r[:, 2]), self.coefficients)[0]
        unit = r[:, :2] / np.maximum(planar, 1e-300)[:, None]
        return np.asarray(theta_d[:, None] * unit * np.array(self.f) + np.array(self.c), dtype=np.float64)

    def outside(self, uv: ArrayLike, n: float) -> tuple[FloatArray, FloatArray]:
        """Rays in the body, outside the housing in a medium of refractive index ``n``, and their derivative.

        Shapes (N, 3) and (N, 3, 2), for pixels (N, 2). NaN where the pixel sees nothing through the port.
        """
        r, J = self.rays_and_jacobian(uv)
        if self.port == "flat" and n != 1.0:
            axis = np.array([0.0, 0.0, 1.0])
            r, J = np.where(r[:, 2:] > 0.0, r, np.nan), refract_jacobian(r, axis, n) @ J
            r = refract(r, axis, n)
        return r @ self.R_bs.T, self.R_bs @ J

    def binned(self, factor: int) -> Camera:
        """The camera whose pixels are means of ``factor`` x ``factor`` of this one's."""
        f, c = ((x / factor for x in pair) for pair in (self.f, ((x + 0.5) for x in self.c)))
        width, height = (extent // factor for extent in self.size)
        cu, cv = (x - 0.5 for x in c)
        fu, fv = f
        return replace(self, f=(fu, fv), c=(cu, cv), size=(width, height))

    def pixels(self) -> FloatArray:
        """(u, v) of every pixel, row by row, shape (height * width, 2)."""
        width, height = self.size
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        return np.stack([u.ravel(), v.ravel()], axis=1)

    @property
    def matrix(self) -> FloatArray:
        """OpenCV's camera matrix, shape (3, 3)."""
        return np.array([[self.f[0], 0.0, self.c[0]], [0.0, self.f[1], self.c[1]], [0.0, 0.0, 1.0]])

    @property
    def coefficients(self) -> FloatArray:
        """OpenCV's distortion coefficients; four zeros for none."""
        return np.array(self.distortion) if self.distortion else np.zeros(4)

    def _pinhole(self, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
        start = cv2.undistortPoints(uv[:, None], self.matrix, self.coefficients)
        xy = np.asarray(start, dtype=np.float64).reshape(-1, 2)
        for _ in range(4):  # OpenCV 4 and 5 stop at different accuracies: Newton's steps end both alike
            seen, duv_dxy = self._distorted(xy)
            xy = xy + np.einsum("nij,nj->ni", np.linalg.inv(duv_dxy), uv - seen)
        seen, duv_dxy = self._distorted(xy)
        lost = ~(np.abs(seen - uv).max(axis=1) < 1e-6)
        h = np.concatenate([xy, np.ones((len(uv), 1))], axis=1)
        h[lost] = np.nan
        norm = np.linalg.norm(h, axis=1)[:, None]
        r = h / norm
        across = (np.eye(3)[:, :2] - r[:, :, None] * r[:, None, :2]) / norm[:, :, None]
        return r, across @ np.linalg.inv(duv_dxy)

    def _distorted(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels of normalised points (N, 2), and their derivative (N, 2, 2)."""
        points = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)[:, None]
        uv, J = cv2.projectPoints(points, np.zeros(3), np.zeros(3), self.matrix, self.coefficients)
        duv_dxy = J[:, 3:5]  # at z = 1 a translation moves the point itself
        return np.asarray(uv, np.float64).reshape(-1, 2), np.asarray(duv_dxy, np.float64).reshape(-1, 2, 2)

    def _fisheye(self, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
        m = (uv - np.array(self.c)) / np.array(self.f)
        theta_d = np.hypot(m[:, 0], m[:, 1])
        theta, slope = _kannala_brandt_inverse(theta_d, self.coefficients)
        on_axis = theta_d < 1e-9
        safe = np.where(on_axis, 1.0, theta_d)
        cos_a, sin_a = np.where(on_axis, 1.0, m[:, 0] / safe), np.where(on_axis, 0.0, m[:, 1] / safe)
        sin_t, cos_t = np.sin(theta), np.cos(theta)
        r = np.stack([sin_t * cos_a, sin_t * sin_a, cos_t], axis=1)
        radial = np.stack([cos_t * cos_a, cos_t * sin_a, -sin_t], axis=1) / slope[:, None]
        around = np.stack([-sin_a, cos_a, np.zeros_like(sin_a)], axis=1)
        around *= np.where(on_axis, 1.0 / slope, sin_t / safe)[:, None]
        J = np.stack([radial * cos_a[:, None] - around * sin_a[:, None],
                      radial * sin_a[:, None] + around * cos_a[:, None]], axis=2)  # fmt: skip
        return r, J / np.array(self.f)


def check_size(camera: Camera, image: NDArray[Any], where: str = "image") -> None:
    """Raise :class:`DataError` when an image (height, width, ...) is not of the camera file's size."""
    height, width = image.shape[:2]
    if (width, height) != tuple(camera.size):
        raise DataError(
            f"is {width} x {height} pixels, but the camera file is of {camera.size[0]} x {camera.size[1]}",
            where=where,
            remedy="give the camera file of this camera, at this resolution",
        )


def _kannala_brandt(theta: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8) and its slope (Kannala & Brandt 2006, OpenCV's form)."""
    t2 = theta * theta
    theta_d = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))
    return theta_d, slope


def _kannala_brandt_inverse(theta_d: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """theta of theta_d, and the slope there; NaN where the polynomial does not reach theta_d below 180 degrees."""
    theta = theta_d.copy()
    for _ in range(20):
        value, slope = _kannala_brandt(theta, k)
        theta = np.clip(theta - (value - theta_d) / np.where(np.abs(slope) < 1e-6, 1e-6, slope), 0.0, np.pi)
    value, slope = _kannala_brandt(theta, k)
    lost = (np.abs(value - theta_d) > 1e-9) | (slope <= 0.0)
    return np.where(lost, np.nan, theta), np.where(lost, np.nan, slope)
