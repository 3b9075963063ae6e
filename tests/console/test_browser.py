"""A person at the page: the real command, the real vehicle, and Chromium; screenshots are kept where CI is told to.

TRIMTAB_SCREENSHOTS=shots pytest tests/console/test_browser.py
"""

import contextlib
import os
import re
import shutil
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from flight.pair import make_key

from trimtab.compiler.native.compiler import find_compiler

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here"),
    pytest.mark.timeout(600),
]
START_S, PATIENCE_S = 280, 60
SIZES = {"desk": (1280, 720), "tablet": (820, 1180)}
THEMES = ("dark", "light")
GAMEPAD = """
window.pad = {connected: true, mapping: 'standard', id: 'a stub', index: 0, timestamp: 0, axes: [0, 0, 0, 0],
              buttons: Array.from({length: 17}, () => ({pressed: false, value: 0}))};
navigator.getGamepads = () => [window.pad];
"""
KEEP_BANNERS = """() => {
    const banner = document.getElementById("banner"), text = document.getElementById("banner-text");
    window.banners = [];
    const keep = () => window.banners.push([banner.dataset.level, text.textContent]);
    new MutationObserver(keep).observe(banner, {attributes: true, childList: true, characterData: true, subtree: true});
}"""
"""All that the banner says from here on: the link comes back before a slow machine has looked twice."""


class Started:
    """`trimtab console …` as a person starts it."""

    def __init__(self, folder, *words):
        if not (folder / "config").exists():
            make_key(folder)
        self._said = folder / "said.txt"
        self.environment = {**os.environ, "TRIMTAB_CONFIG": str(folder / "config"), "PYTHONUNBUFFERED": "1"}
        with self._said.open("w") as said:
            command = [sys.executable, "-m", "trimtab", "console", *words]
            self.process = subprocess.Popen(command, env=self.environment, stdout=said, stderr=subprocess.STDOUT)
        self.url = self.find(r"console: (http\S+)")

    def find(self, pattern):
        end = time.monotonic() + START_S
        while not (found := re.search(pattern, self._said.read_text())):
            assert self.process.poll() is None, self._said.read_text()
            assert time.monotonic() < end, self._said.read_text()
            time.sleep(0.1)
        return found[1]

    def end(self):
        self.process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(30)
        self.process.kill()
        return self._said.read_text()


@pytest.fixture(scope="module")
def browser():
    """Debian's Chromium; without it the test is skipped."""
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("needs Debian's chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        started = play.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture(scope="class")
def flight(tmp_path_factory):
    """A flight that no test steers. It ends with the class, because two flights at once would starve each other."""
    yield from start_flight(tmp_path_factory.mktemp("console"))


@pytest.fixture
def own_flight(tmp_path):
    """A flight of one test alone. A repeated test gets a new flight."""
    yield from start_flight(tmp_path)


def start_flight(folder):
    started = Started(folder, "hovercraft/pilot", "--out", str(folder / "flown"))
    started.folder = folder
    yield started
    started.end()


@pytest.fixture
def page(browser, own_flight):
    """A page with a gamepad that the test moves."""
    context = browser.new_context(viewport={"width": 1280, "height": 720}, color_scheme="dark")
    context.add_init_script(GAMEPAD)
    opened = context.new_page()
    opened.set_default_timeout(PATIENCE_S * 1e3)
    opened.problems = []
    opened.on("pageerror", lambda error: opened.problems.append(str(error)))
    opened.on("console", lambda m: opened.problems.append(m.text) if m.type == "error" else None)
    opened.outside = []
    opened.on("request", lambda request: opened.outside.append(request.url))
    opened.goto(own_flight.url)
    wait(opened, "trimtab.state.status && trimtab.source")
    yield opened
    context.close()


def read(page, path):
    """JavaScript: the newest value of a signal."""
    return f"trimtab.source.rows.value('{path}', trimtab.source.row)"


def wait(page, condition):
    """Until it holds; asked from outside, for the page's own policy lets nobody evaluate texts in it."""
    end = time.monotonic() + PATIENCE_S
    while not page.evaluate(condition):
        state = "JSON.stringify([trimtab.state.status, trimtab.state.stick, trimtab.state.failures])"
        assert time.monotonic() < end, (condition, page.evaluate(state))
        page.wait_for_timeout(50)


def keep_picture(page, name):
    folder = os.environ.get("TRIMTAB_SCREENSHOTS")
    if folder:
        page.screenshot(path=str(Path(folder) / f"{name}.png"))


class TestFlightWithoutAPilot:
    def test_page_is_forbidden_without_the_token(self, flight):
        for address in (flight.url.partition("?")[0], re.sub("token=.*", "token=guess", flight.url)):
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(address, timeout=10)

    @pytest.mark.parametrize("theme", THEMES)
    @pytest.mark.parametrize("size", SIZES)
    def test_layout_fits_the_window_and_does_not_shift(self, browser, flight, size, theme):
        width, height = SIZES[size]
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=theme)
        page = context.new_page()
        page.goto(flight.url)
        wait(page, "trimtab.state.status && trimtab.source && trimtab.source.rows.count > 20")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        stop = page.locator("#stop").bounding_box()
        assert stop["y"] >= 0
        assert stop["y"] + stop["height"] <= height
        assert stop["x"] + stop["width"] <= width
        assert min(stop["width"], stop["height"]) >= 60
        time.sleep(1.0)
        assert page.locator("#stop").bounding_box() == stop
        keep_picture(page, f"{size}-{theme}")
        context.close()


