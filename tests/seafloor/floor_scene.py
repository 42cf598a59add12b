"""A wavy floor with a random texture, rendered ray by ray: a scene that knows the answer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.file import CameraFile, write_camera
from uwgraph.camera.model import DOWN_FORWARD, Camera
from uwgraph.dive import Dive
from uwgraph.dive.folder import CAMERA_FILE, write_dive
from uwgraph.dive.rig import AltitudeRig
from uwgraph.export import Track, track_of_reference
from uwgraph.seafloor.poses import poses_at
from uwgraph.simulate import SimulationSettings, simulate
from uwgraph.types import Altitude, FloatArray, Images

FLOOR_M = 4.2
CAMERA = Camera(
    "pinhole", f=(200.0, 200.0), c=(127.5, 95.5), size=(256, 192), R_bs=DOWN_FORWARD, l_b=np.array([0.3, -0.1, 0.1])
)
BASELINE = np.array([0.0, 0.2, 0.0])
TEXEL_M = 0.007
NOISE = 2.0
SOUNDER = AltitudeRig(translation_m=(0.2, 0.0, 0.1), sigma=0.02)


@dataclass(frozen=True)
class Scene:
    """A dive folder and what it was made from."""

    folder: Path
    dive: Dive
    truth: Track


def height_error(points_n: FloatArray) -> FloatArray:
    """Down of points (M, 3) less that of the floor there."""
    return points_n[:, 2] - down(points_n[:, :2])


def down(ne: FloatArray) -> FloatArray:
    """Of the floor at (north, east), shape (..., 2)."""
    n, e = ne[..., 0], ne[..., 1]
    return FLOOR_M + 0.08 * np.sin(0.9 * n) + 0.06 * np.cos(1.1 * e + 0.4 * n)


def texture() -> NDArray[np.float32]:
    """Random at many scales, float32 (H, W, 3); a texel is TEXEL_M, and it repeats after 12 m."""
    rng = np.random.default_rng(5)
    size = 2048
    spots = sum(
        cv2.resize(
            rng.normal(size=(size // s, size // s, 3)).astype(np.float32), (size, size), interpolation=cv2.INTER_CUBIC
        )
        for s in (2, 4, 8, 32)
    )
    return np.clip(115.0 + 22.0 * spots, 0.0, 255.0).astype(np.float32)


def render(
    camera: Camera,
    rays_b: FloatArray,
    R_nb: FloatArray,
    p_n: FloatArray,
    albedo: NDArray[np.float32],
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """An 8-bit picture, darker towards its edges; ``rays_b`` are those of the camera's pixels."""
    rays_n = rays_b @ R_nb.T
    start = p_n + R_nb @ camera.l_b
    length = (FLOOR_M - start[2]) / rays_n[:, 2]
    for _ in range(6):
        length = (down(start[:2] + length[:, None] * rays_n[:, :2]) - start[2]) / rays_n[:, 2]
    at = ((start[:2] + length[:, None] * rays_n[:, :2]) / TEXEL_M).astype(np.float32).reshape(*camera.size[::-1], 2)
    at %= albedo.shape[0]
    seen = cv2.remap(albedo, at[..., 1].copy(), at[..., 0].copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    lamp = rays_n[:, 2].reshape(*camera.size[::-1], 1) ** 3
    noisy = seen * lamp * [1.0, 0.9, 0.5] + [20.0, 15.0, 5.0] + rng.normal(0.0, NOISE, seen.shape)
    return np.clip(noisy, 0.0, 255.0).astype(np.uint8)


def dive_over(folder: Path, *, stereo: bool) -> Scene:
    """A minute and a half of two small laps, an image every 2 s."""
    settings = SimulationSettings(
        pattern="patrol", duration_s=95.0, speed=0.5, depth=1.2, surface_depth=0.9, surface_time_s=5.0,
        leg_length_m=4.0, line_spacing_m=4.0, turn_rate_deg_s=15.0, current=(0.0, 0.0), sun=None, imu_rate_hz=50.0,
    )  # fmt: skip
    dive = simulate(settings, seed=4)
    truth = track_of_reference(dive)
    t_ns = truth.t_ns[0] + 20_000_000_000 + np.arange(36) * 2_000_000_000
    cameras = {"down": CAMERA} | ({"down_right": replace(CAMERA, l_b=CAMERA.l_b + BASELINE)} if stereo else {})
    poses, within = poses_at(dive, truth, t_ns)
    assert within.all()
    albedo, rng = texture(), np.random.default_rng(6)
    files = np.array([f"{t}.png" for t in t_ns])
    place = folder.parent / "made"
    for name, camera in cameras.items():
        images = place / "images" / name
        images.mkdir(parents=True)
        write_camera(images / CAMERA_FILE, CameraFile(camera))
        rays_b = camera.outside(camera.pixels(), 1.0)[0]
        for k, file in enumerate(files):
            cv2.imwrite(str(images / file), render(camera, rays_b, poses.R_nb[k], poses.p_n[k], albedo, rng))
    streams = {name: Images(t_ns, file=files, camera=name) for name in cameras}
    dive = replace(
        dive, images=streams, altitude=_altitude(dive, truth), rig=dive.rig.model_copy(update={"altitude": SOUNDER})
    )
    write_dive(dive, folder, images_from=place)
    return Scene(folder, dive, truth)


def _altitude(dive: Dive, truth: Track) -> Altitude:
    t_ns = truth.t_ns[0] + np.arange(5, 94 * 4) * 250_000_000
    poses, _ = poses_at(dive, truth, t_ns)
    start = poses.p_n + poses.R_nb @ SOUNDER.l_b
    beam = poses.R_nb[:, :, 2]
    length = np.full(len(t_ns), 3.0)
    for _ in range(6):
        length = (down(start[:, :2] + length[:, None] * beam[:, :2]) - start[:, 2]) / beam[:, 2]
    noise = np.random.default_rng(7).normal(0.0, SOUNDER.sigma, len(t_ns))
    return Altitude(t_ns, altitude=length + noise, sigma=np.full(len(t_ns), np.nan))
