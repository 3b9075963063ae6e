"""The closed loop in a browser: the same bits as the package, as shipped and with its sliders moved."""

import base64
import ctypes
import shutil
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
from export.conftest import require

from trimtab import build, simulate
from trimtab.compiler.block import block_text
from trimtab.compiler.native.compiler import find_compiler
from trimtab.compiler.structs import Member
from trimtab.core.errors import InputError
from trimtab.core.record import replace, with_leaf
from trimtab.core.time import timetable
from trimtab.export.verify import EXACT
from trimtab.export.web_assembly import (
    Slider,
    _check_slider,
    _describe_slider,
    delay_slider,
    export_web,
    flight_text,
    missing_web_tools,
    write_web_page,
)
from trimtab.run.blocks import loop_block

TOOLS = {"clang": "clang", "wasm-ld": "lld", "chromium": "chromium"}
LOST = Slider("lost", "", 0.0, 0.9, ("world.uplink.loss", "world.downlink.loss"))
K1, K2 = (Slider(k, "kg/s", 0.2, 8.0, (f"autopilot.law.{k}",)) for k in ("k1", "k2"))
BYTES = """(() => {
    const rows = new Uint8Array(FLIGHT.rows.buffer, FLIGHT.rows.byteOffset, FLIGHT.rows.byteLength);
    let text = "";
    for (let k = 0; k < rows.length; k += 32768) text += String.fromCharCode(...rows.subarray(k, k + 32768));
    return btoa(text);
})()""".replace("FLIGHT", "document.querySelector('.trimtab-flight').flight")


@pytest.fixture(scope="module")
def page():
    """A page of Debian's chromium, which may ask for nothing but its own file."""
    require(lambda: [package for program, package in TOOLS.items() if not shutil.which(program)])
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        tab = browser.new_page()
        asked, wrong = [], []
        tab.on("request", lambda request: asked.append(request.url))
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        yield tab
        assert not wrong
        assert all(url.startswith("file:") for url in asked), asked
        browser.close()


def show(page, flight, folder):
    page.goto(write_web_page(flight, folder)[0].as_uri())
    page.wait_for_function("document.querySelector('.trimtab-flight').flight !== undefined")


def flown(page):
    return page.evaluate("(({took, values, shipped, others}) => ({took, values, shipped, others}))"
                         "(document.querySelector('.trimtab-flight').flight)")  # fmt: skip


def move(page, number, value):
    """Put a slider there; gives the value as the page has it, after it has flown."""
    page.locator("input[type=range]").nth(number).fill(value)
    page.wait_for_function(f"document.querySelector('.trimtab-flight').flight.values[{number}] === {float(value)!r}")
    return flown(page)["values"][number]


def differing(page, flight, log):
    """Names of the outputs of which some number has other bits; a NaN is a NaN."""
    rows = np.frombuffer(base64.b64decode(page.evaluate(BYTES)), "<f8").reshape(flight.about["instants"], -1)
    assert np.array_equal(rows[:, 0], log.ticks)
    others = []
    for column, name in zip(rows.T[1:], flight.about["names"][1:], strict=True):
        path, _, index = name.partition("[")
        wanted = np.asarray(log[path], float).reshape(len(log), -1)[:, int(index.removesuffix("]")) if index else 0]
        bits = [np.where(np.isnan(x), np.nan, x).view("<i8") for x in (wanted, column)]
        others += [name] if (bits[0] != bits[1]).any() else []
    return others


