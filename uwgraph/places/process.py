"""Visual odometry and places seen again of a whole dive: images read once, what looks alike verified by geometry."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from uwgraph.camera.eyes import Eyes
from uwgraph.dive import Dive
from uwgraph.dive.rig import Positive, Settings
from uwgraph.errors import DataError
from uwgraph.places.aids import Known
from uwgraph.places.describe import Descriptor
from uwgraph.places.enhance import Grey
from uwgraph.places.known import known_of
from uwgraph.places.learn import still_mask
from uwgraph.places.local import LocalFeatures, features_of
from uwgraph.places.model_file import PlaceModel
from uwgraph.places.motion import Motion, relative_poses
from uwgraph.places.odometry import OdometrySettings, track
from uwgraph.places.stereo import of_one_moment
from uwgraph.places.topology import TopologicalMap, TopologySettings
from uwgraph.places.verify import VerifySettings, verify
from uwgraph.places.view import WATER, View, view_of_features
from uwgraph.types import FloatArray, RelativePoses

TOPOLOGY: Final = "places.npz"
"""The topological map, beside the images of its camera."""
_KEPT: Final = 256
"""Views of earlier images that are kept, about a megabyte each."""


class MatchSettings(Settings):
    """How places seen again are looked for."""

    candidates: Annotated[int, Field(ge=1, le=100)] = 3
    """Images most alike that are verified, for each image of a keyframe of the odometry."""
    apart_s: Positive = 20.0
    """What lies nearer in time is not a place seen again."""
    odometry: OdometrySettings = OdometrySettings()
    verify: VerifySettings = VerifySettings()


@dataclass(frozen=True, eq=False)
class Matched:
    """What the images of a dive say."""

    odometry: RelativePoses
    closures: RelativePoses
    """Candidates of every keyframe: accepted, or why not."""
    topology: TopologicalMap
    images: int
    described: int
    """Images with anything to recognise."""
    unread: list[str] = field(default_factory=list)
    """What was wrong with images that could not be read."""


def match_places(
    dive: Dive,
    eyes: Eyes,
    model: PlaceModel,
    poses: FloatArray,
    settings: MatchSettings | None = None,
    *,
    n: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Matched:
    """Visual odometry through the images of ``eyes``, and every place that they show again.

    Parameters
    ----------
    model : PlaceModel
        Proposes images that look alike.
    poses : array
        Where the images were taken: north, east, down and heading, shape (N, 4); NaN where not known. They only tell
        which neighbouring images are of one node of the topological map.
    n : float, optional
        Refractive index before a flat port; that of sea water by default.
    progress : callable, optional
        Called with what is being done and how much of it is done.

    Raises
    ------
    DataError
        When no image can be read, or none was taken within the dive.
    """
    _check_stamps(dive, eyes)
    settings, tell = settings or MatchSettings(), progress or (lambda doing, share: None)
    look = _Look(eyes, settings.odometry, still_mask(eyes), WATER if n is None else n)
    unread: list[str] = []
    known = known_of(dive, eyes.t_ns)
    descriptors: dict[int, Descriptor] = {}

    def views() -> Iterator[View]:
        for k in range(len(eyes)):
            tell("visual odometry", k / len(eyes))
            try:
                view = look.view(k)
                z = look.described(k, model)
            except DataError as error:
                unread.append(str(error))
                continue
            if z is not None:
                descriptors[k] = z
            yield view

    odometry = track(views(), known, settings.odometry)
    if len(unread) == len(eyes):
        raise DataError(f"none of {len(eyes)} images can be read", where=eyes.first.name, remedy=unread[0])
    topology, closures = _closures(eyes, look, known, descriptors, odometry, poses, model.size, settings, tell)
    return Matched(odometry, closures, topology, len(eyes), len(descriptors), unread)


def _check_stamps(dive: Dive, eyes: Eyes) -> None:
    if dive.imu is None:
        return
    at = eyes.t_ns + dive.rig.visual.time_offset_ns
    if not np.any((at >= dive.imu.t_ns[0]) & (at <= dive.imu.t_ns[-1])):
        raise DataError(
            f"none of {len(eyes)} images was taken while the IMU ran",
            where=eyes.first.name,
            remedy="correct the stamps of the images, or give rig.visual.time_offset_s",
        )


class _Look:
    """Images, their features and views by number."""

    def __init__(self, eyes: Eyes, settings: OdometrySettings, mask: Grey | None, n: float) -> None:
        self.eyes, self.settings, self.mask, self.n = eyes, settings, mask, n
        self.features = lru_cache(1)(self._features)
        self.view = lru_cache(_KEPT)(self._view)

    def described(self, k: int, model: PlaceModel) -> Descriptor | None:
        """The descriptor of an image, from the features that odometry uses where the model takes the like."""
        if model.takes(self.settings.enhancement, self.settings.local):
            return model.of_features(self.features(k)[0])
        return model.describe(self.eyes.first.read(k), self.mask)

    def _features(self, k: int) -> list[LocalFeatures]:
        how = self.settings
        return [features_of(image, how.enhancement, how.local, self.mask) for image in self.eyes.read(k)]

    def _view(self, k: int) -> View:
        t_ns, seen = int(self.eyes.t_ns[k]), zip(self.features(k), self.eyes.each, strict=True)
        return of_one_moment(view_of_features(t_ns, features, eye.camera, n=self.n) for features, eye in seen)


def _closures(
    eyes: Eyes,
    look: _Look,
    known: Known,
    descriptors: dict[int, Descriptor],
    odometry: RelativePoses,
    poses: FloatArray,
    size: int,
    settings: MatchSettings,
    tell: Callable[[str, float], None],
) -> tuple[TopologicalMap, RelativePoses]:
    """The topological map of all images, and the candidates of the odometry's keyframes, verified."""
    topology = TopologicalMap(size, TopologySettings(apart_s=settings.apart_s))
    keyframes = set(np.concatenate([odometry.from_ns, odometry.t_ns]).tolist())
    image_of: list[int] = []
    moments: list[tuple[int, int]] = []
    motions: list[Motion] = []
    for done, (k, z) in enumerate(descriptors.items()):
        tell("verifying places", done / len(descriptors))
        t_ns = int(eyes.t_ns[k])
        seen_again = []
        if t_ns in keyframes:
            for sample in topology.search(z, settings.candidates, t_ns).sample.tolist():
                before = image_of[sample]
                moment = (int(eyes.t_ns[before]), t_ns)
                motion = verify(look.view(before), look.view(k), known.aids(*moment), settings.verify)
                moments.append(moment)
                motions.append(motion)
                if motion.accepted:
                    seen_again.append(sample)
        node, count = topology.add(z, t_ns, poses[k]), len(topology)
        image_of += [k] * (count - len(image_of))
        for sample in seen_again:
            node = topology.merge(int(topology.labels[sample]), node)
    return topology, relative_poses(moments, motions)
