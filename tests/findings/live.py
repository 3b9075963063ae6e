"""Findings about live flight: the smallest case of each, what happened at first, and what happens."""

import tempfile
from functools import partial
from pathlib import Path

from findings.finding import Finding, Outcome, run_command, run_tests


def removed_folder() -> Outcome:
    """Look at the free space of a folder that is gone, as the loop does ten times a second."""
    from trimtab.flight.flight_log import SystemDisk

    with tempfile.TemporaryDirectory() as folder:
        gone = Path(folder) / "flight"
    free = SystemDisk().free_bytes(gone)
    return Outcome(f"free space of a folder that is gone: {free} bytes", free == 0)


def fly_in_virtual_time(case: str) -> Outcome:
    """Fly a case of live-faults in virtual time."""
    from studies.live_faults.campaign import fly_cases

    (outcome,) = fly_cases([case], jobs=1)
    times = ", ".join(f"{1e3 * seconds:.0f} ms after {what}" for what, seconds in outcome.acted_s.items())
    return Outcome(f"{outcome.verdict}: outputs acted at most {times}; {outcome.problems}", outcome.verdict == "holds")


def run_fault_case(name: str) -> Outcome:
    """Run a case of live-faults with real processes."""
    status, said = run_command("live-faults", "--real-time", "--only", name)
    return Outcome(said, status == 0 and ": 1 holds" in said)


def held_by(*names: str) -> partial[Outcome]:
    """Return a case that runs tests of live flight, by their names below tests/flight."""
    return partial(run_tests, *(f"flight/{name}" for name in names))


FINDINGS = [
    Finding(
        "V1",
        "outputs' process stopped by SIGSTOP in flight",
        "nobody notices, thrust and lift stay on",
        held_by("test_autopilot.py::test_vehicle_ends_within_100_ms_of_frozen_outputs"),
    ),
    Finding(
        "V2",
        "disk of --out hangs, then autopilot and vehicle killed",
        "outputs stay until the disk goes on",
        partial(fly_in_virtual_time, "disk-hangs-both-killed"),
    ),
    Finding(
        "V3",
        "Ctrl-S in the vehicle's terminal, and one line to print",
        "lift stays on",
        held_by("test_outputs.py::test_blocked_terminal_does_not_delay_the_outputs"),
    ),
    Finding(
        "V4",
        "outputs' process killed by SIGKILL",
        "the row stays driven for ever",
        held_by("test_output_port.py::test_dead_writer_gives_safe_outputs_then_stops_lift"),
    ),
    Finding(
        "V5",
        "request to arm every 2 ms from the start",
        "armed after 4 ms without a check",
        held_by("test_prearm.py::test_arming_is_refused_before_checks_have_run"),
    ),
    Finding("V6", "folder of the log removed in flight", "traceback of shutil.disk_usage", removed_folder),
    Finding(
        "V7",
        "reader of standard output that reads nothing, or is gone",
        "the loop stands, the vehicle ends",
        partial(run_tests, "core/test_line_writer.py"),
    ),
    Finding(
        "V8",
        "twelve mute TCP clients",
        "the autopilot never gets the line",
        held_by("transports/test_accepting_dialer.py::test_mute_callers_do_not_block_a_sending_caller"),
    ),
    Finding(
        "V9",
        "second program as 1/191 with the session that it read on the line",
        "69 of 74 commands obeyed",
        held_by("mavlink/test_authority.py::test_copied_session_is_rejected_on_another_stream"),
    ),
    Finding(
        "V10",
        "list of a folder on a disk that hangs, armed and disarmed",
        "no row for 1.66 s",
        held_by(
            "station/test_file_transfer.py::test_a_listing_on_a_disk_that_hangs_is_answered_at_once",
            "station/test_file_transfer.py::test_in_flight_documents_are_read_but_not_logs",
        ),
    ),
    Finding(
        "V11",
        "PARAM_SET of 1e6 and 1e30",
        "accepted while armed",
        held_by(
            "station/test_parameters.py::test_values_beyond_declared_bounds_are_rejected",
            "station/test_parameters.py::test_unbounded_parameters_stay_near_their_start_value",
        ),
    ),
    Finding(
        "V12",
        "log with a path, a list or null where a choice belongs",
        "replay opens the path; tracebacks",
        partial(run_tests, "scenarios/test_recorded.py::test_invalid_log_metadata_is_rejected_by_field"),
    ),
    Finding(
        "V13",
        "--watchdog '86400 s', rest_speed 1e9, lift_delay 1e6",
        "accepted without a word",
        held_by("test_safety_settings.py"),
    ),
    Finding(
        "V14",
        "board asked to arm in failsafe at 0.75 m/s",
        "flies",
        partial(
            run_tests,
            "firmware/test_authority.py::test_arming_after_failsafe_requires_rest_and_confirmation",
        ),
    ),
    Finding(
        "V15",
        "first frame of a board stamped a day ahead, or 2**48 - 1",
        "stored; all are stale for ever",
        partial(run_tests, "firmware/test_authority.py::test_first_stamp_decades_ahead_does_not_set_the_clock"),
    ),
    Finding(
        "V16",
        "streams of very many senders with the key",
        "368 MB, never freed",
        held_by("mavlink/test_stamps.py::test_many_streams_are_bounded_without_allowing_replays"),
    ),
    Finding(
        "V17",
        "a ground station arms, system 7 sends the first command",
        "system 7 owns the vehicle",
        held_by("mavlink/test_authority.py::test_other_system_cannot_command_vehicle_armed_by_station"),
    ),
    Finding(
        "V18",
        "station sets the mass to 4.5 kg while the checks run",
        "armed and flown",
        held_by("test_preflight.py::test_setting_changed_during_checks_prevents_arming"),
    ),
    Finding(
        "V19",
        "datagrams full of 0xFD",
        "each byte starts a frame, the loop is 1.8 s late",
        held_by("mavlink/test_endpoint.py::test_number_of_tried_false_frame_starts_is_bounded"),
    ),
    Finding(
        "V20",
        "live-faults, case ground-station",
        "fails: the vehicle is started without --origin",
        partial(run_fault_case, "ground-station"),
    ),
    Finding(
        "V21",
        "log writer stopped by SIGSTOP; log deleted; stamps that cannot be stored; restarts with a peer that leads",
        "31 s late; exit 0; no word; 39 s more lead a restart",
        partial(
            run_tests,
            "logs/test_stream.py::test_stopped_writer_delays_closing_by_at_most_its_limit",
            "logs/test_stream.py::test_deleted_log_is_reported_at_close",
            "flight/mavlink/test_endpoint.py::test_unstorable_stamps_are_reported_as_a_problem",
            "flight/mavlink/test_stamps.py::test_restarts_do_not_add_up_to_a_large_lead",
        ),
    ),
    Finding(
        "V22",
        "autopilot that restarts",
        "95 % of the frames lost",
        held_by("mavlink/test_losses.py::test_sender_restart_is_not_counted_as_loss"),
    ),
]
