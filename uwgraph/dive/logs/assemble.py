"""A log and its mapping to a dive: check the mapping, pour once, order the stamps, build the streams."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from uwgraph.dive.logs.images import ImageSink
from uwgraph.dive.logs.log import Log, Progress
from uwgraph.dive.logs.mapping import ImagesMapping, LogMapping
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.plan import Plan, by_topic
from uwgraph.dive.logs.samples import ROW, Samples
from uwgraph.dive.logs.streams import BUILDERS
from uwgraph.dive.logs.window import Window, refuse_gaps
from uwgraph.dive.model import Dive
from uwgraph.dive.rig import Rig
from uwgraph.errors import DataError
from uwgraph.types import Images, Origin


@dataclass(frozen=True)
class Wishes:
    """What the user says besides the mapping; each wins over the mapping and the log."""

    origin: Origin | None = None
    rig: Rig | None = None
    window: Window = field(default_factory=Window)


def assemble(
    log: Log, mapping: LogMapping, wishes: Wishes, images_into: Path | None, progress: Progress
) -> tuple[Dive, Notes]:
    """The dive that the mapping makes of the log.

    Parameters
    ----------
    log : Log
        Open.
    mapping : LogMapping
        Which topics to take.
    wishes : Wishes
        Origin, rig and part of the log.
    images_into : Path, optional
        Where image files go, in folders by camera; without it images are not read.
    progress : callable
        Told the share of the log that has been read.

    Raises
    ------
    ConfigError
        When the mapping names what is not in the log; before anything is read.
    DataError
        When the log is damaged, or nothing of it is usable.
    """
    notes = Notes()
    plans = {
        name: Plan(name, stream, log.topics, images_into)
        for name, stream in mapping.by_stream().items()
        if images_into is not None or not isinstance(stream, ImagesMapping)
    }
    stated = _stated_origin(log, mapping, wishes)
    log.pour(by_topic(list(plans.values())), progress)
    samples = _samples(plans, wishes.window, notes)
    dive = Dive(stated or _first_place(samples, notes), _rig(log, mapping, wishes))
    if "imu" in samples:
        refuse_gaps(samples["imu"].t_ns)
    for name, build in BUILDERS.items():
        if name in samples:
            # taken out, since a long log fills the memory once, not twice
            stream: Any = build(samples.pop(name), plans[name].mapping, dive, notes)
            dive = replace(dive, **{name: stream}) if len(stream) else _without(name, dive, notes)
    _refuse_upside_down(dive)
    images = {
        camera: found
        for name, plan in plans.items()
        if isinstance(plan.sink, ImageSink)
        and (found := _images(plan.sink, camera := name.partition("/")[2], samples.get(name), notes))
    }
    return replace(dive, images=images), notes


def _samples(plans: Mapping[str, Plan], window: Window, notes: Notes) -> dict[str, Samples]:
    """The samples of every stream that has any."""
    found: dict[str, Samples] = {}
    for name, plan in plans.items():
        samples = plan.samples(notes)
        if len(samples):
            found[name] = samples
        else:
            notes.caveats.append(f"{name}: no message of {plan.topic.name} is usable; left out")
    if not found:
        raise DataError(
            "no stream of the mapping has a usable message",
            where="log",
            remedy="; ".join(notes.caveats) or "map a topic to a stream",
        )
    return window.cut(found, notes)


def _without(name: str, dive: Dive, notes: Notes) -> Dive:
    notes.caveats.append(f"{name}: nothing usable; left out")
    return dive


def _refuse_upside_down(dive: Dive) -> None:
    """A wrong guess of axes, told in the mapping's words."""
    if dive.imu is not None and (f_z := float((dive.rig.imu.R_bs @ dive.imu.f_s.mean(axis=0))[2])) > 0:
        raise DataError(
            f"the mean specific force along z is {f_z:+.2f} m/s^2: the vehicle would hang upside down",
            where="imu: axes",
            remedy="set 'axes: flu' of imu in the mapping (--mapping-out writes one), or the mounting in "
            "rig.imu.rotation_deg",
        )


def _rig(log: Log, mapping: LogMapping, wishes: Wishes) -> Rig:
    if wishes.rig is not None:
        return wishes.rig
    return mapping.rig if "rig" in mapping.model_fields_set else log.known.rig


def _stated_origin(log: Log, mapping: LogMapping, wishes: Wishes) -> Origin | None:
    """The origin that somebody states; None where the positions will tell. An error now if nothing will."""
    if wishes.origin is not None:
        return wishes.origin
    stated = mapping.origin or log.known.origin
    if stated is not None:
        return Origin(float(np.radians(stated.lat_deg)), float(np.radians(stated.lon_deg)))
    places = (mapping.streams.fixes, mapping.streams.reference)
    if not any(place is not None and place.lat is not None for place in places):
        raise _no_origin()
    return None


def _first_place(samples: Mapping[str, Samples], notes: Notes) -> Origin:
    for name in ("fixes", "reference"):
        if name in samples and "lat" in samples[name]:
            places = np.column_stack([samples[name]["lat"], samples[name]["lon"]])
            known = places[np.isfinite(places).all(axis=1)]
            if len(known):
                notes.conversions.append(f"origin: the first position of {name}")
                return Origin(float(known[0, 0]), float(known[0, 1]))
    raise _no_origin()


def _no_origin() -> DataError:
    return DataError(
        "nothing in the log tells where on Earth it was",
        where="origin",
        remedy="say it: import --origin LAT,LON in degrees, or 'origin: {lat_deg: ..., lon_deg: ...}' in the mapping",
    )


def _images(sink: ImageSink, camera: str, samples: Samples | None, notes: Notes) -> Images | None:
    """The images of one camera; files of those that are not taken are removed."""
    where = f"images/{camera}"
    if sink.skipped:
        notes.caveats.append(f"{where}: {len(sink.skipped)} images left out, the first: {sink.skipped[0]}")
    rows = samples[ROW].astype(np.int64) if samples is not None else np.empty(0, dtype=np.int64)
    files = sink.keep(rows)
    if samples is None:
        return None
    notes.conversions.append(f"{where}: {', '.join(sorted(sink.encodings))} images as files")
    return Images(samples.t_ns, files, camera)
