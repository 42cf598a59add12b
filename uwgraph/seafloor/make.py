"""Maps made from a dive and its solution, and maps re-deformed by a better one."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from uwgraph.atomic import atomic_folder, refuse_taken
from uwgraph.camera.eyes import Eyes
from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.export.track import Track
from uwgraph.seafloor.clean import open3d
from uwgraph.seafloor.folder import (
    KEYFRAMES,
    REPORT,
    patch_files,
    read_map_settings,
    write_map_settings,
    write_products,
)
from uwgraph.seafloor.links import Pairs, verified_closures
from uwgraph.seafloor.measure import patches
from uwgraph.seafloor.patch import write_patch
from uwgraph.seafloor.render import render_map
from uwgraph.seafloor.settings import MapSettings
from uwgraph.seafloor.survey import plan_survey, voxel_of

Progress = Callable[[str, float], None]


def make_map(
    dive: Dive,
    eyes: Eyes,
    track: Track,
    out: str | Path,
    settings: MapSettings | None = None,
    *,
    closures_ns: Pairs | None = None,
    overwrite: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Map the floor that ``eyes`` saw along ``track`` into the folder ``out``, whole or not at all.

    Images that are missing or damaged, or do not show the floor, are left out and counted. ``closures_ns``, shape
    (L, 2), are the moments of the closures that the track rests on; where not given, those that the dive has verified.

    Returns
    -------
    dict
        The figures of ``map.json``: plain values.

    Raises
    ------
    ConfigError, DataError
        As :func:`uwgraph.seafloor.survey.plan_survey` and :func:`uwgraph.seafloor.render.render_map`; when no image
        could be used; when the folder is taken or cannot be written.
    """
    settings, tell = settings or MapSettings(), progress or _silent
    replaces = REPORT if overwrite else None
    refuse_taken(out, replaces)
    open3d()  # that it is missing is told before the long work
    tell("planning", 0.0)
    survey = plan_survey(dive, eyes, track, settings)
    settings = settings.model_copy(update={"voxel_m": voxel_of(settings, survey.usual)})
    with atomic_folder(out, replaces) as folder:
        write_map_settings(folder, settings)
        (folder / KEYFRAMES).mkdir()
        refused: list[DataError] = []
        for made in patches(survey, settings, lambda share: tell("measuring the floor", share)):
            if isinstance(made, DataError):
                refused.append(made)
            else:
                write_patch(folder / KEYFRAMES, made)
        if len(refused) == len(survey.t_ns):
            raise DataError(
                f"none of {len(refused)} images could be used; the first: {refused[0].where}: {refused[0].problem}",
                where=f"images/{eyes.first.name}",
                remedy="look at this image, at the camera file, and at the altitudes",
            )
        about = {
            "cameras": list(eyes.names),
            "ranges": "stereo" if eyes.second is not None else "altitude",
            "images": len(eyes.t_ns),
            "left_out": survey.left_out,
            "refused": _reasons(refused),
        }
        return _render(dive, track, folder, settings, closures_ns, about, title, tell)


def deform_map(
    dive: Dive,
    source: str | Path,
    track: Track,
    out: str | Path,
    *,
    closures_ns: Pairs | None = None,
    overwrite: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """The map ``source`` with its keyframes at the poses of a better solution, in the folder ``out``.

    Nothing is measured again, and the dive's images are not needed: the patches move as they are, and are fused and
    drawn anew. ``out`` may be ``source`` with ``overwrite``. Returns and raises as :func:`make_map`.
    """
    tell, origin = progress or _silent, Path(source)
    replaces = REPORT if overwrite else None
    refuse_taken(out, replaces)
    files, settings = patch_files(origin), read_map_settings(origin)
    with atomic_folder(out, replaces) as folder:
        write_map_settings(folder, settings)
        (folder / KEYFRAMES).mkdir()
        for file in files:
            shutil.copyfile(file, folder / KEYFRAMES / file.name)
        return _render(dive, track, folder, settings, closures_ns, {"deformed_from": str(origin)}, title, tell)


def _render(
    dive: Dive,
    track: Track,
    folder: Path,
    settings: MapSettings,
    closures_ns: Pairs | None,
    about: dict[str, Any],
    title: str,
    tell: Progress,
) -> dict[str, Any]:
    assert settings.voxel_m is not None
    files = sorted((folder / KEYFRAMES).iterdir(), key=lambda file: int(file.stem))
    found = render_map(
        dive,
        track,
        files,
        voxel=settings.voxel_m,
        pixel=settings.pixel_m,
        max_pixels=settings.max_pixels,
        progress=tell,
    )
    tell("writing", 0.0)
    ends = verified_closures(dive) if closures_ns is None else closures_ns
    return write_products(folder, found, ends, about, title)


def _reasons(refused: list[DataError]) -> dict[str, int]:
    """How often each reason was given, without the particulars in brackets."""
    return dict(Counter(error.problem.partition(" (")[0] for error in refused))


def _silent(doing: str, share: float) -> None:
    pass
