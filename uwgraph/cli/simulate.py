"""``uwgraph simulate``."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from uwgraph.cli.console import Progress, note, progress_bar
from uwgraph.errors import ConfigError

if TYPE_CHECKING:
    from uwgraph.dive import Dive

EXAMPLES = """Examples:

[bold]uwgraph simulate dives/lawn[/bold]

[bold]uwgraph simulate dives/far --pattern transit --duration 7200 --grade fog --seed 3[/bold]

[bold]uwgraph simulate dives/aided --on dives/run1 --grade mems --add sun-heading[/bold]

[bold]uwgraph simulate dives/v102 --on logs/euroc --add dvl --add depth[/bold]

[bold]uwgraph simulate dives/seen --images polarization --image-rate 0.1 --image-depth 5 --wind 3[/bold]

[bold]uwgraph simulate dives/reef --pattern patrol --duration 900 --floor --floor-photos photos --stereo 0.2[/bold]"""

FLOOR_SPEED = 0.7
"""m/s, over a floor where no speed is asked for: pictures at 1 Hz then overlap by three quarters."""


class Added(StrEnum):
    """Streams that can be added to a real dive."""

    dvl = "dvl"
    depth = "depth"
    fixes = "fixes"
    sun = "sun"
    sun_heading = "sun-heading"
    closures = "closures"
    odometry = "odometry"


def simulate(
    dest: Annotated[Path, typer.Argument(metavar="DEST", help="The dive folder to make.")],
    pattern: Annotated[
        Literal["lawnmower", "patrol", "helix", "transit"] | None, typer.Option(help="The mission.")
    ] = None,
    duration_s: Annotated[float | None, typer.Option("--duration", metavar="S", help="How long, seconds.")] = None,
    depth: Annotated[float | None, typer.Option(metavar="M", help="Working depth, metres.")] = None,
    speed: Annotated[float | None, typer.Option(metavar="M/S", help="Speed through the water, m/s.")] = None,
    grade: Annotated[Literal["fog", "mems", "noise_free"] | None, typer.Option(help="Quality of the IMU.")] = None,
    no_sun: Annotated[bool, typer.Option("--no-sun", help="Carry no sun sensor.")] = False,
    on: Annotated[
        Path | None,
        typer.Option(metavar="DIVE", help="A real dive to work on: --grade degrades its IMU, --add adds streams."),
    ] = None,
    at: Annotated[
        str | None, typer.Option(metavar="UTC", help="With --on: as if it had begun then, 2022-06-08T09:00:00Z.")
    ] = None,
    add: Annotated[
        list[Added] | None, typer.Option(help="With --on: a stream derived from the dive's reference; repeatable.")
    ] = None,
    images: Annotated[
        Literal["gradient", "polarization"] | None,
        typer.Option(help="Render the sky along the dive: its light, or the mosaic of a polarization camera."),
    ] = None,
    image_rate: Annotated[float | None, typer.Option(metavar="HZ", help="Images per second (0.1).")] = None,
    image_depth: Annotated[
        float | None, typer.Option(metavar="M", help="Take all images at this depth, not at that of the dive.")
    ] = None,
    wind: Annotated[float | None, typer.Option(metavar="M/S", help="Wind over the sea in the images (3).")] = None,
    floor: Annotated[
        bool, typer.Option("--floor", help="Put a sea floor under the dive: pictures of it, and the altitude.")
    ] = False,
    floor_photos: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Photographs of a real floor, whose texture is used.")
    ] = None,
    floor_rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Pictures of the floor per second (1).")
    ] = None,
    floor_altitude: Annotated[
        float | None, typer.Option(metavar="M", help="Of the deepest moment over the floor, metres (3).")
    ] = None,
    stereo: Annotated[
        float | None, typer.Option(metavar="M", help="A second camera so far to the right, metres.")
    ] = None,
    floor_settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file of the floor, its water, lamps and recording.")
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same dive.")] = 0,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file of settings; options above win over it.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a dive folder that is already there.")] = False,
) -> None:
    """Make a dive: a truth on the ellipsoid and its sensors' logs, or a real dive with simulated sensors added."""
    asked = {"pattern": pattern, "duration_s": duration_s, "depth": depth, "speed": speed, "grade": grade}
    seen = {"rate_hz": image_rate, "depth": image_depth, "wind": wind}
    if images is None and any(value is not None for value in seen.values()):
        raise ConfigError("--image-rate, --image-depth and --wind go with --images", where="--images")
    below = {"rate_hz": floor_rate, "altitude": floor_altitude, "stereo_baseline_m": stereo}
    if not floor and any(value is not None for value in (floor_photos, floor_settings, *below.values())):
        raise ConfigError("--floor-..., and --stereo, go with --floor", where="--floor")
    _refuse_taken(dest, force)
    pictured = images is not None or floor
    with progress_bar() as progress, _room_for_images(dest, pictured) as folder:
        progress("simulating", 0.1)
        if on is None:
            if add or at is not None:
                raise ConfigError("--add and --at need a dive", where="--add, --at", remedy="name it with --on DIVE")
            dive = _made(asked, settings, no_sun, seed, FLOOR_SPEED if floor else None)
        else:
            if (
                settings is not None
                or no_sun
                or any(value is not None for name, value in asked.items() if name != "grade")
            ):
                raise ConfigError("of a mission's options only --grade goes with --on", where="--on")
            dive = _added(on, at, grade, add or [], seed)
        if pictured:
            _link_images(dive, on or folder, folder)
        if images is not None:
            dive = _with_sky(dive, folder, {"kind": images, **seen}, seed, progress)
        if floor:
            dive = _with_floor(dive, folder, floor_photos, floor_settings, below, seed, progress)
        progress("writing", 0.9)
        _write(dive, dest, folder if pictured else on, force)
    made = [*dive.streams(), *((f"images/{name}", stream) for name, stream in dive.images.items())]
    note(f"{dest}: " + ", ".join(f"{name} {len(stream)}" for name, stream in made))


