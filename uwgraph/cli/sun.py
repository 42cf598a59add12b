"""``uwgraph sun``: estimate, show, process, locate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from uwgraph.cli.console import note, print_json, print_table, progress_bar
from uwgraph.errors import ConfigError

if TYPE_CHECKING:
    from uwgraph.camera.file import CameraFile
    from uwgraph.camera.model import Analyser
    from uwgraph.sun.estimate import Estimate, Method
    from uwgraph.sun.view import View

app = typer.Typer(
    help="The sun from images: one image, a whole dive, or a place from a day of suns.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

ImageFiles = Annotated[list[Path], typer.Argument(metavar="IMAGES...", help="Image files: PNG, TIFF, JPEG.")]
CameraOption = Annotated[
    Path, typer.Option("--camera", metavar="CAM.yaml", help="Calibration: our YAML, Kalibr's or OpenCV's.")
]
MethodOption = Annotated[
    Literal["gradient", "polarization", "scattering"] | None,
    typer.Option("--method", help="Default: polarization where polarizers are named, otherwise gradient."),
]
MediumOption = Annotated[Literal["water", "air"], typer.Option("--medium", help="What the camera sits in.")]
UtcOption = Annotated[
    str | None, typer.Option("--utc", metavar="TIME", help="When, with its zone: 2022-06-08T09:00:00Z.")
]
LatOption = Annotated[float | None, typer.Option("--lat", metavar="DEG", min=-90, max=90, help="Latitude, north.")]
LonOption = Annotated[float | None, typer.Option("--lon", metavar="DEG", min=-180, max=360, help="Longitude, east.")]
RollOption = Annotated[
    float, typer.Option("--roll-deg", metavar="DEG", min=-180, max=180, help="Roll, starboard down.")
]
PitchOption = Annotated[float, typer.Option("--pitch-deg", metavar="DEG", min=-89, max=89, help="Pitch, bow up.")]
TiltOption = Annotated[
    float, typer.Option("--tilt-sigma-deg", metavar="DEG", min=0, max=45, help="1-sigma of both; 0: exact.")
]
PolarizerOption = Annotated[
    str | None,
    typer.Option(
        "--polarizer-deg", metavar="LIST", help="Polarizer of each image, from image +x (columns) towards +y (rows)."
    ),
]
MosaicOption = Annotated[
    str | None, typer.Option("--mosaic", metavar="NAME", help="Layout of a polarization mosaic, such as sony.")
]
MountOption = Annotated[
    Literal["up-forward"] | None,
    typer.Option("--mount", help="Looking up, image top to the bow; others as R_bs in the camera file."),
]
AnalyserOption = Annotated[
    Literal["lens", "sheet", "projected"] | None,
    typer.Option("--analyser", help="The polarizer is behind the lens, a sheet before it, or projected (simulators)."),
]
IndexOption = Annotated[float | None, typer.Option("--n", metavar="N", help="Refractive index of the water.")]
YawOption = Annotated[
    str | None,
    typer.Option("--yaw-deg", metavar="LIST", help="scattering: turn of the bow at each heading, clockwise."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="JSON on standard output, for programs.")]

ESTIMATE_EXAMPLES = """Examples:

[bold]uwgraph sun estimate up.png --camera cam.yaml --utc 2022-06-08T09:00Z --lat 32.8 --lon 34.9 --json[/bold]

