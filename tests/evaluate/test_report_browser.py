"""The report in a real headless Chromium, from a file."""

from __future__ import annotations

import base64
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from contests import MANY, contest
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

from uwgraph.evaluate.report import write_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs chromium and chromedriver (Debian: apt install chromium chromium-driver)"
)
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--window-size=1280,900",
)
HOSTILE = "</script><img src=x onerror=alert(1)>"


class Browser:
    """A page in Chromium, asked as a reader would."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver

    def open(self, page: Path) -> None:
        self.driver.get(page.as_uri())
        assert self.run("return document.body.dataset.ready") == "yes"

    def run(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(script, *arguments)

    def find(self, css: str) -> WebElement:
        return self.driver.find_element(By.CSS_SELECTOR, css)

    def all(self, css: str) -> list[WebElement]:
        return self.driver.find_elements(By.CSS_SELECTOR, css)

    def tell(self, command: str, **parameters: Any) -> Any:
        return self.driver.execute_cdp_cmd(command, parameters)

    def point(self, element: WebElement, right: int = 0, down: int = 0) -> None:
        """Put the mouse so far from the middle of an element."""
        self.run("arguments[0].scrollIntoView({block: 'center'})", element)
        ActionChains(self.driver, duration=20).move_to_element_with_offset(element, right, down).perform()

    def complaints(self) -> list[str]:
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] != "INFO"]

    def requests(self, page: Path) -> list[str]:
        """Addresses that a page has asked for since the last time; the browser has pages of its own."""
        messages = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        sent = [m["params"] for m in messages if m["method"] == "Network.requestWillBeSent"]
        return [each["request"]["url"] for each in sent if each["documentURL"] == page.as_uri()]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    options = Options()
    options.binary_location = CHROMIUM or ""
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield Browser(driver)
    driver.quit()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(contest(title=f"made-up {HOSTILE}", failed={HOSTILE: "diverged"}), path)
    return path


@pytest.fixture
def page(browser: Browser, report: Path) -> Browser:
    browser.tell("Emulation.clearDeviceMetricsOverride")
    browser.open(report)
    return browser


def lines(page: Browser, name: str) -> int:
    return len(page.all(f"#errors [data-series='{name}'], #map [data-series='{name}']"))


def test_it_loads_without_complaint_or_network(browser: Browser, report: Path) -> None:
    browser.requests(report)
    browser.complaints()
    browser.open(report)
    assert browser.complaints() == []
    asked = browser.requests(report)
    assert report.as_uri() in asked
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert browser.find("h1").text == f"made-up {HOSTILE}"
    assert not browser.all("img")
    assert len(browser.all("#errors figure")) == 6
    assert len(browser.all("#innovations figure")) == 2 * 3 + 1
    for name in MANY:
        assert lines(browser, name) >= 7


def test_the_policy_stops_what_does_not_belong(page: Browser) -> None:
    page.run("const s = document.createElement('script'); s.textContent = 'window.hacked = 1'; document.body.append(s);"
             "const i = new Image(); i.src = 'https://example.org/x.png'; document.body.append(i);")  # fmt: skip
    assert page.run("return window.hacked") is None
    assert any("Content Security Policy" in text for text in page.complaints())


def test_pointing_reads_out_the_same_instant_everywhere(page: Browser) -> None:
    north = page.find("#errors figure:nth-child(1) .host")
    page.point(north.find_element(By.CSS_SELECTOR, "svg"), right=100)
    readout = north.find_element(By.CSS_SELECTOR, ".readout")
    assert readout.is_displayed()
    assert re.match(r"\d+:\d\d\.\d min", readout.text)
    for name in MANY:
        assert re.search(rf"{name} \S*\d m ± \d", readout.text), readout.text
    cursors = page.all("#errors .cursor, #innovations .cursor")
    visible = [cursor.get_attribute("visibility") for cursor in cursors]
    assert set(visible) == {"visible"}
    assert len(visible) == 6 + 7
    assert len(page.all("#map circle.here")) == len(MANY) + 1
    page.point(page.find("h1"))
    assert not readout.is_displayed()


def test_pointing_at_the_map_moves_the_cursor_over_time(page: Browser) -> None:
    track = page.find("#map path.reference")
    page.run("arguments[0].scrollIntoView({block: 'center'})", track)
    x, y = page.run(
        "const p = arguments[0], m = p.getScreenCTM(), at = p.getPointAtLength(0.4 * p.getTotalLength());"
        "const q = new DOMPoint(at.x, at.y).matrixTransform(m); return [q.x, q.y]", track
    )  # fmt: skip
    page.tell("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    transform = page.find("#errors .cursor").get_attribute("transform")
    assert transform is not None
    frame = page.find("#errors .frame")
    share = (float(re.findall(r"[\d.]+", transform)[0]) - float(frame.get_attribute("x") or 0)) / float(
        frame.get_attribute("width") or 1
    )
    assert 0.25 < share < 0.55


def test_toggles_hide_and_show(page: Browser) -> None:
    box = page.find("#toggles input[aria-label='show aukf']")
    before, others = lines(page, "aukf"), lines(page, "ukf")
    box.click()
    assert (lines(page, "aukf"), lines(page, "ukf")) == (0, others)
    box.click()
    assert lines(page, "aukf") == before


def test_with_nobody_shown_nothing_breaks(page: Browser) -> None:
    page.complaints()
    for box in page.all("#toggles input"):
        box.click()
    assert page.all("#errors [data-series]") == []
    page.point(page.find("#errors svg"))
    assert page.complaints() == []


def test_ellipses_and_innovations_follow_the_one_in_detail(page: Browser) -> None:
    note = "#innovations figure .note"
    page.run("const s = document.getElementById('detail'); s.value = 'ukf'; s.onchange()")
    assert page.find(note).get_attribute("textContent").startswith("ukf: 200 measurements")  # type: ignore[union-attr]
    assert len(page.all("#map ellipse")) == 24
    colour = page.find("#map ellipse").get_attribute("class")
    page.run("const s = document.getElementById('detail'); s.value = 'aukf'; s.onchange()")
    assert page.find(note).get_attribute("textContent").startswith("aukf")  # type: ignore[union-attr]
    assert page.find("#map ellipse").get_attribute("class") != colour


def ticks_of(page: Browser, figure: str) -> list[str]:
    return [text.get_attribute("textContent") or "" for text in page.all(f"{figure} svg text[text-anchor=middle]")]


def test_dragging_zooms_all_time_axes_and_a_double_click_undoes_it(page: Browser) -> None:
    first, other = "#errors figure:nth-child(1)", "#innovations figure"
    before = (ticks_of(page, first), ticks_of(page, other))
    svg = page.find(f"{first} svg")
    page.point(svg, right=-100)
    ActionChains(page.driver, duration=20).click_and_hold().move_by_offset(200, 0).release().perform()
    after = (ticks_of(page, first), ticks_of(page, other))
    assert after[0] != before[0]
    assert after[1] != before[1]
    assert page.find("#whole").is_enabled()
    ActionChains(page.driver).double_click(svg).perform()
    assert (ticks_of(page, first), ticks_of(page, other)) == before


def test_keys_move_the_cursor(page: Browser) -> None:
    page.run("document.querySelector('#errors svg').focus()")
    for _ in range(5):
        ActionChains(page.driver).send_keys("\ue014").perform()
    assert "0:09.9 min" in page.find("#errors .readout").text


SCALES = """
const scale = (css, axis) => {
  const marks = [...document.querySelectorAll(css)];
  const [a, b] = [marks[0], marks[marks.length - 1]];
  const metres = (mark) => parseFloat(mark.textContent.replace("−", "-"));
  return Math.abs((+b.getAttribute(axis) - +a.getAttribute(axis)) / (metres(b) - metres(a)));
};
return [scale("#map > svg > text[text-anchor=middle]:not([transform])", "x"),
        scale("#map > svg > text[text-anchor=end]", "y")];
