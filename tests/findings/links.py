"""Findings about links, consoles and logs, and the export to C."""

import os
import shutil
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from findings.finding import Finding, Outcome, run_tests
from trimtab.compiler.compiled_function import export_callable
from trimtab.export.verify import verify_folder

KEYS = ("a b", "a_b", "a-b", "errno", "1e5", "", "*/", "π", "NAN", "int")


def similar_keys() -> Outcome:
    """Export functions of dicts whose keys become similar names, and compare with JAX."""
    texts = []
    for keys in (("a b", "a_b"), KEYS):
        example = {key: float(k + 1) for k, key in enumerate(keys)}
        with tempfile.TemporaryDirectory() as folder:
            export_callable(lambda x: sum(v * (i + 2) for i, v in enumerate(x.values())), (example,), Path(folder))
            texts.append(verify_folder(Path(folder)).good)
    return Outcome(f"verified: {texts}", all(texts))


def verified_with(compiler: str) -> bool:
    """Verify exports that were condemned, with this compiler."""
    before = os.environ.get("CC")
    os.environ["CC"] = compiler
    cases: list[tuple[Any, tuple[Any, ...]]] = [
        (lambda x: (jnp.sin(x), jnp.exp(x), jnp.power(x, x)), (0.5,)),
        (lambda a: a + 1, (np.int64(2**53 + 1),)),
        (lambda x: jnp.cumsum(jnp.sin(x)), (np.ones(300, np.float32),)),
        (lambda: jnp.arange(3.0), ()),
    ]
    good = []
    try:
        for function, example in cases:
            with tempfile.TemporaryDirectory() as folder:
                export_callable(function, example, Path(folder))
                good.append(verify_folder(Path(folder)).good)
    finally:
        os.environ.pop("CC")
        os.environ.update({} if before is None else {"CC": before})
    return all(good)


def correct_exports() -> Outcome:
    """Verify correct exports with each compiler of this machine."""
    found = {name: verified_with(name) for name in ("gcc", "clang") if shutil.which(name)}
    return Outcome(f"verified: {found}", all(found.values()))


FINDINGS = [
    Finding(
        "L1",
        "terminal paused, pipe full or reader gone while a flight prints",
        "the loop waits or ends",
        partial(run_tests, "core/test_line_writer.py"),
    ),
    Finding(
        "L2",
        "paused terminal of a vehicle that is stopped",
        "lift stays on",
        partial(run_tests, "flight/test_outputs.py::test_blocked_terminal_does_not_delay_the_outputs"),
    ),
    Finding(
        "L3",
        "SIGHUP and SIGTERM",
        "no disarm",
        partial(
            run_tests,
            "commands/test_end_signals.py::test_signal_ends_command_with_exit_code_and_message",
            "commands/test_end_signals.py::test_hangup_is_ignored_under_nohup",
        ),
    ),
    Finding(
        "L4",
        "output in Latin-1 or ASCII, and to /dev/full",
        "traceback",
        partial(run_tests, "commands/test_standard_streams.py"),
    ),
    Finding(
        "L5",
        "RC_CHANNELS_OVERRIDE of eight zeros",
        "failsafe after 0.5 s",
        partial(
            run_tests,
            "flight/test_duties.py::test_released_receiver_is_not_a_lost_radio",
            "flight/station/test_standard_services.py::test_override_of_eight_zeros_releases_the_sticks",
        ),
    ),
    Finding(
        "L6",
        "RC_CHANNELS of 0, 880 or 3000 us",
        "full stick",
        partial(
            run_tests, "flight/station/test_standard_services.py::test_implausible_receiver_pulse_counts_as_missing"
        ),
    ),
    Finding(
        "L7",
        "frame split over two datagrams",
        "lost",
        partial(run_tests, "flight/mavlink/test_endpoint.py::test_a_frame_in_two_datagrams_is_joined"),
    ),
    Finding(
        "L8",
        "TIMESYNC that arrives twice",
        "two vehicles; the flight ends",
        partial(
            run_tests,
            "flight/mavlink/test_time_sync.py::test_duplicated_request_is_not_a_second_clock",
            "flight/mavlink/test_time_sync.py::test_answers_of_two_clocks_are_counted",
        ),
    ),
    Finding(
        "L9",
        "serial device opened twice",
        "both read it",
        partial(run_tests, "flight/transports/test_serial.py::test_a_device_is_opened_by_one_program_at_a_time"),
    ),
    Finding(
        "L10",
        "PARAM_SET of the integer 3 to a mass",
        "4.2e-45 kg",
        partial(
            run_tests, "flight/station/test_standard_services.py::test_rejects_real_parameter_sent_as_another_type"
        ),
    ),
    Finding(
        "L11",
        "LOG_REQUEST_DATA without a list before",
        "the log is empty",
        partial(run_tests, "flight/station/test_log_download.py::test_log_can_be_requested_without_listing_first"),
    ),
    Finding(
        "L12",
        "letter of several bytes across byte 50 of a STATUSTEXT",
        "broken in two",
        partial(
            run_tests,
            "flight/station/test_streams.py::test_multibyte_character_is_not_split_between_messages",
        ),
    ),
    Finding(
        "L13",
        "log that lacks one message of one topic",
        "2 999 rows of two instants",
        partial(run_tests, "logs/test_mcap.py::test_missing_message_drops_its_row_without_mixing_instants"),
    ),
    Finding(
        "L14",
        "one wrong bit, or a page of zeros, in a log",
        "nothing can be read",
        partial(run_tests, "logs/test_mcap.py::test_damage_loses_only_its_chunk_and_is_reported"),
    ),
    Finding(
        "L15",
        'export of x["a b"] + 10 x["a_b"] and of keys such as "errno", "", "*/"',
        "the C gives 22, not 21; other keys do not compile",
        similar_keys,
    ),
    Finding(
        "L16",
        "check of exports with sine, int64 above 2**53, float32, no arguments; by gcc and clang",
        "refused or condemned: -Werror of clang, double's tolerance, rows through double",
        correct_exports,
    ),
    Finding(
        "L17",
        "Ctrl-C while JAX compiles",
        "swallowed by a callback of the garbage collection, or a segmentation fault",
        partial(run_tests, "commands/test_end_signals.py"),
    ),
]