[bold]uwgraph sun estimate 0.png 45.png 90.png 135.png --polarizer-deg 0,45,90,135 --camera cam.yaml[/bold]"""


@app.command("estimate", epilog=ESTIMATE_EXAMPLES)
def estimate(
    images: ImageFiles,
    camera: CameraOption,
    method: MethodOption = None,
    medium: MediumOption = "water",
    utc: UtcOption = None,
    lat: LatOption = None,
    lon: LonOption = None,
    roll_deg: RollOption = 0.0,
    pitch_deg: PitchOption = 0.0,
    tilt_sigma_deg: TiltOption = 0.0,
    polarizer_deg: PolarizerOption = None,
    mosaic: MosaicOption = None,
    mount: MountOption = None,
    analyser: AnalyserOption = None,
    n: IndexOption = None,
    yaw_deg: YawOption = None,
    as_json: JsonOption = False,
) -> None:
    """The sun's direction, and the heading, from one image (or one set of channels)."""
    file = _camera(camera, polarizer_deg, mosaic, mount, analyser)
    when = _when(utc, lat, lon)
    view = _view(file, medium, n, when, roll_deg, pitch_deg, tilt_sigma_deg)
    result = figures(_estimate(images, file, view, method, yaw_deg), when, view.tilt_sigma)
    _tell("sun", result, as_json)


SHOW_EXAMPLES = (
    "Example: [bold]uwgraph sun show up.png --camera cam.yaml --method gradient --medium air -o up-sun.png[/bold]"
)


@app.command("show", epilog=SHOW_EXAMPLES)
def show(
    images: ImageFiles,
    camera: CameraOption,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="PNG", help="The picture to write.")] = Path("sun.png"),
    method: MethodOption = None,
    medium: MediumOption = "water",
    utc: UtcOption = None,
    lat: LatOption = None,
    lon: LonOption = None,
    roll_deg: RollOption = 0.0,
    pitch_deg: PitchOption = 0.0,
    tilt_sigma_deg: TiltOption = 0.0,
    polarizer_deg: PolarizerOption = None,
    mosaic: MosaicOption = None,
    mount: MountOption = None,
    analyser: AnalyserOption = None,
    n: IndexOption = None,
    yaw_deg: YawOption = None,
) -> None:
    """Draw the image with Snell's window and the sun found, the vote or the gradients, and the residuals."""
    from uwgraph.evaluate.sun_picture import sun_picture

    file = _camera(camera, polarizer_deg, mosaic, mount, analyser)
    when = _when(utc, lat, lon)
    view = _view(file, medium, n, when, roll_deg, pitch_deg, tilt_sigma_deg)
    found = _estimate(images, file, view, method, yaw_deg)
    sun_picture(found, view, out, title=images[0].name)
    note(f"{out}: {', '.join(found.observation.flags.names()) or 'no doubts'}")


PROCESS_EXAMPLES = """Examples:

[bold]uwgraph sun process dives/run1[/bold]

[bold]uwgraph sun process dives/run1 --camera sky --method gradient --force[/bold]"""


