"""A trained model of places: how an image becomes a descriptor, and the metric of descriptors; one ``.npz`` file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.dive.yamlfile import parse_settings
from uwgraph.errors import DataError
from uwgraph.places.deep import OnnxDescriber, OnnxSettings
from uwgraph.places.describe import DescriberSettings, Descriptor, VladDescriber
from uwgraph.places.enhance import Enhancement, Grey
from uwgraph.places.local import LocalFeatures, LocalSettings
from uwgraph.places.metric import Metric
from uwgraph.places.npz import Arrays, checked, json_value, read_npz, write_npz
from uwgraph.places.vlad import Vocabulary

KIND: Final = "uwgraph place model"


@dataclass(frozen=True, eq=False)
class PlaceModel:
    """From an image to the vector z in which nearness means the same place."""

    describer: VladDescriber | OnnxDescriber
    metric: Metric

    @property
    def size(self) -> int:
        """Length of z."""
        return self.metric.size

    def describe(self, image: NDArray[Any], mask: Grey | None = None) -> NDArray[np.float32] | None:
        """z of an image, shape (size,); None where nothing can be recognised."""
        return self._project(self.describer.describe(image, mask))

    def takes(self, enhancement: Enhancement, local: LocalSettings) -> bool:
        """Whether :meth:`of_features` takes features that were found this way."""
        s = self.describer.settings
        return isinstance(s, DescriberSettings) and (s.enhancement, s.local) == (enhancement, local)

    def of_features(self, features: LocalFeatures) -> NDArray[np.float32] | None:
        """:meth:`describe` of features that were found already, as :meth:`takes` says."""
        assert isinstance(self.describer, VladDescriber)
        return self._project(self.describer.of_features(features))

    def _project(self, descriptor: Descriptor | None) -> NDArray[np.float32] | None:
        return None if descriptor is None else self.metric.project(descriptor)

    def save(self, path: str | Path) -> None:
        """Write the model. An ONNX network stays where it is; its path and checksum are written."""
        m = self.metric
        metric = {"mean": m.mean, "components": m.components, "change": m.change, "scale": np.array(m.scale)}
        write_npz(path, KIND, _describer_arrays(self.describer) | metric)

    @classmethod
    def load(cls, path: str | Path) -> PlaceModel:
        """Read what :meth:`save` wrote.

        Raises
        ------
        DataError
            For any other file, or when its ONNX network is missing or has changed.
        ConfigError
            When its settings are not those of this version.
        """
        where, arrays = str(path), read_npz(path, KIND)
        describer = _describer_of(arrays, where)
        mean = checked(arrays, "mean", (describer.size,), where, "f")
        components = checked(arrays, "components", (None, describer.size), where, "f")
        change = checked(arrays, "change", (len(components), len(components)), where, "f")
        scale = float(checked(arrays, "scale", (), where, "f"))
        if not scale > 0.0:
            raise DataError(f"scale is {scale:g}, not above 0", where=where, remedy="train again")
        mean, components, change = (a.astype(np.float32) for a in (mean, components, change))
        return cls(describer, Metric(mean, components, change, scale))


def _describer_arrays(describer: VladDescriber | OnnxDescriber) -> Arrays:
    settings = np.array(describer.settings.model_dump_json())
    if isinstance(describer, VladDescriber):
        v = describer.vocabulary
        return {
            "describer": np.array("vlad"),
            "settings": settings,
            "local_mean": v.mean,
            "local_axes": v.axes,
            "words": v.words,
        }
    checksum = np.array(describer.checksum)
    return {"describer": np.array("onnx"), "settings": settings, "checksum": checksum, "size": np.array(describer.size)}


def _describer_of(arrays: Arrays, where: str) -> VladDescriber | OnnxDescriber:
    kind = str(checked(arrays, "describer", (), where, "U"))
    values = json_value(arrays, "settings", where)
    if kind == "onnx":
        describer = OnnxDescriber.open(parse_settings(OnnxSettings, values, where))
        if describer.checksum != str(checked(arrays, "checksum", (), where, "U")):
            raise DataError(
                f"was trained with another network than {describer.settings.path}",
                where=where,
                remedy="put the network back, or train again",
            )
        return describer
    if kind != "vlad":
        raise DataError(f"unknown describer {kind[:40]!r}", where=where, remedy="train again with this version")
    settings = parse_settings(DescriberSettings, values, where)
    mean = checked(arrays, "local_mean", (settings.local.width,), where, "f")
    axes = checked(arrays, "local_axes", (None, settings.local.width), where, "f")
    words = checked(arrays, "words", (settings.words, len(axes)), where, "f")
    return VladDescriber(Vocabulary(*(a.astype(np.float32) for a in (mean, axes, words))), settings)