def arm(page):
    wait(page, "trimtab.state.status.requests.arm.allowed")
    wait(page, "trimtab.state.status.checks.every((check) => check.ok)")
    page.click("[data-request=arm]")
    wait(page, "trimtab.state.status.armed")


def take_stick(page):
    """Press T. A page that was late for long lost the stick before."""
    if page.evaluate("trimtab.state.status.pilot") != "you":
        page.keyboard.press("t")
    wait(page, "trimtab.state.status.pilot === 'you'")


def test_pilot_flies_stops_and_flies_again(page, own_flight):
    """Arm, forward by the gamepad, another gain and its effect, a lost link and its alarm, stop, arm again.

    The test ends the flight and reads in its log what was done.
    """
    assert "token" not in page.url
    assert not page.evaluate("trimtab.state.status.armed")
    arm(page)
    take_stick(page)
    page.select_option("#stick-mode", "damped")
    page.evaluate("window.pad.axes[1] = -1")
    wait(page, f"{read(page, 'estimate.state.surge_velocity')} > 0.4")
    keep_picture(page, "forward")

    page.click("#tab-tune")
    page.fill("#parameter-search", "law.surge_range")
    field = page.locator("#parameters input[type=number]").first
    field.fill("0.3")
    field.press("Enter")
    wait(page, f"{read(page, 'law.speed_reference')} < 0.31")
    wait(page, f"{read(page, 'estimate.state.surge_velocity')} < 0.36")
    keep_picture(page, "tuned")

    link = own_flight.find(r"--link (\S+)")
    words = ["inject", "hovercraft/pilot", "downlink off for 1500 ms", "--link", link, "--set", "navigation=ins"]
    command = [sys.executable, "-m", "trimtab", *words]
    page.evaluate(KEEP_BANNERS)
    subprocess.run(command, env=own_flight.environment, check=True, capture_output=True)
    wait(page, "window.banners.some(([level, text]) => level === 'alarm' && text.includes(' old, limit '))")
    keep_picture(page, "link-lost")

    page.keyboard.press("Space")
    wait(page, "!trimtab.state.status.armed")
    wait(page, f"{read(page, 'supervisor.mode')} === 5")
    page.evaluate("window.pad.axes[1] = 0")
    wait(page, "trimtab.state.status.requests.clear.allowed")
    page.click("[data-request=clear]")
    arm(page)
    assert page.problems == []
    host = own_flight.url.partition("/?")[0]
    assert all(url.startswith((host, host.replace("http", "ws"))) for url in page.outside), page.outside

    texts = end_and_read_events(own_flight)
    for text in ("has the stick", "parameter autopilot.law.surge_range[0] = 0.3", "console: alarm", "stopped from the"):
        assert text in texts, text


