"""Without rerun-sdk, no recording is written. Contents of a recording: tests/commands/test_convert.py."""

import importlib.util

import pytest

from trimtab.core.errors import InputError
from trimtab.logs.log import Log
from trimtab.logs.rerun_file import write_rerun

needs_none = pytest.mark.skipif(importlib.util.find_spec("rerun") is not None, reason="rerun-sdk is here")


@needs_none
def test_missing_rerun_sdk_is_rejected_without_writing(tmp_path):
    file = tmp_path / "flight.rrd"
    with pytest.raises(InputError, match=r"rerun-sdk.*\n.*trimtab\[rerun\].*as=\"ros2\""):
        write_rerun(file, Log.__new__(Log), None)
    assert not file.exists()
