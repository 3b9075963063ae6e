"""What `trimtab run` says of targets that are set on other signals than the truth."""

import numpy as np
import pytest

from trimtab.commands.flight_summary import summarise_run
from trimtab.core.quantity import Quantity
from trimtab.core.time import ms, to_seconds
from trimtab.logs.log import Log
from trimtab.logs.metrics import Target

T = np.arange(0, ms(1000), ms(10))


def test_a_target_on_a_signal_of_the_law_is_shown_with_its_path():
    error = np.exp(-5 * to_seconds(T))
    log = Log(t=to_seconds(T), ticks=T, signals={"truth.h": 10 + error, "law.h_error": error}, final={"truth.h": 10.0})
    found = summarise_run(log, [Target("law.h_error", 0.0, 0.1)])
    assert list(found["metrics"]) == ["law.h_error", "h"]
    assert found["metrics"]["law.h_error"]["settling_s"] == pytest.approx(np.log(10) / 5, abs=0.011)
    assert found["metrics"]["h"]["settling_s"] is None
    assert found["final"] == {"h": 10.0, "law.h_error": pytest.approx(error[-1])}


def test_a_target_on_the_truth_is_shown_by_its_short_name():
    log = Log(t=to_seconds(T), ticks=T, signals={"truth.heading": np.zeros(len(T))}, final={"truth.heading": 0.0})
    found = summarise_run(log, [Target("heading", 0.0, 0.1)])
    assert list(found["metrics"]) == ["heading"]
    assert found["metrics"]["heading"]["settling_s"] == 0.0


def test_flags_and_a_lost_state_are_told():
    up, h = (to_seconds(T) >= 0.25) & (to_seconds(T) < 0.5), np.where(to_seconds(T) < 0.805, 1.0, np.nan)
    flag = Quantity("1", "Whether a limit holds the input.", kind="flag")
    signals = {"truth.h": h, "law.saturated": up}
    log = Log(to_seconds(T), T, signals, declarations={"law.saturated": flag}, final={"truth.h": np.nan})
    found = summarise_run(log, [])
    assert found["flags"]["law.saturated"]["first_s"] == pytest.approx(0.25)
    assert found["flags"]["law.saturated"]["for_s"] == pytest.approx(0.25, abs=0.01)
    assert found["lost_s"] == pytest.approx(0.81)
    assert found["final"]["h"] is None  # JSON has no NaN
    calm = Log(to_seconds(T), T, {"truth.h": np.zeros(len(T))})
    assert (summarise_run(calm, [])["flags"], summarise_run(calm, [])["lost_s"]) == ({}, None)
