"""Functions shared by all readers: missing packages, messages as columns."""

import sys

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.logs.foreign import list_topics
from trimtab.logs.foreign.tables import LOG_TIME, flatten_message, stack_messages


def test_missing_package_error_names_the_install_command(ulog, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(InputError, match=r"needs the package 'pyulog'(.|\n)*-m pip install \"trimtab\[logs\]\""):
        list_topics(ulog)


def test_nested_messages_are_flattened_to_named_columns():
    stamp = {"sec": 3, "nanosec": 5}
    message = {
        "header": {"stamp": stamp, "frame": "imu"},
        "w": [1, 2.5],
        "ok": True,
        "cloud": [0.0] * 1000,
        "none": None,
    }
    flat = dict(flatten_message(message))
    assert flat == {"header.stamp": 3_000_000_005, "w[0]": 1, "w[1]": 2.5, "ok": True}


def test_missing_message_fields_become_nan():
    table = stack_messages("log file 'a'", "/w", [{"x": 1}, {"y": 2}], [7, 2**63])
    np.testing.assert_array_equal(table.columns["x"], [1, np.nan])
    assert table.columns[LOG_TIME].tolist() == [7, 2**62]
    with pytest.raises(InputError, match="has a field 'log_time' of its own"):
        stack_messages("log file 'a'", "/w", [{LOG_TIME: 1}], [7])
