"""``uwgraph places``: train, match, show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from uwgraph.cli.console import Progress, note, print_json, print_table, progress_bar, refuse_existing
from uwgraph.errors import ConfigError

if TYPE_CHECKING:
    from uwgraph.camera.eyes import Eyes
    from uwgraph.dive import Dive
    from uwgraph.export import Track
    from uwgraph.places.model_file import PlaceModel
    from uwgraph.places.process import Matched
    from uwgraph.places.train import TrainSettings
    from uwgraph.types import FloatArray, Origin, RelativePoses, TimeArray

app = typer.Typer(
    help="Places seen again and visual odometry, from a dive's images.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

DiveArgument = Annotated[Path, typer.Argument(metavar="DIVE", help="A dive folder with images/CAMERA/camera.yaml.")]
CameraOption = Annotated[
    str | None, typer.Option("--camera", metavar="NAME", help="Which camera, if several look down.")
]
RightOption = Annotated[
    str | None, typer.Option("--right", metavar="NAME", help="The other camera of a stereo pair; found if not named.")
]
AlongOption = Annotated[
    Literal["solution", "reference"],
    typer.Option("--along", help="Positions of the images: of a solution, or of the dive's reference."),
]
SolutionOption = Annotated[
    Path | None,
    typer.Option("--solution", metavar="OUT", help="What 'uwgraph smooth' wrote; without it the dive is smoothed now."),
]
SettingsOption = Annotated[
    Path | None, typer.Option("--settings", metavar="FILE", help="YAML file of settings; options above win over it.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="JSON on standard output, for programs.")]

MANY = 0.2
"""Part of the steps that is not chance."""
RADIUS_OF_ALTITUDE = 0.25
"""Images whose places differ by this part of the altitude show mostly the same floor."""

TRAIN_EXAMPLES = """Examples:

[bold]uwgraph places train dives/reef -o reef.npz[/bold]

[bold]uwgraph places train dives/reef1 dives/reef2 --along reference --radius 1 -o reefs.npz[/bold]

[bold]uwgraph places train dives/reef --network mixvpr.onnx -o reef-mixvpr.npz[/bold]"""


@app.command("train", epilog=TRAIN_EXAMPLES)
def train(
    dives: Annotated[list[Path], typer.Argument(metavar="DIVE...", help="Dive folders with images.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MODEL.npz", help="The model to write.")],
    camera: CameraOption = None,
    along: AlongOption = "solution",
    solution: Annotated[
        list[Path] | None,
        typer.Option("--solution", metavar="OUT", help="What 'uwgraph smooth' wrote, one for each dive, in order."),
    ] = None,
    radius_m: Annotated[
        float | None,
        typer.Option("--radius", metavar="M", help="Size of a place; default: a quarter of the altitude, or 0.5 m."),
    ] = None,
    words: Annotated[int | None, typer.Option(metavar="N", help="Words of the vocabulary (32).")] = None,
    network: Annotated[
        Path | None, typer.Option(metavar="ONNX", help="A network whose output describes an image, in place of VLAD.")
    ] = None,
    settings: SettingsOption = None,
    as_json: JsonOption = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a model that is already there.")] = False,
) -> None:
    """Learn a vocabulary and the LMNN metric in which images of one place are near each other."""
    from uwgraph.camera.eyes import choose_eyes
    from uwgraph.cli.options import settings_from
    from uwgraph.cli.source import load_track
    from uwgraph.dive.folder import read_dive
    from uwgraph.places.deep import OnnxDescriber, OnnxSettings
    from uwgraph.places.describe import DescriberSettings
    from uwgraph.places.learn import Survey, learn_places
    from uwgraph.places.train import TrainSettings

    refuse_existing(out, force)
    if solution and len(solution) != len(dives):
        raise ConfigError(
            f"{len(dives)} dives and {len(solution)} solutions", where="--solution", remedy="give one for each, or none"
        )
    if network is not None and words is not None:
        raise ConfigError("a network has no vocabulary", where="--words", remedy="leave out --words or --network")
    describer: OnnxDescriber | DescriberSettings
    if network is not None:
        describer = OnnxDescriber.open(OnnxSettings(path=str(network)))
    else:
        describer = settings_from(DescriberSettings, None, {"words": words})
    wanted = settings_from(TrainSettings, settings, {"radius_m": radius_m})
    loaded = [read_dive(path) for path in dives]
    with progress_bar() as progress:
        surveys = []
        for number, (path, dive) in enumerate(zip(dives, loaded, strict=True)):
            eyes = choose_eyes(dive, path, camera, downward=False)
            track = load_track(dive, solution[number] if solution else None, along, progress)
            surveys.append(Survey(eyes, _image_poses(dive, track, eyes.t_ns, loaded[0].origin)[:, :3]))
        wanted = _sized(wanted, loaded)
        learnt = learn_places(surveys, wanted, describer, lambda share: progress("learning places", share))
    learnt.model.save(out)
    for line in learnt.unread[:3]:
        note(f"left out: {line}")
    result = {
        "images": learnt.images,
        "unread": len(learnt.unread),
        "radius_m": wanted.radius_m,
        "size": learnt.model.size,
        "output": str(out),
    }
    if as_json:
        print_json(result)
    else:
        note(f"{out}: learnt from {learnt.images} images, places of {wanted.radius_m:.2g} m")


MATCH_EXAMPLES = """Examples:

