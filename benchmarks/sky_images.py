"""Real sky light: fisheye images of a clear sky, the gradient's sun against the sun marked by hand.

    python benchmarks/sky_images.py FOLDER [--centre U V] [--px-per-deg F] [--min-altitude 10] [--json] [--save]

FOLDER holds images and ``sun_annotations.csv`` with columns image, sun_x_px, sun_y_px, sun_az_deg, sun_alt_deg. The
camera is taken as an equidistant fisheye whose axis points to the zenith. Its centre and scale, where they are not
given, are fitted to the distances of marks from the centre against the almanac's zenith angles (marks above 20 degrees:
lower ones sit on the rim of the overexposed patch). No azimuth enters the fit, and no radiance. Errors are against the
mark, in the frame of the camera: azimuth about the vertical, and the angle between the two directions.

JPEG counts are undone by the sRGB curve. To first order that would not matter (ln of a power law is a multiple of ln),
but noise and masks are simpler. Green is used: in blue four times as many pixels are overexposed, and red and blue are
interpolated from half as many pixels of the sensor.

An image counts as night where the almanac's altitude is below the least altitude; those rows are shown and not judged.
"""

from __future__ import annotations

from pathlib import Path

from _bench import Figure, Row, finish, parser

# isort: split
import cv2
import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from uwgraph.camera.model import Camera
from uwgraph.camera.sensor import Sensor
from uwgraph.sun.gradient import estimate
from uwgraph.sun.observation import azimuth_in_level
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

UP = np.array([0.0, 0.0, -1.0])


def srgb_to_linear() -> FloatArray:
    """Light of the 256 codes, 0 to 255 (IEC 61966-2-1)."""
    x = np.arange(256) / 255.0
    return np.asarray(255.0 * np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4))


def calibrate(
    marks: pd.DataFrame, size: tuple[int, int], args_centre: list[float] | None, scale: float | None
) -> Camera:
    """Equidistant camera of given or fitted centre [px] and scale [px/deg]."""
    uv = marks[["sun_x_px", "sun_y_px"]].to_numpy(float)
    zenith = 90.0 - marks["sun_alt_deg"].to_numpy(float)
    high = zenith < 70.0
    middle = [(size[0] - 1) / 2.0, (size[1] - 1) / 2.0]
    fixed = [*(args_centre or [np.nan, np.nan]), scale or np.nan]
    free = np.isnan(fixed)
    start = np.array([*middle, max(size) / 150.0])

    def whole(p: FloatArray) -> FloatArray:
        full = np.array(fixed)
        full[free] = p
        return full

    def misfit(p: FloatArray) -> FloatArray:
        u, v, f = whole(p)
        return np.asarray(np.hypot(uv[high, 0] - u, uv[high, 1] - v) / f - zenith[high])

    if free.any() and high.sum() < 2 * free.sum():
        raise SystemExit(
            f"error: {high.sum()} marks above 20 deg are too few to calibrate: give --centre, --px-per-deg"
        )
    p = least_squares(misfit, start[free], loss="soft_l1", x_scale=start[free] / 50.0).x if free.any() else np.zeros(0)
    u, v, f = whole(p)
    focal = float(np.degrees(f))
    return Camera("fisheye", (focal, focal), (float(u), float(v)), size)


def error_deg(s_b: FloatArray, truth_b: FloatArray) -> tuple[float, float]:
    """Azimuth error and angle, deg."""
    d = np.degrees(azimuth_in_level(s_b, UP) - azimuth_in_level(truth_b, UP))
    angle = np.arctan2(np.linalg.norm(np.cross(s_b, truth_b)), s_b @ truth_b)
    return float((d + 180.0) % 360.0 - 180.0), float(np.degrees(angle))


def judge(file: Path, mark: pd.Series, camera: Camera, light: FloatArray, sensor: Sensor) -> Row:
    image = light[cv2.imread(str(file))[:, :, 1]].astype(np.float32)
    found = estimate(image, View(camera), sensor)
    truth = (camera.rays([[mark.sun_x_px, mark.sun_y_px]]) @ camera.R_bs.T)[0]
    row: Row = {"image": file.stem[:24], "altitude": float(mark.sun_alt_deg)}
    for name, result in (("plain", found.plain), ("ring", found.ring), ("used", found.fit)):
        s = np.full(3, np.nan) if result is None else result.s
        row[f"{name}_azimuth"], row[f"{name}_angle"] = error_deg(s, truth)
    row["sigma_azimuth"] = float(np.degrees(found.observation.azimuth_sigma))
    row["masked"] = 1.0 - float(found.light.good.sum() / found.light.sky.sum())
    row["flags"] = " ".join(found.observation.flags.names())
    return row


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--centre", type=float, nargs=2, metavar=("U", "V"), help="pixel of the zenith")
    options.add_argument("--px-per-deg", type=float, help="scale of the equidistant fisheye")
    options.add_argument("--min-altitude", type=float, default=10.0, help="of the sun, deg, for the figures")
    options.add_argument("--linear", action="store_true", help="the counts are linear in the light")
    args = options.parse_args()
    marks = pd.read_csv(args.data / "sun_annotations.csv")
    files = [next(iter(sorted(args.data.glob(f"{glob_safe(name)}.*"))), None) for name in marks["image"]]
    if None in files or not files:
        options.error(f"no image {marks['image'][files.index(None)]} in {args.data}")
    height, width = cv2.imread(str(files[0])).shape[:2]
    camera = calibrate(marks, (width, height), args.centre, args.px_per_deg)
    light = np.arange(256.0) if args.linear else srgb_to_linear()
    sensor = Sensor(white=float(light[250]), gain=40.0)
    rows = [judge(f, mark, camera, light, sensor) for f, (_, mark) in zip(files, marks.iterrows(), strict=True)]
    judged = pd.DataFrame([r for r in rows if r["altitude"] > args.min_altitude])
    used = judged[judged["flags"] == ""]
    median = judged.drop(columns=["image", "flags"]).abs().median()
    summary = [
        {"form": form, "azimuth_median": median[f"{form}_azimuth"], "angle_median": median[f"{form}_angle"],
         "azimuth_max": judged[f"{form}_azimuth"].abs().max(), "angle_max": judged[f"{form}_angle"].max()}
        for form in ("plain", "ring", "used")
    ]  # fmt: skip
    finish(
        args,
        "sky_images",
        {"images (errors in deg)": rows, f"sun above {args.min_altitude:g} deg": summary},
        [
            Figure("median azimuth error, deg", float(median["used_azimuth"]), 3.0),
            Figure("median angle, deg", float(median["used_angle"]), 6.0),
            Figure("median azimuth error of those not refused, deg", float(used["used_azimuth"].abs().median()), 3.0),
            Figure("share refused", 1.0 - len(used) / len(judged), 0.25),
        ],
        {"centre_px": camera.c, "px_per_deg": float(np.radians(camera.f[0]))},
    )


def glob_safe(name: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


if __name__ == "__main__":
    main()
