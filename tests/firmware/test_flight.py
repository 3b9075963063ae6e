"""`trimtab fly` at the other end of the line: a microcontroller's vehicle reaches its target."""

import contextlib

import numpy as np
import pytest
from firmware.board import emulator
from firmware.host import KEY

from trimtab.core.time import seconds
from trimtab.links.open_link import open_link
from trimtab.logs.mcap import read_mcap
from trimtab.run.fast_step import fast_step
from trimtab.run.fly import Flyer
from trimtab.scenarios import catalogue
from trimtab.wire.mavlink import Endpoint

ATTEMPTS = 3
"""A machine so loaded that commands stay away for 250 ms stops the vehicle, as it should; then it is flown again."""


@pytest.mark.slow
def test_the_microcontrollers_vehicle_is_flown_to_its_target(elf, tmp_path):
    """Forward at 1.08 m/s. Band 0.15 m/s on the mean of the last 3 s: slow navigation errors of 0.03 m/s and gusts of
    late commands; the motor and its regulator are in the loop, which the scenario's own vehicle has not."""
    scenario, _ = catalogue.load("hovercraft/forward", {})
    step = fast_step(scenario)
    for attempt in range(ATTEMPTS):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        said = []
        with emulator(elf, folder) as port, contextlib.closing(open_link(f"tcp://127.0.0.1:{port}")) as link:
            step.reset()
            one = Flyer(scenario, link, lambda d: Endpoint(d, 1, 191, KEY), step=step)
            one.connect()
            flight = one.fly(duration=seconds(12), log=folder / "flight.mcap", tell=said.append)
        if not [text for text in said if "no command" in text]:
            break
    print("\n".join(said))
    assert flight.armed is not None
    assert one.endpoint.counts.refused == 0
    log = read_mcap(folder / "flight.mcap")
    late = log.ticks > log.ticks[-1] - seconds(3)
    surge = np.asarray(log["downlink.navigation.value.surge_velocity"])[late]
    print(f"surge {surge.mean():.3f} m/s, in {attempt + 1} attempts")
    assert surge.mean() == pytest.approx(2.8 / 2.6, abs=0.15)