def test_frozen_page_causes_hold_then_end_of_flight(page, own_flight):
    """The page's thread stands still for five seconds, as in a debugger. The console's own process ends the flight."""
    arm(page)
    take_stick(page)
    page.evaluate("() => { const end = performance.now() + 5000; while (performance.now() < end); }")
    wait(page, "!trimtab.state.status.armed")
    texts = end_and_read_events(own_flight)
    end = texts.index("no data from the stick for 3 s: flight ended")
    assert "supervisor: hold" in texts[:end], texts


def end_and_read_events(flight):
    """End a flight and return the texts of the events in its log."""
    from trimtab.logs.mcap import read_mcap

    flight.end()
    log = read_mcap(flight.folder / "flown" / "flight.mcap")
    return "\n".join(event["text"] for event in log.metadata["events"])


def test_recorded_flight_is_played_back(browser, page, own_flight):
    arm(page)
    wait(page, "trimtab.source.rows.count > 100")
    own_flight.end()
    logs = [own_flight.folder / "flown" / name for name in ("flight.mcap", "vehicle.mcap")]
    recorded = Started(own_flight.folder, *map(str, logs))
    with contextlib.closing(browser.new_page(viewport={"width": 1280, "height": 720})) as player:
        player.goto(recorded.url)
        wait(player, "trimtab.source && trimtab.source.rows.count > 100")
        first = player.evaluate("trimtab.source.time")
        player.keyboard.press("Space")
        wait(player, f"trimtab.source.time > {first} + 1")
        keep_picture(player, "recording")
    recorded.end()


def test_hypersonic_flight_is_drawn_in_side_view(browser, tmp_path):
    from trimtab.core.record import replace
    from trimtab.core.time import ms, seconds
    from trimtab.logs.mcap import write_mcap
    from trimtab.run.simulate import simulate
    from trimtab.scenarios.build import build

    flown = replace(build("hypersonic/impulse"), duration=seconds(3))
    write_mcap(simulate(flown, log_period=ms(5)), tmp_path / "run.mcap")
    started = Started(tmp_path, str(tmp_path / "run.mcap"))
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.goto(started.url)
    wait(page, "trimtab.source && trimtab.source.rows.count > 100")
    wait(page, "document.querySelectorAll('#readouts dd').length === 3")
    texts = page.locator("#readouts dd").all_inner_texts()
    assert all(re.fullmatch(r"[−-]?\d+\.\d+", text) for text in texts), texts
    keep_picture(page, "hypersonic")
    assert page.evaluate("trimtab.state.failures") == []
    page.close()
    started.end()


@pytest.mark.parametrize("theme", THEMES)
def test_spatial_flight_is_drawn_against_the_horizon(browser, tmp_path, theme):
    from loop.lander import hover

    from trimtab.core.time import ms
    from trimtab.logs.mcap import write_mcap
    from trimtab.run.simulate import simulate

    write_mcap(simulate(hover(), log_period=ms(5), backend="jax"), tmp_path / "run.mcap")
    started = Started(tmp_path, str(tmp_path / "run.mcap"))
    page = browser.new_page(viewport={"width": 1280, "height": 720}, color_scheme=theme)
    page.goto(started.url)
    wait(page, "trimtab.source && trimtab.source.rows.count > 100")
    wait(page, "document.querySelectorAll('#readouts dd').length === 3")
    page.evaluate("trimtab.source.goTo(1)")
    wait(page, "document.querySelector('#readouts').innerText.includes('climb')")
    assert page.evaluate("trimtab.state.hello.view.kind") == "spatial"
    assert page.locator("#attitude").bounding_box()["height"] > 100
    rows = "[...document.querySelector('#attitude').getContext('2d').getImageData(100, 20, 1, 200).data]"
    assert len(set(page.evaluate(rows))) > 3  # sky and earth
    keep_picture(page, f"space-{theme}")
    assert page.evaluate("trimtab.state.failures") == []
    page.close()
    started.end()
