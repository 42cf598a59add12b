"""A rig on its own: a YAML file that goes onto other dives of the same vehicle.

The file is the ``rig:`` block of ``dive.yaml``, with comments on top that say where it comes from.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import yaml

from uwgraph.atomic import atomic_file
from uwgraph.dive.folder import HEADER, Header
from uwgraph.dive.model import Dive
from uwgraph.dive.rig import Rig
from uwgraph.dive.yamlfile import parse_settings, read_settings, read_yaml


def read_rig(path: str | Path) -> Rig:
    """The rig of a rig file; raises :class:`ConfigError` naming file and key."""
    return read_settings(Rig, Path(path))


def write_rig(rig: Rig, path: str | Path, remarks: Iterable[str] = ()) -> None:
    """Write a rig file, whole or not at all; ``remarks`` become comments on top.

    Raises
    ------
    DataError
        When the place cannot be written.
    """
    comments = "".join(f"# {_printable(line)}\n" for remark in remarks for line in remark.splitlines())
    with atomic_file(path) as partial:
        partial.write_text(comments + _yaml(rig.model_dump(mode="json")), encoding="utf-8")


def apply_rig(dive: Dive, rig: Rig, *, keep_clocks: bool) -> Dive:
    """The dive with another rig; ``keep_clocks`` leaves the clock offsets that the dive had."""
    if keep_clocks:
        clocks = {
            name: getattr(rig, name).model_copy(update={"time_offset_s": getattr(dive.rig, name).time_offset_s})
            for name in Rig.model_fields
        }
        rig = rig.model_copy(update=clocks)
    return replace(dive, rig=rig)


def write_rig_into(folder: str | Path, rig: Rig, remark: str) -> None:
    """Replace the rig in a dive folder, whole or not at all; ``remark`` joins the provenance's conversions.

    Raises
    ------
    ConfigError, DataError
        When the folder is no dive, or cannot be written.
    """
    header = Path(folder) / HEADER
    values = read_yaml(header)
    parse_settings(Header, values, str(header))
    provenance = values.get("provenance") or {}
    earlier = provenance.get("conversions") or []
    notes = [*(earlier if isinstance(earlier, list) else [earlier]), remark]
    values |= {"rig": rig.model_dump(mode="json"), "provenance": {**provenance, "conversions": notes}}
    with atomic_file(header) as partial:
        partial.write_text(_yaml(values), encoding="utf-8")


def _printable(text: str) -> str:
    """The text without what YAML takes for a broken file: names of files can hold anything."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _yaml(values: object) -> str:
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
