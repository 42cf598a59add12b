from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contests import MANY, contest, entry, innovations
from hand_made import START, truth
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.figure import Figure

from uwgraph.errors import DataError
from uwgraph.evaluate import judge
from uwgraph.evaluate.contest_plot import contest_plots
from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.evaluate.report import report_page, write_report
from uwgraph.evaluate.report_colours import looks
from uwgraph.evaluate.report_data import rounded
from uwgraph.evaluate.report_directions import directions
from uwgraph.evaluate.report_findings import findings
from uwgraph.evaluate.report_series import courses, evenly, frame, histories, peaks
from uwgraph.evaluate.report_table import columns, figure
from uwgraph.frames import matrix_from_rph
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import SimulationSettings, add_sun_heading, simulate
from uwgraph.types import Innovations


class Page(HTMLParser):
    """Texts of a page by element, and the names of all its elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.path: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.elements: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in ("meta", "link"):
            self.path.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        self.path.pop()

    def handle_data(self, data: str) -> None:
        if self.path:
            self.texts.append((self.path[-1][0], data))

    def of(self, tag: str) -> list[str]:
        return [text for name, text in self.texts if name == tag]

    @property
    def data(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.of("script")[0])
        return found


def test_the_best_is_named_with_by_how_much() -> None:
    position, heading, *_ = findings(contest({"a": 2.0, "b": 1.0, "c": 8.0}))
    assert position.startswith("b has the smallest horizontal RMSE")
    assert "50 % below the next, a" in position
    assert "last is c" in position
    assert heading.startswith("b has the smallest heading RMSE")


def test_equals_share_the_first_place() -> None:
    position = findings(contest({"a": 1.0, "b": 1.001, "c": 3.0}))[0]
    assert position.startswith("a and b have the smallest")
    assert "67 % below the next, c" in position


def test_a_boastful_covariance_is_named() -> None:
    made = contest({"a": 1.0, "b": 2.0})
    bold = replace(made.entries[1].judged.solution, cov_pose=made.entries[1].judged.solution.cov_pose / 100.0)
    made = replace(made, entries=(made.entries[0], entry("b", bold, made.entries[1].judged.reference)))
    text = " ".join(findings(made))
    assert "agree with the stated covariance (NEES within 95 %): a." in text
    assert re.search(r"outside their 95 % interval: b \(position [\d.]+, errors larger than stated", text)
    nees = next(column for column in columns(made) if column.title.startswith("NEES position"))
    assert [cell.mark for cell in nees.cells] == ["", "▲"]


def test_a_timid_covariance_is_named() -> None:
    made = contest({"a": 1.0})
    timid = replace(made.entries[0].judged.solution, cov_pose=made.entries[0].judged.solution.cov_pose * 1e4)
    text = " ".join(findings(replace(made, entries=(entry("a", timid, made.entries[0].judged.reference),))))
    assert "smaller than stated" in text


def test_a_perfect_estimator_is_judged_too() -> None:
    assert findings(contest({"a": 0.0, "b": 1.0}))[0].startswith("a has the smallest")


def test_without_a_reference_nobody_is_best() -> None:
    made = contest(referenced=False)
    assert "no reference" in findings(made)[0]
    shown = {column.title: column for column in columns(made)}
    assert not any(cell.best for name, column in shown.items() if name != "runtime [s]" for cell in column.cells)
    assert shown["1-sigma heading [deg]"].cells[0].value is not None
    assert "Stated uncertainty over time" in Page(report_page(made)).of("h2")


def test_the_smallest_of_a_column_is_marked_once() -> None:
    column = columns(contest({"a": 2.0, "b": 1.0, "c": 8.0}))[0]
    assert [cell.best for cell in column.cells] == [False, True, False]
    assert column.cells[1].value == pytest.approx(np.sqrt(np.mean(np.linspace(0, 1, 200) ** 2)), rel=1e-6)


def test_nis_counts_what_was_used() -> None:
    of = innovations(truth().t_ns)
    dvl, depth = histories(of, START)
    assert (dvl.kind, depth.kind) == ("dvl", "depth")
    assert (dvl.axes, depth.axes) == (3, 1)
    assert dvl.refused + depth.refused == int((~of.accepted).sum())
    assert depth.mean_nis == pytest.approx(1.0, abs=0.3)


def test_late_measurements_are_drawn_in_their_place() -> None:
    of = innovations(truth().t_ns)
    late = of.select(np.random.default_rng(3).permutation(len(of)))
    for history in histories(late, START):
        assert (np.diff(history.t_s) >= 0).all()
    assert sorted(h.kind for h in histories(late, START)) == ["depth", "dvl"]


def test_running_nis_of_white_innovations_stays_in_its_interval() -> None:
    rng = np.random.default_rng(1)
    n, t_ns = 40_000, START + np.arange(40_000) * 10**9
    x = rng.standard_normal((n, 2))
    nis, used = np.sum(x**2, axis=1) / 2, np.full(n, True)
    of = Innovations(t_ns, np.full(n, "sun"), np.full(n, 2), x, nis, used, np.ones_like(x), np.ones(n))
    running = next(histories(of, START)).running
    assert running is not None
    low, high = running.bounds
    assert np.mean((running.nis > low) & (running.nis < high)) == pytest.approx(0.95, abs=0.01)


@settings(max_examples=60, deadline=None)
@given(
    arrays(
        np.float64, st.tuples(st.integers(1, 300), st.integers(1, 3)), elements=st.floats(-1e6, 1e6) | st.just(np.nan)
    ),
    st.integers(2, 60),
)
def test_thinning_keeps_peaks_and_ends(values: np.ndarray[Any, np.dtype[np.float64]], limit: int) -> None:
    rows = peaks(values, limit)
    assert len(rows) <= limit + 2
    assert (np.diff(rows) > 0).all()
    assert {0, len(values) - 1} <= set(rows.tolist())
    size = np.nan_to_num(np.abs(values))
    if values.shape[1] == 1:
        assert size[rows].max() == size.max()


@given(st.integers(0, 5000), st.integers(1, 300))
def test_even_thinning(n: int, limit: int) -> None:
    rows = evenly(n, limit)
    assert len(rows) == min(n, limit)
    assert n == 0 or (rows[0] == 0 and rows.max() < n)


@given(st.lists(st.floats(0.0, 1e9), max_size=8))
def test_one_lost_estimator_does_not_set_the_frame(reaches: list[float]) -> None:
    limit = frame(reaches)
    assert limit > 0.0
    if reaches and max(reaches) > 0.0:
        assert limit <= max(reaches)
    assert frame([1.0, 2.0, 1e6]) == 12.0
    assert frame([5.0]) == 5.0


def test_names_keep_their_looks() -> None:
    both, alone = looks(MANY), looks(["aukf"])
    assert both[MANY.index("aukf")] == alone[0]
    assert len(set(looks([f"filter {i}" for i in range(20)] + list(MANY)))) == 26


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_figures_are_short(value: float) -> None:
    text = figure(value)
    assert "nan" not in text
    assert "inf" not in text
    if np.isfinite(value) and 1e-4 < abs(value) < 1e6:
        assert float(text.replace("−", "-")) == pytest.approx(value, rel=6e-3)


@given(st.lists(st.floats(-1e300, 1e300) | st.sampled_from([np.nan, np.inf, -np.inf]), max_size=20))
@example([1000.0, 0.6667, 0.01])
def test_rounding_keeps_what_can_be_seen(values: list[float]) -> None:
    """Of each: the first sigma of a filter is often a kilometre, and people look closer."""
    out = rounded(np.array(values))
    json.dumps(out, allow_nan=False)
    for before, after in zip(values, out, strict=True):
        assert (after is None) == (not np.isfinite(before))
        assert after is None or abs(after - before) <= 1e-3 * abs(before)


HOSTILE = ("</script><script>alert(1)</script>", "<!--<script>", "<b>x</b>", "\"'><img src=x>", "$title", "&amp;")
NASTY = st.text(max_size=30) | st.sampled_from(HOSTILE)


@settings(max_examples=25, deadline=None)
@given(NASTY, NASTY, NASTY)
def test_names_stay_text(title: str, name: str, why: str) -> None:
    plain = Page(report_page(contest({"a": 1.0, "b": 2.0}, n=5)))
    page = Page(report_page(contest({"a": 1.0, name: 2.0}, n=5, title=title, failed={name: why})))
    extra = sorted(page.elements)
    for tag in (*plain.elements, "h3", "ul", "li", "b"):
        if tag in extra:
            extra.remove(tag)
    assert set(extra) <= {"tr", "td", "th", "span", "svg", "path", "small", "button"}
    assert not any(attribute.startswith("on") for attribute, _ in page.attributes)
    assert page.data["entries"][-1]["name"] == name


def policy_of(text: str) -> str:
    found = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert found is not None
    return found.group(1)


def test_the_policy_allows_the_page_and_nothing_else() -> None:
    text = report_page(contest())
    policy = policy_of(text)
    assert policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    assert "http" not in policy
    for tag in ("style", "script"):
        found = re.search(rf"<{tag}>(.*?)</{tag}>", text, re.DOTALL)
        assert found is not None
        digest = base64.b64encode(hashlib.sha256(found.group(1).encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert not re.search(r'(src|href)="(?!data:,)', text)


def strange(case: str) -> Contest:
    """Contests at the edge."""
    made = contest({"ukf": 1.0, "dr": 4.0}, n=50)
    ukf, dr = made.entries
    solution, reference = ukf.judged.solution, ukf.judged.reference
    told = ukf.innovations
    assert told is not None

    def telling(of: Innovations) -> Contest:
        return replace(made, entries=(replace(ukf, innovations=of), dr))

    match case:
        case "nobody":
            return replace(made, entries=(), failed={"ukf": "diverged"})
        case "alone":
            return replace(made, entries=(dr,))
        case "no covariance":
            bare = replace(solution, cov_pose=np.full((50, 6, 6), np.nan))
            return replace(made, entries=(entry("ukf", bare, reference), entry("dr", bare, None)))
        case "one keyframe":
            return replace(made, entries=(entry("dr", truth(1), None),))
        case "reference elsewhere":
            assert reference is not None
            return replace(made, entries=(entry("ukf", solution, replace(reference, t_ns=reference.t_ns + 10**15)),))
        case "silent":
            return telling(told.select(slice(0, 0)))
        case "all refused":
            return telling(replace(told, accepted=np.zeros(len(told), dtype=bool)))
        case "not numbers":
            nothing, nowhere = np.full(len(told), np.nan), told.whitened * np.nan
            return telling(replace(told, nis=nothing, fading=nothing, whitened=nowhere, noise=nowhere))
        case "infinite":
            return telling(replace(told, nis=np.full(len(told), np.inf), whitened=told.whitened * np.inf))
        case "other stamps":
            return replace(made, entries=(ukf, entry("dr", truth(30, offset_s=3.5), reference)))
        case "no metrics":
            return replace(made, entries=(replace(ukf, judged=replace(ukf.judged, metrics={})),))
        case "aligned":
            return contest({"ukf": 1.0, "dr": 4.0}, n=50, alignment="yaw")
    raise AssertionError(case)


NUMB = ("nobody", "no covariance", "not numbers")
STRANGE = (
    *NUMB,
    "infinite",
    "one keyframe",
    "alone",
    "reference elsewhere",
    "silent",
    "all refused",
    "other stamps",
    "no metrics",
    "aligned",
)


@pytest.mark.parametrize("case", STRANGE)
def test_strange_contests_have_a_page(case: str) -> None:
    made = strange(case)
    page = Page(report_page(made))
    assert len(page.data["entries"]) == len(made.entries)


@pytest.mark.parametrize("case", NUMB)
def test_strange_contests_have_pictures(case: str, tmp_path: Path) -> None:
    made = strange(case)
    written = contest_plots(made, tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert bool(written) == bool(made.entries)


def test_drawings_are_aligned_as_the_figures_are() -> None:
    for made in courses(contest({"a": 3.0}, alignment="origin")):
        assert np.hypot(*made.error[0, :2]) < 1e-6
        rmse = np.sqrt(np.mean(made.horizontal**2))
        assert rmse == pytest.approx(made.entry.judged.metrics["horizontal_rmse_m"])


def test_two_hours_stay_small() -> None:
    made = contest(n=7200)
    text = report_page(made)
    assert len(text) < 4_000_000
    drawn = Page(text).data["entries"][0]
    assert len(drawn["t"]) <= 1802
    assert "Figures and sentences are of all" in text


def test_what_is_simulated_is_called_so() -> None:
    text = report_page(contest())
    assert "Simulated: the whole dive" in text
    made = contest()
    added = replace(made.dive, provenance={"format": "snapir", "simulated": {"sun": "simulated: from the reference"}})
    text = report_page(replace(made, dive=added))
    assert "Simulated streams: sun (from the reference)." in text
    assert "whole dive, reference" not in text


def test_pictures(tmp_path: Path) -> None:
    made = contest(title="costs $5_a and $6")
    written = contest_plots(made, tmp_path)
    assert [path.name for path in written] == ["track.png", "errors.png", "innovations.png", "noise.png"]
    for path in written:
        assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert path.stat().st_size > 15_000
    silent = replace(made, entries=tuple(replace(each, innovations=None) for each in made.entries))
    assert [path.name for path in contest_plots(silent, tmp_path)] == ["track.png", "errors.png"]


def test_pictures_name_all_that_they_draw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A filter without innovations of the first sensor is in the keys too, and its panel says why it is empty."""
    made = contest({"eskf": 2.0, "ukf": 1.0})
    told = made.entries[1].innovations
    assert told is not None
    depth_only = replace(made.entries[1], innovations=told.select(told.kind == "depth"))
    drawn: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: (drawn.append(self), save(self, *a, **k)))
    contest_plots(replace(made, entries=(made.entries[0], depth_only)), tmp_path)
    for picture in drawn[1:]:
        assert [text.get_text() for text in picture.legends[0].get_texts()] == ["eskf", "ukf"]
    empty = next(axes for axes in drawn[2].axes if axes.get_title(loc="left") == "ukf: dvl")
    assert [text.get_text() for text in empty.texts] == ["no innovations"]