@pytest.mark.thorough
def test_page_matches_the_package_at_any_slider_position(page, tmp_path):
    shipped = build("hovercraft/zero-velocity", {"links": "measured"})
    scenario, delay = delay_slider(shipped, 0.3)
    flight = export_web(scenario, (delay, LOST, K1, K2))
    show(page, flight, tmp_path)
    assert flown(page)["shipped"]
    assert flown(page)["others"] == 0
    assert "the same bits as trimtab run" in page.inner_text("[role=status]")
    assert differing(page, flight, simulate(shipped, seed=0, log_period=1)) == []
    before = page.screenshot()
    late, lost, k1 = move(page, 0, "0.1234"), move(page, 1, "0.35"), move(page, 2, "1.7")
    page.locator("input[type=number]").fill("7")
    page.wait_for_function("document.querySelector('.trimtab-flight').flight.seed === 7")
    assert not flown(page)["shipped"]
    assert page.screenshot() != before
    moved = scenario
    latency = np.asarray(scenario.world.uplink.latency) + late
    numbers = {"world.uplink.latency": latency, "world.uplink.loss": lost, "world.downlink.loss": lost}
    for path, value in (numbers | {"autopilot.law.k1": k1}).items():
        moved = with_leaf(moved, path, lambda _, __, value=value: value)
    assert differing(page, flight, simulate(moved, seed=7, log_period=1)) == []
    again = simulate(replace(moved, world=scenario.world), seed=7, log_period=1)
    assert "truth.yaw_rate" in differing(page, flight, again), "the links' sliders do something"
    page.click("text=as shipped")
    page.wait_for_function("document.querySelector('.trimtab-flight').flight.shipped")
    took = [(move(page, 3, f"{2 + 0.01 * k:.2f}"), flown(page)["took"])[1] for k in range(12)]
    print("15 s of flight in ms:", np.round(sorted(took), 1))
    assert min(took) < 100


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["cart-pole/swing-up", "quadrotor/track", "torpedo/depth"])
def test_other_loops_fly_identically_in_a_page(page, name, tmp_path):
    scenario = build(name, {"duration": "2 s"})
    flight = export_web(scenario)
    show(page, flight, tmp_path)
    assert flown(page)["others"] == 0
    assert differing(page, flight, simulate(scenario, seed=0, log_period=1)) == []


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_page_function_flies_unevenly_spaced_instants(tmp_path):
    """The page's C source built as a native library: needs no browser and no clang."""
    uneven = {
        "autopilot.period": "7 ms",
        "world.max_step": "4 ms",
        "world.actuators.period": "4 ms",
        "duration": "0.4 s",
    }
    scenario = build("hovercraft/zero-velocity", uneven)
    table = timetable(
        [*scenario.world.periods(), scenario.autopilot.period], scenario.duration, scenario.world.max_step
    )
    assert len(set(table.h)) > 1
    block = block_text(loop_block(scenario, table.always))
    texts = {"loop.h": block.header, "loop.c": block.source, "wasm.c": flight_text(block, table)}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    command = [find_compiler("c").path, *EXACT, "-std=c99", "-shared", "-fPIC", "loop.c", "wasm.c", "-o", "loop.so"]
    subprocess.run([*command, "-lm"], cwd=tmp_path, check=True)
    program = ctypes.CDLL(str(tmp_path / "loop.so"))
    program.fly.restype = ctypes.POINTER(ctypes.c_double)
    program.get.restype = ctypes.c_double
    program.set.argtypes = (ctypes.c_int32, ctypes.c_int32, ctypes.c_double)
    which = [m.name for m in block.parameters].index("autopilot.law.k1")
    program.defaults()
    assert program.get(which, 0) == float(scenario.autopilot.law.k1)
    program.set(which, 0, 1.7)
    columns = 1 + sum(m.size for m in block.outputs)
    rows = np.ctypeslib.as_array(program.fly(), (len(table.t), columns))
    log = simulate(build("hovercraft/zero-velocity", uneven | {"autopilot.law.k1": "1.7"}), log_period=1, backend="c")
    assert np.array_equal(rows[:, 0], log.ticks)
    for column, member in zip(rows.T[1:], block.outputs, strict=True):
        assert np.array_equal(column, np.asarray(log[member.name], float), equal_nan=True), member.name


def test_rejects_slider_for_a_compiled_delay():
    with pytest.raises(InputError, match="DelayChain") as refused:
        delay_slider(build("hovercraft/zero-velocity"), 0.3)
    assert 'settings={"links": "measured"}' in str(refused.value)


def test_slider_changes_one_element_of_a_vector_and_never_the_whole_vector():
    pulses = "world.actuators.rudder.pulses"
    block = SimpleNamespace(parameters=[Member(pulses, (3,), "f64", None, pulses), Member("k", (), "f64", None, "k")])
    values = {pulses: np.array([1.0, 2.0, 3.0]), "k": 1.0}.__getitem__
    element = Slider("pulse", "", 1.5, 2.5, (f"{pulses}[1]",))
    _check_slider(element, block, values)
    assert _describe_slider(element, block)["which"] == [[0, 1, 2]]
    assert _describe_slider(Slider("k", "", 0.0, 2.0, ("k",)), block)["which"] == [[1, 0, 1]]
    with pytest.raises(InputError) as refused:
        _check_slider(Slider("pulse", "", 0.0, 9.0, (pulses,)), block, values)
    assert f"{pulses}[0]" in refused.value.choices


def test_missing_web_tools_are_named(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert missing_web_tools() == ["clang", "wasm-ld"]
    with pytest.raises(InputError, match="apt-get install clang lld"):
        export_web(build("hovercraft/zero-velocity"))


@pytest.mark.parametrize(
    ("slider", "signals", "said"),
    [
        (Slider("k9", "", 0.0, 1.0, ("autopilot.law.k9",)), (), "autopilot.law.k1"),
        (Slider("k1", "", 0.0, 0.5, ("autopilot.law.k1",)), (), "include the start value 1"),
        (K1, ("truth.yaw",), "truth.yaw_rate"),
    ],
)
def test_rejects_unknown_sliders_and_signals_with_choices(slider, signals, said):
    require(lambda: missing_web_tools())
    with pytest.raises(InputError) as refused:
        export_web(build("hovercraft/zero-velocity", {"duration": "1 s"}), (slider,), signals)
    assert said in str(refused.value)
