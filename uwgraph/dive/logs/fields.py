"""Fields of messages by path: ``linear_acceleration.x``, ``data[3]``; by attribute, or by key where it is a mapping."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any, Final

from uwgraph.dive.logs.log import Topic
from uwgraph.dive.logs.quantity import Quantity
from uwgraph.errors import ConfigError

Row = Callable[[Any], Sequence[Any]]
"""The values of several fields of a message."""

MAX_DEPTH: Final = 32
"""Steps of a path."""

_PATH: Final = re.compile(r"[^.\[\]]+(?:\.[^.\[\]]+|\[\d{1,6}\])*")
_STEP: Final = re.compile(r"\.?([^.\[\]]+)|\[(\d+)\]")
_INDEX: Final = re.compile(r"\[\d+\]")


def row_getter(paths: Sequence[str], message: Any) -> Row:
    """What reads the fields of messages like ``message``, which is the first of its topic."""
    if len(paths) > 1 and not isinstance(message, Mapping) and not any("[" in path for path in paths):
        at_once = attrgetter(*paths)
        if _works(at_once, message):
            return at_once
    steps = [_steps(path) for path in paths]
    return lambda message: [_walk(message, path) for path in steps]


def constant(quantity: Quantity, fields: Sequence[str]) -> float | None:
    """The number that stands in the place of a field's name, as in ``sigma: 5 [deg]``."""
    if quantity.path in fields:
        return None
    try:
        return float(quantity.path)
    except ValueError:
        return None


def resolve(quantity: Quantity, topic: Topic, where: str) -> str:
    """The path of a quantity in the messages of a topic: its name, or where columns bear their units its name and unit.

    Raises
    ------
    ConfigError
        When the topic's fields are known and it is none of them, with those that are nearest.
    """
    with_unit = f"{quantity.path} [{quantity.unit}]"
    for path in (quantity.path, with_unit):
        if path in topic.fields:
            return path
    known = {_INDEX.sub("", field) for field in topic.fields}
    is_path = _PATH.fullmatch(quantity.path) and quantity.path.count(".") + quantity.path.count("[") <= MAX_DEPTH
    if is_path and (not topic.fields or _INDEX.sub("", quantity.path) in known):
        return quantity.path
    raise ConfigError(
        f"topic {topic.name!r} has no field {quantity.path!r}",
        where=where,
        remedy=f"{nearest(quantity.path, topic.fields)}its fields: {', '.join(topic.fields[:40]) or 'none'}",
    )


def topic_named(name: str, topics: Sequence[Topic], where: str) -> Topic:
    """The topic of that name; raises ConfigError with the nearest names when there is none."""
    found = next((topic for topic in topics if topic.name == name), None)
    if found is not None:
        return found
    names = [topic.name for topic in topics]
    raise ConfigError(
        f"the log has no topic {name!r}",
        where=where,
        remedy=f"{nearest(name, names)}its topics: {', '.join(names[:40]) or 'none'}",
    )


def nearest(name: str, known: Sequence[str]) -> str:
    """``did you mean ...?`` with the nearest known names, or nothing."""
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    return f"did you mean {' or '.join(map(repr, near))}? " if near else ""


def _works(getter: Callable[[Any], Any], message: Any) -> bool:
    try:
        getter(message)
    except (AttributeError, TypeError):
        return False
    return True


def _steps(path: str) -> list[str | int]:
    return [name or int(index) for name, index in _STEP.findall(path)]


def _walk(message: Any, steps: list[str | int]) -> Any:
    """The value at the end of the path; None where the message does not go so far."""
    try:
        for step in steps:
            by_key = isinstance(step, int) or isinstance(message, Mapping)
            message = message[step] if by_key else getattr(message, str(step))
    except (AttributeError, LookupError, TypeError):
        return None
    return message
