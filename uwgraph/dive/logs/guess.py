"""What a log's topics become when nobody says: the best proposal for every stream, and the rest with reasons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from uwgraph.dive.logs.fields import topic_named
from uwgraph.dive.logs.log import Proposal, Topic
from uwgraph.dive.logs.mapping import HeadingMapping, LogMapping


@dataclass(frozen=True)
class Taken:
    """A topic that becomes a stream."""

    topic: str
    type: str
    messages: int | None
    stream: str
    how: str
    """Its fields with units, its axes: what was assumed."""
    note: str = ""


@dataclass(frozen=True)
class Left:
    """A topic that does not, and why."""

    topic: str
    type: str
    messages: int | None
    why: str


@dataclass(frozen=True)
class Guess:
    """A mapping that nobody wrote."""

    mapping: LogMapping
    taken: tuple[Taken, ...]
    left: tuple[Left, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user must know of what was taken."""
        return tuple(f"{taken.stream}: {taken.note}" for taken in self.taken if taken.note)


def guess(topics: Sequence[Topic], proposals: Callable[[Topic], tuple[Proposal, ...]]) -> Guess:
    """The best proposal for every stream: of the highest rank, then of the topic with most messages, then the first."""
    offers = {topic.name: proposals(topic) if topic.count != 0 else () for topic in topics}
    best: dict[str, tuple[Topic, Proposal]] = {}
    for topic in topics:
        for proposal in offers[topic.name]:
            held = best.get(proposal.stream)
            if held is None or _weight(topic, proposal) > _weight(*held):
                best[proposal.stream] = (topic, proposal)
    _drop_unlevelled(best)
    used = {topic.name for topic, _ in best.values()}
    return Guess(
        mapping=_mapping(best),
        taken=tuple(
            Taken(topic.name, topic.type, topic.count, stream, proposal.mapping.in_words(), proposal.note)
            for stream, (topic, proposal) in best.items()
        ),
        left=tuple(
            Left(topic.name, topic.type, topic.count, _why(topic, offers[topic.name], best))
            for topic in topics
            if topic.name not in used
        ),
    )


def of_mapping(mapping: LogMapping, topics: Sequence[Topic]) -> tuple[tuple[Taken, ...], tuple[Left, ...]]:
    """What a mapping that somebody wrote takes and leaves."""
    streams = mapping.by_stream()
    found = {stream: topic_named(m.topic, topics, f"mapping: {stream}.topic") for stream, m in streams.items()}
    taken = tuple(Taken(t.name, t.type, t.count, stream, streams[stream].in_words()) for stream, t in found.items())
    used = {m.topic for m in streams.values()}
    left = tuple(Left(t.name, t.type, t.count, "not in the mapping") for t in topics if t.name not in used)
    return taken, left


def _weight(topic: Topic, proposal: Proposal) -> tuple[int, int]:
    return proposal.rank, topic.count or 0


def _drop_unlevelled(best: dict[str, tuple[Topic, Proposal]]) -> None:
    """A magnetic field without an IMU is no heading."""
    heading = best.get("heading")
    if heading is not None and "imu" not in best:
        mapping = heading[1].mapping
        if isinstance(mapping, HeadingMapping) and mapping.magnetic_field is not None:
            del best["heading"]


def _mapping(best: dict[str, tuple[Topic, Proposal]]) -> LogMapping:
    streams, images = {}, {}
    for name, (_, proposal) in best.items():
        kind, _, camera = name.partition("/")
        if kind == "images":
            images[camera] = proposal.mapping
        else:
            streams[name] = proposal.mapping
    return LogMapping.model_validate({"streams": streams, "images": images})


def _why(topic: Topic, offers: tuple[Proposal, ...], best: dict[str, tuple[Topic, Proposal]]) -> str:
    if topic.count == 0:
        return "no messages"
    if not offers and topic.says:
        return topic.says
    if not offers:
        return "what it means is not known: map its fields" if topic.fields else "of no use here"
    could = ", ".join(offer.stream for offer in offers)
    rivals = [best[offer.stream][0].name for offer in offers if offer.stream in best]
    return f"could be {could}" + (f"; {rivals[0]} was taken" if rivals else "; needs an imu stream")