[bold]uwgraph places match dives/reef[/bold]

[bold]uwgraph places match dives/reef --model reef.npz --camera down --right down_right --force[/bold]

Then [bold]uwgraph smooth dives/reef -o out/reef[/bold] uses what was found."""


@app.command("match", epilog=MATCH_EXAMPLES)
def match(
    dive: DiveArgument,
    model: Annotated[
        Path | None,
        typer.Option(metavar="MODEL.npz", help="What 'places train' wrote; without it one is learnt from this dive."),
    ] = None,
    camera: CameraOption = None,
    right: RightOption = None,
    along: AlongOption = "solution",
    solution: SolutionOption = None,
    medium: Annotated[Literal["water", "air"], typer.Option("--medium", help="What the camera sits in.")] = "water",
    settings: SettingsOption = None,
    as_json: JsonOption = False,
    force: Annotated[bool, typer.Option("--force", help="Replace streams that are already there.")] = False,
) -> None:
    """Find the motion between images and the places seen again: odometry.parquet and closures.parquet of the dive."""
    from uwgraph.camera.eyes import choose_eyes
    from uwgraph.cli.options import settings_from
    from uwgraph.cli.source import load_track
    from uwgraph.dive.folder import add_stream, read_dive
    from uwgraph.places.model_file import PlaceModel
    from uwgraph.places.process import TOPOLOGY, MatchSettings, match_places

    there = read_dive(dive)
    for name in ("odometry", "closures"):
        if getattr(there, name) is not None and not force:
            raise ConfigError(f"the dive has a stream {name!r}", where=str(dive), remedy="replace it with --force")
    there = replace(there, odometry=None, closures=None)
    eyes = choose_eyes(there, dive, camera, right, downward=False)
    wanted = settings_from(MatchSettings, settings, {})
    trained = None if model is None else PlaceModel.load(model)
    with progress_bar() as progress:
        track = load_track(there, solution, along, progress)
        poses = _image_poses(there, track, eyes.t_ns, there.origin)
        trained = trained or _learnt_here(there, eyes, poses, progress)
        found = match_places(there, eyes, trained, poses, wanted, n=1.0 if medium == "air" else None, progress=progress)
    found.topology.save(dive / "images" / eyes.first.name / TOPOLOGY)
    for name, stream in (("odometry", found.odometry), ("closures", found.closures)):
        if len(stream):
            add_stream(dive, name, stream, replace=force)
    _tell(dive, found, eyes.second is not None, as_json)


SHOW_EXAMPLES = "Example: [bold]uwgraph places show dives/reef --solution out/reef -o places.png[/bold]"


@app.command("show", epilog=SHOW_EXAMPLES)
def show(
    dive: DiveArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="PNG", help="The picture to write.")] = Path("places.png"),
    camera: CameraOption = None,
    along: AlongOption = "solution",
    solution: SolutionOption = None,
) -> None:
    """Draw the track with its closures, and the images behind some of them."""
    import numpy as np

    from uwgraph.camera.eyes import choose_eyes
    from uwgraph.cli.source import load_track
    from uwgraph.dive.folder import read_dive
    from uwgraph.evaluate.places_picture import places_picture, shown_pairs
    from uwgraph.places.process import TOPOLOGY
    from uwgraph.places.topology import TopologicalMap

    there = read_dive(dive)
    if there.closures is None:
        raise ConfigError("the dive has no closures", where=str(dive), remedy="find them with 'uwgraph places match'")
    eyes = choose_eyes(there, dive, camera, downward=False)
    with progress_bar() as progress:
        track = load_track(there, solution, along, progress)
    topology = TopologicalMap.load(dive / "images" / eyes.first.name / TOPOLOGY)
    first_seen = np.array([topology.t_ns[topology.samples(node)[0]] for node in topology.nodes], dtype=np.int64)
    offset = there.rig.visual.time_offset_ns
    pairs = shown_pairs(there.closures, eyes.first)
    places_picture(track.t_ns - offset, track.p_n, there.closures, first_seen, pairs, out, dive.resolve().name)
    note(f"{out}: {len(there.closures)} candidates, {int(there.closures.accepted.sum())} of them verified")


def _image_poses(dive: Dive, track: Track, t_ns: TimeArray, origin: Origin) -> FloatArray:
    """North, east, down [m, against ``origin`` ] and heading [rad] at images, shape (N, 4); NaN outside the track."""
    import numpy as np

    from uwgraph.frames import ned_from_geodetic

    known = track.select(track.placed)
    at = t_ns + dive.rig.visual.time_offset_ns
    if not len(known):
        return np.full((len(at), 4), np.nan)
    p_n = ned_from_geodetic(origin, known.lat, known.lon, np.nan_to_num(known.height))
    columns = [*p_n.T, np.unwrap(np.nan_to_num(known.rph[:, 2]))]
    return np.stack([np.interp(at, known.t_ns, column, np.nan, np.nan) for column in columns], axis=1)


def _sized(wanted: TrainSettings, dives: Sequence[Dive]) -> TrainSettings:
    """The settings with places as large as suits the altitude, unless their size was given."""
    import numpy as np

    usual = [float(np.median(dive.altitude.altitude)) for dive in dives if dive.altitude is not None]
    if "radius_m" in wanted.model_fields_set or not usual:
        return wanted
    return wanted.model_copy(update={"radius_m": RADIUS_OF_ALTITUDE * min(usual)})


def _learnt_here(dive: Dive, eyes: Eyes, poses: FloatArray, progress: Progress) -> PlaceModel:
    """A model learnt from the very images in which places are sought."""
    from uwgraph.places.learn import Survey, learn_places
    from uwgraph.places.train import TrainSettings

    def tell(share: float) -> None:
        progress("learning places", share)

    survey = Survey(eyes, poses[:, :3])
    return learn_places([survey], _sized(TrainSettings(), [dive]), None, tell, or_plain=True).model


def _tell(dive: Path, found: Matched, stereo: bool, as_json: bool) -> None:
    from uwgraph.places.motion import TURNS_OTHERWISE

    odometry, closures = found.odometry, found.closures
    not_moved, not_seen_again = _refusals(odometry), _refusals(closures)
    steps, verified, nodes = int(odometry.accepted.sum()), int(closures.accepted.sum()), len(found.topology.nodes)
    for line in found.unread[:3]:
        note(f"left out: {line}")
    for line in _doubts(found, not_moved.get(TURNS_OTHERWISE, 0), stereo):
        note(f"warning: {line}")
    if as_json:
        print_json(
            {
                "images": found.images,
                "described": found.described,
                "unread": len(found.unread),
                "odometry": {"steps": len(odometry), "accepted": steps, "refused": not_moved},
                "closures": {"candidates": len(closures), "accepted": verified, "refused": not_seen_again},
                "nodes": nodes,
            }
        )
        return
    note(
        f"{dive}: visual odometry in {steps} of {len(odometry)} steps; {verified} of {len(closures)} candidates "
        f"verified as places seen again; {nodes} places"
    )
    for title, reasons in (("steps", not_moved), ("candidates", not_seen_again)):
        if reasons:
            rows = [(why, str(count)) for why, count in list(reasons.items())[:8]]
            print_table(f"{title} that were refused", (), rows)


def _refusals(poses: RelativePoses) -> dict[str, int]:
    """How often which reason was given, the most frequent first."""
    reasons = poses.reason[~poses.accepted].tolist()
    return dict(Counter(reason.partition(":")[0] for reason in reasons).most_common())


def _doubts(found: Matched, other_turn: int, stereo: bool) -> Iterator[str]:
    """What a person should look into; ``other_turn`` steps contradict the gyro."""
    steps = found.odometry
    if not len(steps):
        yield f"no motion: {found.described} of {found.images} images show anything to recognise, and two in a row must"
        return
    if other_turn > MANY * len(steps):
        yield (
            f"{other_turn} of {len(steps)} steps turn otherwise than the gyro: is the camera.yaml right (mount, focal "
            "length), and rig.visual.time_offset_s?"
        )
    if stereo and steps.accepted.any() and "stereo" not in steps.reason[steps.accepted].tolist():
        yield "the two cameras gave no ranges: are their camera.yaml files exchanged, or calibrated apart?"