def _made(asked: dict[str, Any], settings: Path | None, no_sun: bool, seed: int, speed: float | None) -> Dive:
    """A mission; at ``speed`` where that is given and none is asked for."""
    from uwgraph.cli.options import settings_from
    from uwgraph.simulate import SimulationSettings
    from uwgraph.simulate import simulate as simulate_dive

    wanted = settings_from(SimulationSettings, settings, asked)
    changes: dict[str, Any] = {"sun": None} if no_sun else {}
    if speed is not None and "speed" not in wanted.model_fields_set:
        changes["speed"] = speed
    return simulate_dive(wanted.model_copy(update=changes), seed)


def _added(
    source: Path, at: str | None, grade: Literal["fog", "mems", "noise_free"] | None, add: list[Added], seed: int
) -> Dive:
    from uwgraph import simulate as room
    from uwgraph.cli.options import utc_ns
    from uwgraph.cli.source import load_dive

    dive = load_dive(source)
    if at is not None:
        dive = room.begin_at(dive, utc_ns(at, "--at"))
    if grade is not None:
        dive = room.degrade_imu(dive, grade, seed)
    adders: dict[Added, Callable[[Dive], Dive]] = {
        Added.dvl: lambda d: room.add_dvl(d, seed=seed),
        Added.depth: lambda d: room.add_depth(d, seed=seed),
        Added.fixes: lambda d: room.add_fixes(d, seed=seed),
        Added.sun: lambda d: room.add_sun(d, seed=seed),
        Added.sun_heading: lambda d: room.add_sun_heading(d, seed=seed),
        Added.closures: lambda d: room.add_closures(d, seed=seed),
        Added.odometry: lambda d: room.add_odometry(d, seed=seed),
    }
    for name in add:
        dive = adders[name](dive)
    return dive


def _link_images(dive: Dive, source: Path, folder: Path) -> None:
    """Put the images that the dive has beside those that are to come."""
    (folder / "images").mkdir()
    for camera in dive.images:
        (folder / "images" / camera).symlink_to(source.resolve() / "images" / camera)


def _with_sky(dive: Dive, folder: Path, asked: dict[str, Any], seed: int, progress: Progress) -> Dive:
    from uwgraph.cli.options import settings_from
    from uwgraph.simulate import ImageModel, Scene, add_sun_images

    scene = settings_from(Scene, None, {"wind": asked.pop("wind")})
    model = settings_from(ImageModel, None, asked)
    return add_sun_images(
        dive,
        folder,
        scene=scene,
        model=model,
        seed=seed,
        progress=lambda share: progress("rendering images", 0.1 + 0.8 * share),
    )


def _with_floor(
    dive: Dive,
    folder: Path,
    photos: Path | None,
    settings: Path | None,
    asked: dict[str, Any],
    seed: int,
    progress: Progress,
) -> Dive:
    from uwgraph.cli.options import settings_from
    from uwgraph.simulate import FloorModel, add_floor_images

    return add_floor_images(
        dive,
        folder,
        photos=photos,
        model=settings_from(FloorModel, settings, asked),
        seed=seed,
        progress=lambda share: progress("rendering the floor", 0.1 + 0.8 * share),
    )


@contextmanager
def _room_for_images(dest: Path, wanted: bool) -> Iterator[Path]:
    """A folder on the same disk that vanishes."""
    if not wanted:
        yield dest
        return
    parent = dest.absolute().parent
    parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{dest.name}.images-", dir=parent) as folder:
        yield Path(folder)


def _refuse_taken(dest: Path, force: bool) -> None:
    from uwgraph.atomic import refuse_taken
    from uwgraph.dive.folder import HEADER

    refuse_taken(dest, HEADER if force else None)


def _write(dive: Dive, dest: Path, source: Path | None, force: bool) -> None:
    from uwgraph.dive.folder import write_dive

    write_dive(dive, dest, images_from=source if dive.images else None, overwrite=force)
