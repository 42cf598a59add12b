"""From an image to one vector: enhanced, local features, VLAD."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from uwgraph.dive.rig import Settings
from uwgraph.places.enhance import Enhancement, Grey
from uwgraph.places.local import LocalFeatures, LocalSettings, features_of
from uwgraph.places.vlad import Vocabulary, vlad
from uwgraph.types import BoolArray

Descriptor = NDArray[np.float32]
"""Of one image, of unit length, shape (D,)."""


class DescriberSettings(Settings):
    """How an image becomes a vector."""

    enhancement: Enhancement = "clahe"
    local: LocalSettings = LocalSettings()
    words: Annotated[int, Field(ge=2, le=4096)] = 32
    """Of the vocabulary."""
    components: Annotated[int, Field(ge=2, le=256)] = 64
    """Of the PCA of local descriptors; words times components is the length of the global one."""
    few: Annotated[int, Field(ge=1, le=1000)] = 10
    """An image with fewer features has no descriptor: there is nothing to recognise."""


class Describer(Protocol):
    """What makes a global descriptor."""

    @property
    def size(self) -> int:
        """Length of the descriptor."""
        ...

    def describe(self, image: NDArray[Any], mask: Grey | None = None) -> Descriptor | None:
        """The descriptor of an image where ``mask`` is not 0; None where nothing can be recognised."""
        ...


@dataclass(frozen=True, eq=False)
class VladDescriber:
    """VLAD of local features."""

    vocabulary: Vocabulary
    settings: DescriberSettings = field(default_factory=DescriberSettings)

    @classmethod
    def learn(
        cls,
        images: Iterable[NDArray[Any]],
        settings: DescriberSettings | None = None,
        mask: Grey | None = None,
        random_state: int = 0,
    ) -> VladDescriber:
        """The describer whose vocabulary is learnt from images; some hundred spread over a dive suffice."""
        settings = settings or DescriberSettings()
        features = [features_of(image, settings.enhancement, settings.local, mask) for image in images]
        return cls(Vocabulary.learn(features, settings.words, settings.components, random_state), settings)

    @property
    def size(self) -> int:
        return self.vocabulary.size

    def describe(self, image: NDArray[Any], mask: Grey | None = None) -> Descriptor | None:
        """See :class:`Describer`."""
        return self.of_features(features_of(image, self.settings.enhancement, self.settings.local, mask))

    def of_features(self, features: LocalFeatures) -> Descriptor | None:
        """The descriptor of features that are known already."""
        return vlad(features, self.vocabulary) if len(features) >= self.settings.few else None


def describe_all(
    describer: Describer,
    images: Sequence[Callable[[], NDArray[Any]]],
    mask: Grey | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.float32], BoolArray]:
    """Descriptors of many images, each made when its turn comes.

    Returns
    -------
    X : shape (N, D)
        Zeros where an image has none.
    found : shape (N,)
        Whether it has one.
    """
    X = np.zeros((len(images), describer.size), np.float32)
    found = np.zeros(len(images), dtype=np.bool_)
    for i, image in enumerate(images):
        descriptor = describer.describe(image(), mask)
        if descriptor is not None:
            X[i], found[i] = descriptor, True
        if progress is not None:
            progress((i + 1) / len(images))
    return X, found
