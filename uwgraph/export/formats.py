"""The formats: what each needs, what its file is called, and how it is written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np

from uwgraph import __version__
from uwgraph.atomic import atomic_file, atomic_folder
from uwgraph.errors import ConfigError, DataError
from uwgraph.export.axes import AXES, Axes, FrameName
from uwgraph.export.euroc import STATES as ASL_STATES
from uwgraph.export.euroc import write_asl_folder, write_euroc
from uwgraph.export.geojson import write_geojson
from uwgraph.export.kml import write_kml
from uwgraph.export.poses import write_csv, write_kitti, write_kitti_times, write_tum
from uwgraph.export.source import Source
from uwgraph.export.track import thinned

FormatName = Literal["tum", "kitti", "euroc", "mcap", "geojson", "kml", "csv"]


@dataclass(frozen=True)
class Format:
    """One format."""

    suffixes: tuple[str, ...]
    """By which it is guessed, in lower case."""
    needs: Literal["pose", "place"]
    """Rows without a pose (or without latitude and longitude) are left out."""
    frame: FrameName | None
    """The frames when none are asked for; None where the format has its own."""


FORMATS: Final[Mapping[FormatName, Format]] = {
    "tum": Format((".tum",), "pose", "ned"),
    "kitti": Format((".kitti",), "pose", "ned"),
    "euroc": Format((), "pose", "euroc"),
    "mcap": Format((".mcap",), "place", "enu"),
    "geojson": Format((".geojson", ".json"), "place", None),
    "kml": Format((".kml",), "place", None),
    "csv": Format((".csv",), "place", None),
}


@dataclass(frozen=True)
class Exported:
    """What :func:`export` wrote."""

    format: FormatName
    files: tuple[str, ...]
    count: int
    """Poses or points; messages of an MCAP file."""
    left_out: int
    """Poses without what the format needs."""
    frame: str
    """World and body axes in words."""


def guess_format(path: Path) -> FormatName:
    """The format of a file by its suffix; raises :class:`ConfigError` where there is none of it."""
    for name, known in FORMATS.items():
        if path.suffix.lower() in known.suffixes:
            return name
    suffixes = ", ".join(suffix for known in FORMATS.values() for suffix in known.suffixes)
    raise ConfigError(
        f"the suffix {path.suffix!r} names no format" if path.suffix else "without a suffix the format is not known",
        where=str(path),
        remedy=f"use one of {suffixes}, or name it: --format {'|'.join(get_args(FormatName))}",
    )


def files_of(path: Path, name: FormatName) -> tuple[Path, ...]:
    """Every file (or the folder) that an export makes."""
    if name == "kitti":
        return path, path.with_name(f"{path.stem}_times.txt")
    return (path,)


def refuse_taken(path: Path, name: FormatName, *, overwrite: bool) -> None:
    """Tell before the long work that the output has no place to go.

    Raises
    ------
    ConfigError
        When a file is there and may not be overwritten, or a folder that is not ours.
    """
    for file in files_of(path, name):
        ours = (file / ASL_STATES).is_file() if _is_folder(path, name) else file.is_file()
        empty = _is_folder(path, name) and file.is_dir() and not any(file.iterdir())
        if file.exists() and not ours and not empty:
            raise ConfigError("is taken by something else", where=str(file), remedy="choose another name")
        if ours and not overwrite:
            raise ConfigError("is already there", where=str(file), remedy="choose another name, or add --force")


def export(
    source: Source,
    path: str | Path,
    format: FormatName | None = None,  # noqa: A002
    *,
    frame: FrameName | None = None,
    rate_hz: float | None = None,
    overwrite: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> Exported:
    """Write a track, fixes or a dive in one of :data:`FORMATS`: whole, or not at all.

    Parameters
    ----------
    path : path
        The file. For EuRoC a name without suffix is a folder in ASL layout, with the IMU where ``source`` has a dive.
    format : str, optional
        Guessed from the suffix when not given.
    frame : {"ned", "enu", "euroc"}, optional
        World and body axes of poses: NED and FRD, ENU and FLU, or those of EuRoC.
    rate_hz : float, optional
        At most so many poses a second; nothing is interpolated. Sensors are not thinned.
    overwrite : bool
        Replace files that are there.
    progress : callable, optional
        Told which share of a long file is written, 0 to 1.

    Raises
    ------
    ConfigError
        When the format or frame does not fit, or the place is taken.
    DataError
        When the source knows nothing that the format needs, or the output cannot be written.
    """
    out = Path(path)
    name = format or guess_format(out)
    axes = _axes(name, frame)
    refuse_taken(out, name, overwrite=overwrite)
    source, left_out = _fitting(source, name, rate_hz)
    count = len(source.track or source.fixes or ())
    if axes is None:
        _write_places(source, out, name)
    elif name == "mcap":
        count = _write_mcap(source, out, axes, progress)
    else:
        _write_poses(source, out, name, axes, overwrite)
    files = tuple(str(file) for file in files_of(out, name))
    return Exported(name, files, count, left_out, str(axes) if axes else "latitude, longitude, height")


def _axes(name: FormatName, frame: FrameName | None) -> Axes | None:
    default = FORMATS[name].frame
    if default is None:
        if frame is not None:
            raise ConfigError(f"{name} has latitudes and longitudes, no frames", where="--frame", remedy="leave it out")
        return None
    return AXES[frame or default]


def _fitting(source: Source, name: FormatName, rate_hz: float | None) -> tuple[Source, int]:
    """The source with those poses of the track that the format can tell, and how many it cannot."""
    track, needs = source.track, FORMATS[name].needs
    if track is None:
        if needs == "pose" or (name == "mcap" and source.dive is None):
            raise DataError(
                f"there are no poses, which {name} needs", where=source.name, remedy="use geojson, kml, csv"
            )
        return source, 0
    fits = track.posed if needs == "pose" else track.placed
    if not fits.any():
        wanted = "position with height and attitude" if needs == "pose" else "latitude and longitude"
        raise DataError(
            f"the {track.name} nowhere knows its {wanted}, which {name} needs",
            where=source.name,
            remedy="smooth the dive and export the result; geojson, kml and csv need no height and no attitude",
        )
    kept = track.select(fits)
    if rate_hz is not None:
        kept = thinned(kept, rate_hz)
    return replace(source, track=kept), int((~fits).sum())


def _write_places(source: Source, out: Path, name: FormatName) -> None:
    with atomic_file(out) as file:
        if name == "geojson":
            write_geojson(source.track, source.fixes, file)
        elif name == "kml":
            write_kml(source.track, source.fixes, file, source.name)
        else:
            write_csv(source.track, source.fixes, file)


def _write_poses(source: Source, out: Path, name: FormatName, axes: Axes, overwrite: bool) -> None:
    track = source.track
    assert track is not None
    if _is_folder(out, name):
        with atomic_folder(out, replaces=str(ASL_STATES) if overwrite else None) as folder:
            write_asl_folder(track, source.dive, folder, axes)
        return
    if name == "kitti":
        with atomic_file(files_of(out, name)[1]) as times:
            write_kitti_times(track, times)
    writers = {"tum": write_tum, "kitti": write_kitti, "euroc": write_euroc}
    with atomic_file(out) as file:
        writers[name](track, file, axes)


def _write_mcap(source: Source, out: Path, axes: Axes, progress: Callable[[float], None]) -> int:
    from uwgraph.export.mcap_file import write_mcap
    from uwgraph.export.topics import sensor_topics, track_topics

    topics = track_topics(source.track, axes) if source.track is not None else []
    metadata = {"source": source.name, "frames": str(axes), "uwgraph": __version__}
    origin = source.track.origin if source.track is not None else source.dive.origin if source.dive else None
    if origin is not None:
        lat, lon = np.degrees([origin.lat, origin.lon]).tolist()
        metadata |= {"origin_lat_deg": repr(lat), "origin_lon_deg": repr(lon)}
    if source.dive is not None:
        topics += sensor_topics(source.dive)
        metadata["rig"] = json.dumps(source.dive.rig.model_dump(mode="json"))
    with atomic_file(out) as file:
        return write_mcap(topics, file, metadata, progress)


def _is_folder(path: Path, name: FormatName) -> bool:
    return name == "euroc" and not path.suffix