@app.command("process", epilog=PROCESS_EXAMPLES)
def process(
    dive: Annotated[Path, typer.Argument(metavar="DIVE", help="A dive folder with images/CAMERA/camera.yaml.")],
    camera: Annotated[str | None, typer.Option(metavar="NAME", help="Which camera, if there are several.")] = None,
    method: Annotated[
        Literal["gradient", "polarization"] | None,
        typer.Option("--method", help="Default: polarization for a mosaic, otherwise gradient."),
    ] = None,
    medium: MediumOption = "water",
    n: IndexOption = None,
    processes: Annotated[int, typer.Option("-j", "--jobs", min=1, max=64, help="Processes at work.")] = 2,
    force: Annotated[bool, typer.Option("--force", help="Replace a sun stream that is already there.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Turn a dive's images into its sun stream, sun.parquet in the dive's folder."""
    from uwgraph.dive.folder import add_stream, read_dive
    from uwgraph.sun.process import process_images

    there = read_dive(dive)
    if there.sun is not None and not force:
        raise ConfigError("the dive has a sun stream", where=str(dive), remedy="replace it with --force")
    if camera is None and len(there.images) != 1:
        known = ", ".join(there.images) or "none"
        raise ConfigError(f"the dive's cameras: {known}", where=str(dive), remedy="name one with --camera")
    name = camera or next(iter(there.images))
    with progress_bar() as progress:
        done = process_images(
            there,
            dive,
            name,
            method=method,
            n=_index(medium, n),
            processes=processes,
            progress=lambda share: progress("finding the sun", share),
        )
    add_stream(dive, "sun", done.sun, replace=force)
    result = {"images": done.images, "used": done.used, "refused": done.refused}
    if as_json:
        print_json(result)
    else:
        doubts = ", ".join(f"{flag} {count}" for flag, count in done.refused.items())
        note(f"{dive}: the sun in {done.used} of {done.images} images" + (f"; {doubts}" if doubts else ""))


LOCATE_EXAMPLES = """Examples:

[bold]uwgraph sun locate day.csv --offset-sigma-deg inf[/bold]

[bold]uwgraph sun locate dives/run1 --declination-deg 4.5 --json[/bold]

The CSV has the columns utc, azimuth_deg, elevation_deg and, if known, sigma_deg."""


@app.command("locate", epilog=LOCATE_EXAMPLES)
def locate(
    source: Annotated[
        Path, typer.Argument(metavar="DIVE|CSV", help="A dive with sun and heading, or a table of suns.")
    ],
    declination_deg: Annotated[
        float,
        typer.Option(
            metavar="DEG", min=-180, max=180, help="Of magnetic north, east positive, where headings are magnetic."
        ),
    ] = 0.0,
    heading_sigma_deg: Annotated[float, typer.Option(metavar="DEG", min=0, help="1-sigma of each heading.")] = 0.0,
    offset_sigma_deg: Annotated[
        float, typer.Option(metavar="DEG", min=0, help="1-sigma of a constant heading error; inf: not known at all.")
    ] = 0.0,
    loss: Annotated[
        Literal["l1", "l2", "huber", "soft_l1"], typer.Option(help="The norm that is minimised.")
    ] = "huber",
    as_json: JsonOption = False,
) -> None:
    """Latitude and longitude, with covariance, from the sun over time."""
    import numpy as np

    from uwgraph.sun.geolocation import locate as locate_suns
    from uwgraph.sun.sights import read_sights

    suns, headings = read_sights(source)
    fix = locate_suns(
        suns,
        headings,
        declination=float(np.radians(declination_deg)),
        heading_sigma=float(np.radians(heading_sigma_deg)),
        offset_sigma=float(np.radians(offset_sigma_deg)),
        loss=loss,
    )
    result = {
        "lat_deg": float(np.degrees(fix.lat)),
        "lon_deg": float(np.degrees(fix.lon)),
        "sigma_north_km": float(np.sqrt(fix.cov_ne[0, 0])) / 1e3,
        "sigma_east_km": float(np.sqrt(fix.cov_ne[1, 1])) / 1e3,
        "correlation": float(fix.cov_ne[0, 1] / np.sqrt(fix.cov_ne[0, 0] * fix.cov_ne[1, 1])),
        "heading_offset_deg": float(np.degrees(fix.heading_offset)),
        "heading_offset_sigma_deg": float(np.degrees(fix.heading_offset_sigma)),
        "used": len(fix.used),
        "of": len(suns),
        "flags": list(fix.flags.names()),
    }
    _tell("place", result, as_json)


def figures(found: Estimate, when: When, tilt_sigma: float) -> dict[str, Any]:
    """The result for programs; a heading only where the sun may be used and the almanac can be asked."""
    import numpy as np

    from uwgraph.plain import json_values

    sun = found.observation
    heading = sun.heading(when.sun_azimuth) if sun.ok and when.sun_azimuth is not None else None
    result: dict[str, Any] = {
        "method": sun.method,
        "sun_b": sun.s_b.tolist(),
        "azimuth_b_deg": float(np.degrees(sun.azimuth_b)) % 360.0,
        "elevation_deg": float(np.degrees(sun.elevation)),
        "heading_deg": None if heading is None else float(np.degrees(heading)) % 360.0,
        "heading_sigma_deg": None if heading is None else float(np.degrees(sun.heading_sigma(tilt_sigma))),
        "information": sun.information_b.tolist(),
        "quality": sun.quality,
        "flags": list(sun.flags.names()),
    }
    if sun.other_b is not None:
        result["other_b"] = sun.other_b.tolist()
    return dict(json_values(result))


@dataclass(frozen=True)
class When:
    """Time and place of an image, as far as the command line tells; rad."""

    t_ns: int = 0
    place: tuple[float, float] | None = None
    sun_azimuth: float | None = None


def _when(utc: str | None, lat: float | None, lon: float | None) -> When:
    import numpy as np

    from uwgraph.cli.options import utc_ns
    from uwgraph.sun.ephemeris import sun_azimuth_elevation

    given = [value is not None for value in (utc, lat, lon)]
    if utc is None or lat is None or lon is None:
        if any(given):
            raise ConfigError("time and place belong together", where="--utc, --lat, --lon", remedy="give all or none")
        return When()
    t_ns = utc_ns(utc, "--utc")
    place = (float(np.radians(lat)), float(np.radians(lon)))
    return When(t_ns, place, float(sun_azimuth_elevation(t_ns, *place)[0][0]))


def _camera(
    path: Path, polarizer_deg: str | None, mosaic: str | None, mount: str | None, analyser: Analyser | None
) -> CameraFile:
    """The camera file, options winning."""
    from uwgraph.camera.file import read_camera
    from uwgraph.camera.model import UP_FORWARD

    file = read_camera(path)
    if mount is not None:
        file = replace(file, camera=replace(file.camera, R_bs=UP_FORWARD.copy()))
    if analyser is not None:
        file = replace(file, camera=replace(file.camera, analyser=analyser))
    if polarizer_deg is not None:
        file = replace(file, mosaic=None, polarizer_deg=_numbers(polarizer_deg, "--polarizer-deg"))
    return file if mosaic is None else replace(file, mosaic=mosaic)


def _view(
    file: CameraFile, medium: str, n: float | None, when: When, roll_deg: float, pitch_deg: float, tilt_sigma_deg: float
) -> View:
    import numpy as np

    from uwgraph.sun.estimate import view_of
    from uwgraph.sun.observation import up_from_tilt

    roll, pitch, sigma = (float(np.radians(angle)) for angle in (roll_deg, pitch_deg, tilt_sigma_deg))
    up_b = up_from_tilt(roll, pitch)
    return view_of(file, up_b, n=_index(medium, n), tilt_sigma=sigma, t_ns=when.t_ns, place=when.place)


def _index(medium: str, n: float | None) -> float:
    """Refractive index of the medium; sea water of 35, 15 degrees and 530 nm where it is not given."""
    from uwgraph.camera.refraction import refractive_index

    if medium == "air":
        if n is not None:
            raise ConfigError("air has the index 1 here", where="--n", remedy="leave --n out, or say --medium water")
        return 1.0
    if n is None:
        return refractive_index()
    if not 1.2 < n < 1.6:
        raise ConfigError(f"{n:g} is no refractive index of water", where="--n", remedy="sea water has 1.33 to 1.36")
    return n


def _estimate(images: list[Path], file: CameraFile, view: View, method: Method | None, yaw_deg: str | None) -> Estimate:
    import numpy as np

    from uwgraph.camera.images import read_image
    from uwgraph.sun.estimate import estimate_sun

    yaw = None if yaw_deg is None else np.radians(_numbers(yaw_deg, "--yaw-deg"))
    return estimate_sun([read_image(image) for image in images], file, view, method, yaw)


def _numbers(text: str, where: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = (math.nan,)
    if not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{text!r} is no list of numbers", where=where, remedy="write 0,45,90,135")
    return numbers


def _tell(title: str, result: dict[str, Any], as_json: bool) -> None:
    """A result for programs or for people, and whether it may be used."""
    if as_json:
        print_json(result)
    else:
        print_table(title, (), [(name, _text(value)) for name, value in result.items()])
    if result["flags"]:
        note(f"not to be used: {', '.join(result['flags'])}")


def _text(value: Any) -> str:
    """A result for people."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_text(item) if not isinstance(item, list) else f"[{_text(item)}]" for item in value) or "none"
    return "unknown" if value is None else str(value)
