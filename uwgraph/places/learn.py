"""A model of places from dives: the vocabulary of their images, and the metric of their positions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.eyes import Eyes
from uwgraph.errors import DataError
from uwgraph.places.deep import OnnxDescriber
from uwgraph.places.describe import DescriberSettings, Descriptor, VladDescriber
from uwgraph.places.enhance import Grey, enhance, scene_mask
from uwgraph.places.model_file import PlaceModel
from uwgraph.places.train import TrainSettings, train
from uwgraph.types import FloatArray

MASK_FROM: Final = 40
"""Images, spread over a dive, that tell what stands still in all of them."""
VOCABULARY_FROM: Final = 300
"""Images, spread over all dives, whose features the words are learnt from."""


@dataclass(frozen=True, eq=False)
class Survey:
    """Images of one dive and where they were taken."""

    eyes: Eyes
    positions: FloatArray
    """Of the images, in one frame for all dives, shape (N, 3), m; NaN where not known."""

    @property
    def known(self) -> NDArray[np.intp]:
        """Images whose position is known."""
        return np.flatnonzero(np.isfinite(self.positions).all(axis=1))


@dataclass(frozen=True, eq=False)
class Learnt:
    """A model and what it was learnt from."""

    model: PlaceModel
    images: int
    """That taught it."""
    unread: tuple[str, ...]
    """What was wrong with images that could not be read."""


def learn_places(
    surveys: Sequence[Survey],
    settings: TrainSettings,
    describer: DescriberSettings | OnnxDescriber | None = None,
    progress: Callable[[float], None] | None = None,
    *,
    or_plain: bool = False,
) -> Learnt:
    """Learn how images become descriptors, and under which metric those of one place are near each other.

    With ``or_plain`` the Euclidean metric where the positions tell no two places apart.

    Raises
    ------
    DataError
        When there are too few images with features, or too few places.
    """
    unread: list[str] = []
    masks = [still_mask(survey.eyes) for survey in surveys]
    maker = describer if isinstance(describer, OnnxDescriber) else _vocabulary(surveys, masks[0], describer, unread)
    total = sum(len(survey.known) for survey in surveys)
    X: list[Descriptor] = []
    positions: list[FloatArray] = []
    done = 0
    for survey, mask in zip(surveys, masks, strict=True):
        for k, image in _read(survey.eyes, survey.known, unread):
            found = maker.describe(image, mask)
            if found is not None:
                X.append(found)
                positions.append(survey.positions[k])
            done += 1
            if progress is not None:
                progress(done / total)
    if not X:
        raise DataError(
            f"none of {total} images with a known position shows anything to recognise",
            where="training of places",
            remedy="; ".join(unread[:1]) or "are the images blank, or black?",
        )
    metric = train(np.array(X), np.array(positions), settings, or_plain=or_plain)
    return Learnt(PlaceModel(maker, metric), len(X), tuple(unread))


def _vocabulary(
    surveys: Sequence[Survey], mask: Grey | None, settings: DescriberSettings | None, unread: list[str]
) -> VladDescriber:
    every = max(sum(len(survey.known) for survey in surveys) // VOCABULARY_FROM, 1)
    images = (image for survey in surveys for _, image in _read(survey.eyes, survey.known[::every], unread))
    first = next(images, None)
    if first is None:
        raise DataError(
            "there is no image whose position is known, or none can be read",
            where="training of places",
            remedy="; ".join(unread[:1]) or "do the images' stamps lie within the dive? see rig.visual.time_offset_s",
        )
    describer = VladDescriber.learn(chain([first], images), settings, mask)
    unread.clear()  # they are read again
    return describer


def still_mask(eyes: Eyes) -> Grey | None:
    """Where the images show the scene and not a burned-in clock or the vehicle; None where nothing stands still."""
    some = np.unique(np.linspace(0, len(eyes) - 1, MASK_FROM).astype(np.intp))
    return scene_mask(enhance(image, "none") for _, image in _read(eyes, some, []))


def _read(eyes: Eyes, rows: NDArray[np.intp], unread: list[str]) -> Iterator[tuple[int, NDArray[Any]]]:
    """Those of the (left) images that can be read."""
    for k in rows.tolist():
        try:
            yield k, eyes.first.read(k)
        except DataError as error:
            unread.append(str(error))