"""


def test_the_map_is_to_scale_and_zooms(page: Browser) -> None:
    def drawn() -> str | None:
        return page.find("#map [data-series=aukf]").get_attribute("d")

    before = drawn()
    whole = page.run(SCALES)
    assert whole[0] == pytest.approx(whole[1])
    page.find("#map button[aria-label='zoom in']").click()
    assert drawn() != before
    zoomed = page.run(SCALES)
    assert zoomed == pytest.approx([1.6 * whole[0]] * 2)
    page.find("#map button[aria-label='whole map']").click()
    assert drawn() == before


def column(page: Browser, number: int) -> list[float]:
    cells = page.all(f"#results tbody td:nth-child({number})")
    return [float(cell.get_attribute("data-value") or "nan") for cell in cells]


def test_the_table_sorts_both_ways(page: Browser) -> None:
    button = page.find("#results thead th:nth-child(2) button")
    unsorted = column(page, 2)
    button.click()
    assert column(page, 2) == sorted(unsorted)
    assert page.find("#results thead th:nth-child(2)").get_attribute("aria-sort") == "ascending"
    button.click()
    assert column(page, 2) == sorted(unsorted, reverse=True)
    page.find("#results thead th button").click()
    names = [head.text.split("\n")[0] for head in page.all("#results tbody th")]
    assert names == sorted(MANY)


SMALL_PRINT = """
const own = (e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
return [...document.querySelectorAll("body *")]
  .filter((e) => own(e) && e.checkVisibility() && !e.closest(".unseen"))
  .filter((e) => parseFloat(getComputedStyle(e).fontSize) < 14)
  .map((e) => e.outerHTML.slice(0, 80));
"""


def test_on_a_phone_nothing_overflows_and_a_finger_reads_out(page: Browser) -> None:
    page.tell("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=2, mobile=True)
    page.tell("Emulation.setTouchEmulationEnabled", enabled=True)
    try:
        page.driver.refresh()
        assert page.run("return document.documentElement.scrollWidth") <= 390
        assert page.run("return document.querySelector('.scroll').scrollWidth") > 390
        assert page.run(SMALL_PRINT) == []
        svg = page.find("#errors svg")
        page.run("arguments[0].scrollIntoView({block: 'center'})", svg)
        box = page.run("return arguments[0].getBoundingClientRect()", svg)
        finger = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        page.tell("Input.dispatchTouchEvent", type="touchStart", touchPoints=[finger])
        page.tell("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        assert "aukf" in page.find("#errors .readout").text
        page.tell("Input.dispatchTouchEvent", type="touchStart", touchPoints=[finger])
        for x in range(0, 100, 10):
            page.tell("Input.dispatchTouchEvent", type="touchMove", touchPoints=[finger | {"x": finger["x"] + x}])
        page.tell("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        assert page.run("return !document.getElementById('whole').disabled")
    finally:
        page.tell("Emulation.setTouchEmulationEnabled", enabled=False)


TICKS = """
return [...document.querySelectorAll("#errors figure, #innovations figure")]
  .map((f) => f.querySelectorAll("svg text[text-anchor=end]").length);
"""


@pytest.mark.parametrize("width", [390, 1400])
def test_every_scale_can_be_read(page: Browser, width: int) -> None:
    """One tick or two do not make a scale."""
    page.tell("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=width < 500)
    page.driver.refresh()
    assert min(page.run(TICKS)) >= 3


def test_a_table_cut_off_says_so_until_its_end_is_seen(page: Browser) -> None:
    page.tell("Emulation.setDeviceMetricsOverride", width=700, height=900, deviceScaleFactor=1, mobile=False)
    page.driver.refresh()
    hint = page.find("#figures .hint")
    assert "scroll" in hint.text
    page.driver.execute_async_script(
        "const b = document.querySelector('#figures .scroll');"
        "b.addEventListener('scroll', () => setTimeout(arguments[0]));"
        "b.scrollLeft = b.scrollWidth;"
    )
    assert not hint.is_displayed()


def test_fading_is_counted_beside_its_drawing(page: Browser) -> None:
    figure = page.all("#innovations figure")[-1]
    assert figure.find_elements(By.CSS_SELECTOR, ".stems")
    assert re.search(r"aukf: at \d+ of \d+ measurements, up to 4", figure.text)


def test_it_is_dark_where_the_reader_is_and_light_on_paper(page: Browser) -> None:
    ink = (
        "const css = (q) => getComputedStyle(document.querySelector(q)); return [css('body').color, css('.c0').stroke]"
    )
    dark = {"name": "prefers-color-scheme", "value": "dark"}
    light = page.run(ink)
    try:
        page.tell("Emulation.setEmulatedMedia", features=[dark])
        assert page.run(ink) != light
        page.tell("Emulation.setEmulatedMedia", media="print", features=[dark])
        assert page.run(ink) == light
        assert not page.find("#bar").is_displayed()
        assert all(section.is_displayed() for section in page.all("section"))
    finally:
        page.tell("Emulation.setEmulatedMedia", media="", features=[])


def test_it_prints_every_section(page: Browser) -> None:
    printed = page.tell("Page.printToPDF", printBackground=True, preferCSSPageSize=True, generateDocumentOutline=True)
    pdf = base64.b64decode(printed["data"])
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", pdf)) >= 6
    for heading in (b"Figures", b"Track", b"Errors over time", b"Innovations and noise", b"Sun and heading residuals"):
        assert heading in pdf
