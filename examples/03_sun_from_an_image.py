"""The sun, and a heading, from one picture of the sky above: taken by a polarization camera 5 m under a rough sea.

    python examples/03_sun_from_an_image.py

The picture is simulated here, so that the answer is known. With your own, read it with
`uwgraph.camera.images.read_image` and its calibration with `uwgraph.camera.file.read_camera`; the command is
`uwgraph sun estimate`.
"""

from __future__ import annotations

import numpy as np

from uwgraph.camera.file import CameraFile
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate import SKY_CAMERA, ImageModel, Scene, Shot, render
from uwgraph.simulate.exposure import auto_scale, expose, mosaic
from uwgraph.sun.ephemeris import sun_azimuth_elevation
from uwgraph.sun.estimate import estimate_sun, view_of
from uwgraph.sun.observation import up_from_tilt

LAT, LON = np.radians([32.8, 34.9])
T_NS = 1_654_675_200_000_000_000  # 2022-06-08T08:00:00Z
HEADING, PITCH, ROLL = np.radians([215.0, 4.0, -3.0])

# the truth: where the sun stands, how the vehicle lies, and what its camera then sees
(azimuth,), (elevation,) = sun_azimuth_elevation(T_NS, LAT, LON)
s_l = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), -np.sin(elevation)])
R_lb = matrix_from_rph([ROLL, PITCH, HEADING])
scene, model = Scene(wind=3.0), ImageModel(kind="polarization")
radiance = mosaic(render(scene, Shot(SKY_CAMERA, R_lb, s_l, depth=5.0), seed=1))
scale = auto_scale(radiance, model.sensor.white)
picture = expose(radiance, model.sensor, scale, model.bits, np.random.default_rng(1))

# the estimate: the picture, the calibration, the tilt (from the accelerometer), time and rough place
file = CameraFile(SKY_CAMERA, model.sensor, mosaic="sony")
view = view_of(file, up_from_tilt(ROLL, PITCH), n=scene.n, tilt_sigma=np.radians(0.1), t_ns=T_NS, place=(LAT, LON))
for method in ("polarization", "gradient"):
    sun = estimate_sun([picture], file, view, method).observation
    doubts = ", ".join(sun.flags.names()) or "no doubts"
    print(
        f"{method:12s} heading {np.degrees(sun.heading(azimuth)) % 360:7.2f} +- {np.degrees(sun.azimuth_sigma):.2f} deg"
        f" (true {np.degrees(HEADING):.2f}), sun {np.degrees(sun.elevation):5.2f} deg high"
        f" (true {np.degrees(elevation):.2f}), {doubts}"
    )