def test_the_page_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_report(contest(), tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8").endswith("</html>\n")
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="file"):
        write_report(contest(), tmp_path / "file" / "report.html")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "report.html"]


@pytest.fixture(scope="module")
def sunny() -> Contest:
    """A simulated dive with sun and headings, smoothed; and the same turned by 2 degrees."""
    settings = SimulationSettings(duration_s=120.0, grade="fog", leg_length_m=20.0)
    dive = add_sun_heading(simulate(settings, seed=4), sigma_deg=0.3)
    assert dive.sun is not None
    dive = replace(dive, sun=replace(dive.sun, flags=np.where(np.arange(len(dive.sun)) % 10 == 3, 4, 0)))
    solution = smooth(dive, SmoothSettings(initial="reference"))
    R = matrix_from_rph(np.radians([0.0, 0.0, 2.0]))
    turned = replace(solution, R_nb=R @ solution.R_nb)
    entries = [Entry(name, name, judge(dive, each)) for name, each in (("right", solution), ("turned", turned))]
    return Contest(dive, "sunny", tuple(entries))


def test_residuals_of_the_sun_show_a_turned_estimate(sunny: Contest) -> None:
    azimuth, elevation, heading = directions(sunny)
    assert sunny.dive.sun is not None
    assert len(azimuth.t_ns) == int((sunny.dive.sun.flags == 0).sum())
    for found in (azimuth, heading):
        right, turned = found.residual_deg
        assert found.sigma_deg is not None
        assert np.nanstd(right) == pytest.approx(found.sigma_deg, rel=0.25)
        assert abs(np.nanmean(right)) < 0.15
        assert np.nanmean(turned - right) == pytest.approx(2.0, abs=0.01)
    assert elevation.sigma_deg is not None
    assert np.nanstd(elevation.residual_deg[1]) == pytest.approx(elevation.sigma_deg, rel=0.25)


def test_sun_residuals_are_on_the_page(sunny: Contest) -> None:
    page = Page(report_page(sunny))
    assert [each["name"] for each in page.data["directions"]] == ["sun azimuth", "sun elevation", "heading"]
    assert page.data["sun"]
    assert "neither usable sun" not in " ".join(page.of("p"))
    assert "neither usable sun" in " ".join(Page(report_page(contest())).of("p"))
