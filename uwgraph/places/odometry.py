"""Visual odometry: the motion of the body between visual keyframes, image after image."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, Any

from numpy.typing import NDArray
from pydantic import Field

from uwgraph.camera.model import Camera
from uwgraph.dive.rig import Positive
from uwgraph.errors import DataError
from uwgraph.places.aids import Known
from uwgraph.places.enhance import Enhancement, Grey
from uwgraph.places.local import LocalSettings
from uwgraph.places.motion import Motion, relative_poses
from uwgraph.places.pair import pair_motion
from uwgraph.places.stereo import of_one_moment
from uwgraph.places.twoview import PairSettings
from uwgraph.places.view import WATER, View, view_of
from uwgraph.types import RelativePoses

Frame = tuple[int, NDArray[Any]] | tuple[int, NDArray[Any], NDArray[Any]]
"""Stamp and image (H, W) or (H, W, 3); with the image of the second camera where there is one."""


class OdometrySettings(PairSettings):
    """How images become motions."""

    flow: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.2
    """A new visual keyframe where points have moved by this part of the image's longer side."""
    kept: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.5
    """The image before becomes a visual keyframe where fewer points agree than this part of what its first pair had."""
    patience: Annotated[int, Field(ge=1, le=100)] = 2
    """A keyframe is given up after so many images in a row without a motion."""
    longest_s: Positive = 10.0
    """A new visual keyframe after this time at the latest."""
    local: LocalSettings = LocalSettings()
    """How features are found."""
    enhancement: Enhancement = "clahe"
    """How images are prepared."""


@dataclass(frozen=True, eq=False)
class _Step:
    """Two views and the motion between them."""

    a: View
    b: View
    motion: Motion

    def far(self, settings: OdometrySettings) -> bool:
        """Whether b is to be the next keyframe."""
        late = self.b.t_ns - self.a.t_ns >= settings.longest_s * 1e9
        return late or self.motion.flow > settings.flow * max(self.a.camera.size)

    def faint(self, inliers: int, settings: OdometrySettings) -> bool:
        """Whether there is no motion, or one of few points; ``inliers`` of the keyframe's first pair."""
        return not self.motion.accepted or self.motion.inliers < settings.kept * inliers


def visual_odometry(
    frames: Iterable[Frame],
    cameras: Camera | tuple[Camera, Camera],
    *,
    known: Known | None = None,
    settings: OdometrySettings | None = None,
    mask: Grey | None = None,
    n: float = WATER,
    progress: Callable[[int], None] | None = None,
) -> RelativePoses:
    """Motions between visual keyframes, each accepted or with the reason why not.

    Parameters
    ----------
    frames : iterable of (t_ns, image) or (t_ns, left, right)
        In the order of time; read one after the other, so that they may come from disk.
    cameras : Camera or pair of cameras
        The camera, or the left and the right one.
    known : Known, optional
        Where rotation, soundings, distances and the vertical of any pair come from. Without soundings, distances or a
        second camera a translation has length one and the variance ``NOT_MEASURED`` along itself.
    settings : OdometrySettings, optional
    mask : shape (H, W), optional
        Not 0 where the scene is seen: burned-in clocks and parts of the vehicle stand still.
    n : float
        Refractive index of the water, for flat ports.
    progress : callable, optional
        Called with the count of frames done.

    Raises
    ------
    DataError
        When the frames are not in the order of time, or of another size than the camera's.
    """
    settings = settings or OdometrySettings()
    return track((view_of_frame(frame, cameras, settings, mask, n) for frame in frames), known, settings, progress)


def track(
    views: Iterable[View],
    known: Known | None = None,
    settings: OdometrySettings | None = None,
    progress: Callable[[int], None] | None = None,
) -> RelativePoses:
    """:func:`visual_odometry` of views that are made already, or as they are asked for."""
    tracker = _Tracker(known or Known(), settings or OdometrySettings())
    for count, view in enumerate(views, 1):
        if tracker.last_ns is not None and view.t_ns <= tracker.last_ns:
            raise DataError(
                f"image {count} is not later than the one before", where="frames", remedy="sort the images by time"
            )
        tracker.add(view)
        if progress is not None:
            progress(count)
    steps = tracker.finished()
    return relative_poses([(s.a.t_ns, s.b.t_ns) for s in steps], [s.motion for s in steps])


class _Tracker:
    """The state between two images: the keyframe, and the last image that still has a motion from it."""

    def __init__(self, known: Known, settings: OdometrySettings) -> None:
        self.known, self.settings = known, settings
        self.last_ns: int | None = None
        self._steps: list[_Step] = []
        self._keyframe: View | None = None
        self._near: _Step | None = None
        self._first_inliers = 0
        self._missed = 0

    def add(self, view: View) -> None:
        """Take in the next image."""
        self.last_ns = view.t_ns
        if len(view) < self.settings.min_inliers:
            return
        if self._keyframe is None:
            self._keyframe = view
            return
        step = self._between(self._keyframe, view)
        if self._near is not None and step.faint(self._first_inliers, self.settings):
            self._new_keyframe(self._near)
            step = self._between(self._keyframe, view)
        if not step.motion.accepted:
            self._missed += 1
            if self._missed >= self.settings.patience:
                self._new_keyframe(step)
            return
        self._missed = 0
        self._first_inliers = self._first_inliers or step.motion.inliers
        if step.far(self.settings):
            self._new_keyframe(step)
        else:
            self._near = step

    def finished(self) -> list[_Step]:
        """All steps, with the last one to where the images end."""
        return self._steps if self._near is None else [*self._steps, self._near]

    def _new_keyframe(self, step: _Step) -> None:
        self._steps.append(step)
        self._keyframe, self._near = step.b, None
        self._first_inliers = self._missed = 0

    def _between(self, a: View, b: View) -> _Step:
        return _Step(a, b, pair_motion(a, b, self.known.aids(a.t_ns, b.t_ns), self.settings))


def view_of_frame(
    frame: Frame, cameras: Camera | tuple[Camera, Camera], settings: OdometrySettings, mask: Grey | None, n: float
) -> View:
    """The view of one moment; of the left camera, with places, where there are two. Arguments as above."""
    t_ns, *images = frame
    pair = cameras if isinstance(cameras, tuple) else (cameras,)
    if len(images) != len(pair):
        raise DataError(
            f"{len(images)} images at a time, but {len(pair)} cameras", where="frames", remedy="give one image of each"
        )
    return of_one_moment(
        view_of(int(t_ns), image, camera, local=settings.local, how=settings.enhancement, mask=mask, n=n)
        for image, camera in zip(images, pair, strict=True)
    )
