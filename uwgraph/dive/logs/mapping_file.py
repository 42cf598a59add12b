"""The mapping as a file that people edit: what is taken as YAML, what is left as comments with its fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import yaml

from uwgraph.dive.logs.guess import Left
from uwgraph.dive.logs.log import Topic
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.rig import Rig

NAME: Final = "mapping.yaml"
MAX_FIELDS: Final = 60
"""So many fields of a topic are listed."""

_HEAD: Final = """\
# What each topic of the log becomes. Edit it, and import again with --mapping THIS_FILE.
# A field is named with its sign and unit: '-acc_y [mg]'; without a unit it is SI. A number in a field's place is a
# constant: sigma: '0.3 [m]'. How every stream is written: docs/import.md.
"""
_EMPTY: Final = """\
#   imu: {topic: NAME, f: [FIELD, FIELD, FIELD], w: [FIELD, FIELD, FIELD], axes: flu}
#   dvl: {topic: NAME, v: [FIELD, FIELD, FIELD], axes: frd}
#   depth: {topic: NAME, pressure: 'FIELD [hPa]', surface_pressure_pa: first}
#   fixes: {topic: NAME, lat: 'FIELD [deg]', lon: 'FIELD [deg]'}
#   heading: {topic: NAME, heading: 'FIELD [deg]', reference: magnetic}
"""


def mapping_text(mapping: LogMapping, topics: Sequence[Topic], left: Sequence[Left]) -> str:
    """The file's text; reads back as the same mapping."""
    values = mapping.model_dump(mode="json", exclude_none=True, exclude={"left", "streams", "images"})
    if mapping.rig == Rig():
        del values["rig"]
    for name, stream in mapping.by_stream().items():
        kind, _, camera = name.partition("/")
        stated = stream.model_dump(mode="json", include=set(stream.relevant()))
        values.setdefault("images" if camera else "streams", {})[camera or kind] = stated
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110)
    parts = [_HEAD, text if values else "", "" if mapping.by_stream() else f"# streams:\n{_EMPTY}"]
    return "".join(parts) + _left_text(topics, left)


def _left_text(topics: Sequence[Topic], left: Sequence[Left]) -> str:
    if not left:
        return ""
    known = {topic.name: topic for topic in topics}
    lines = ["", "# Topics that are left:"]
    for item in left:
        count = "" if item.messages is None else f", {item.messages} messages"
        lines.append(f"#   {_plain(item.topic)} ({_plain(item.type)}{count}): {_plain(item.why)}")
        lines += _field_lines(known[item.topic])
    return "\n".join(lines) + "\n"


def _field_lines(topic: Topic) -> list[str]:
    fields = [
        _plain(f"{name} [{unit}]" if (unit := topic.units.get(name, "")) else name)
        for name in topic.fields[:MAX_FIELDS]
    ]
    more = [f"... ({len(topic.fields)} in all)"] if len(topic.fields) > MAX_FIELDS else []
    lines, line = [], ""
    for name in fields + more:
        if line and len(line) + len(name) > 100:
            lines.append(line)
            line = ""
        line += (", " if line else "") + name
    return [f"#       {line}" for line in [*lines, line] if line]


def _plain(text: str) -> str:
    """On one line and printable: names in a log may hold anything."""
    return "".join(c if c.isprintable() else "?" for c in text)[:200]
