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
        held_by("test_autopilot.py::test_a_vehicle_whose_outputs_are_frozen_ends_within_100_ms_and_says_so"),
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
        held_by("test_outputs.py::test_a_paused_terminal_does_not_hold_up_the_outputs"),
    ),
    Finding(
        "V4",
        "outputs' process killed by SIGKILL",
        "the row stays driven for ever",
        held_by("test_output_port.py::test_a_dead_writer_is_safe_after_100_ms_and_the_lift_stops_after_its_delay"),
    ),
    Finding(
        "V5",
        "request to arm every 2 ms from the start",
        "armed after 4 ms without a check",
        held_by("test_prearm.py::test_before_the_checks_have_run_nothing_may_be_armed"),
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
        held_by(
            "transports/test_accepting_dialer.py::test_twelve_mute_callers_do_not_keep_the_line_from_one_who_speaks"
        ),
    ),
    Finding(
        "V9",
        "second program as 1/191 with the session that it read on the line",
        "69 of 74 commands obeyed",
        held_by("mavlink/test_authority.py::test_a_session_that_was_read_on_the_line_is_of_no_use_on_another_stream"),
    ),
    Finding(
        "V10",
        "list of a folder on a disk that hangs, armed and disarmed",
        "no row for 1.66 s",
        held_by(
            "station/test_file_transfer.py::test_a_listing_on_a_disk_that_hangs_is_answered_at_once",
            "station/test_file_transfer.py::test_logs_are_not_read_while_it_flies_documents_are",
        ),
    ),
    Finding(
        "V11",
        "PARAM_SET of 1e6 and 1e30",
        "accepted while armed",
        held_by(
            "station/test_parameters.py::test_what_was_declared_holds",
            "station/test_parameters.py::test_what_has_no_bound_stays_near_its_value_at_the_start",
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
            "firmware/test_authority.py::test_the_board_is_armed_after_a_failsafe_only_at_rest_and_with_a_confirmation",
        ),
    ),
    Finding(
        "V15",
        "first frame of a board stamped a day ahead, or 2**48 - 1",
        "stored; all are stale for ever",
        partial(run_tests, "firmware/test_authority.py::test_a_first_stamp_decades_ahead_is_not_taken_for_the_time"),
    ),
    Finding(
        "V16",
        "streams of very many senders with the key",
        "368 MB, never freed",
        held_by(
            "mavlink/test_stamps.py::test_many_senders_with_the_key_do_not_fill_the_memory_and_nothing_is_replayed"
        ),
    ),
    Finding(
        "V17",
        "a ground station arms, system 7 sends the first command",
        "system 7 owns the vehicle",
        held_by("mavlink/test_authority.py::test_another_system_does_not_inherit_what_a_ground_station_has_armed"),
    ),
    Finding(
        "V18",
        "station sets the mass to 4.5 kg while the checks run",
        "armed and flown",
        held_by("test_preflight.py::test_a_station_that_changes_a_setting_while_the_checks_run_prevents_the_flight"),
    ),
    Finding(
        "V19",
        "datagrams full of 0xFD",
        "each byte starts a frame, the loop is 1.8 s late",
        held_by("mavlink/test_endpoint.py::test_a_packet_full_of_false_starts_costs_no_more_than_a_few"),
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
            "logs/test_stream.py::test_a_stopped_writer_delays_the_end_by_its_limit",
            "logs/test_stream.py::test_a_log_that_was_deleted_says_so",
            "flight/mavlink/test_endpoint.py::test_stamps_that_cannot_be_stored_are_a_problem_to_report",
            "flight/mavlink/test_stamps.py::test_restarts_do_not_add_up_to_a_large_lead",
        ),
    ),
    Finding(
        "V22",
        "autopilot that restarts",
        "95 % of the frames lost",
        held_by("mavlink/test_losses.py::test_a_program_that_restarts_has_lost_nothing"),
    ),
]
