"""YAML files of settings, read safely; every fault named by file and key, with the nearest known key."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Hashable
from pathlib import Path
from typing import Any, Final, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from uwgraph.errors import ConfigError

Model = TypeVar("Model", bound=BaseModel)

MAX_BYTES: Final = 1 << 20
"""Larger settings files are refused."""


class _Loader(yaml.SafeLoader):
    """Plain values only; a doubled key or an alias is an error (aliases can blow up a small file)."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not accepted")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        keys = [key for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        seen: set[str] = set()
        for key in keys:
            if key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"key {key.value!r} appears twice", problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def read_settings(model: type[Model], path: Path) -> Model:
    """The settings of a YAML file, of at most :data:`MAX_BYTES`.

    Raises
    ------
    ConfigError
        When the file is missing, too large, not YAML, or has an unknown key or an unusable value.
    """
    return parse_settings(model, read_yaml(path), str(path))


def read_yaml(path: Path) -> Any:
    """The plain values of a YAML file; raises :class:`ConfigError` as :func:`read_settings` does."""
    return parse_yaml(read_text(path), str(path))


def read_text(path: Path) -> str:
    """The text of a settings file in UTF-8, of at most :data:`MAX_BYTES`."""
    try:
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(
            f"cannot be read ({error.strerror})", where=str(path), remedy="check the name and the permissions"
        ) from error
    if len(text) > MAX_BYTES:
        raise ConfigError(f"is larger than {MAX_BYTES} bytes", where=str(path), remedy="is this the right file?")
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"is not plain YAML text ({str(error)[:100]})", where=str(path), remedy="copy it again, or correct it"
        ) from error


def parse_yaml(text: str, where: str) -> Any:
    """The plain values of YAML text; ``where`` names the file."""
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ConfigError(f"{line}{error.problem}", where=where, remedy="correct the YAML") from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise ConfigError(
            f"is not plain YAML text ({str(error)[:100]})", where=where, remedy="copy it again, or correct it"
        ) from error


def parse_settings(model: type[Model], values: Any, where: str) -> Model:
    """The settings of plain values; ``where`` names the file.

    Raises
    ------
    ConfigError
        For the first fault, naming its key and, where the key is unknown, the nearest known one.
    """
    try:
        return model.model_validate(values if values is not None else {})
    except ValidationError as error:
        raise _explained(model, error, where) from error


def _explained(model: type[BaseModel], error: ValidationError, where: str) -> ConfigError:
    first = error.errors(include_url=False, include_context=False)[0]
    place = [str(part) for part in first["loc"]]
    where = f"{where}: {'.'.join(place)}" if place else where
    if first["type"] == "extra_forbidden":
        known = list(_model_at(model, place[:-1]).model_fields)
        near = difflib.get_close_matches(place[-1], known, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return ConfigError("unknown key", where=where, remedy=f"{hint}known keys: {', '.join(known)}")
    if first["type"] == "missing":
        return ConfigError("is missing", where=where, remedy="add it")
    message = first["msg"][:1].lower() + first["msg"][1:]
    return ConfigError(f"{message}, found {str(first['input'])[:60]!r}", where=where, remedy="correct the value")


def _model_at(model: type[BaseModel], place: list[str]) -> type[BaseModel]:
    """The model that the keys of ``place`` lead to."""
    for key in place:
        if field := model.model_fields.get(key):
            model = next((part for part in _parts(field.annotation) if issubclass(part, BaseModel)), model)
    return model


def _parts(annotation: Any) -> list[type]:
    """The classes in an annotation, those of unions and containers included."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType, tuple, list, dict):
        return [part for argument in typing.get_args(annotation) for part in _parts(argument)]
    return [annotation] if isinstance(annotation, type) else []
