"""A ground station made with MAVSDK. Prints its findings at a local UDP port as a line of JSON."""

import json
import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.ftp import Ftp
from mavsdk.plugins.log_files import LogFiles
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

PATIENCE = 30.0
DISCOVERY = 8.0


def until(condition):
    """Wait until a condition holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise SystemExit("MAVSDK waited in vain")
        time.sleep(0.05)


def explore(system):
    """Read the vehicle's state, arm and disarm it, change a parameter and the mode. Return the findings."""
    telemetry, action, param, direct = Telemetry(system), Action(system), Param(system), MavlinkDirect(system)
    seen, texts, modes = {}, [], []
    telemetry.subscribe_attitude_euler(lambda v, *_: seen.update(attitude=[v.roll_deg, v.pitch_deg, v.yaw_deg]))
    telemetry.subscribe_position_velocity_ned(
        lambda v, *_: seen.update(position=[v.position.north_m, v.position.east_m, v.position.down_m])
    )
    telemetry.subscribe_position(lambda v, *_: seen.update(place=[v.latitude_deg, v.longitude_deg]))
    telemetry.subscribe_home(lambda v, *_: seen.update(home=[v.latitude_deg, v.longitude_deg]))
    telemetry.subscribe_armed(lambda v, *_: seen.update(now_armed=bool(v)))
    healthy = []  # MAVSDK says yes at each LOCAL_POSITION_NED, no at each SYS_STATUS without GPS, flow or camera
    telemetry.subscribe_health(lambda v, *_: healthy.append(bool(v.is_local_position_ok)))
    telemetry.subscribe_status_text(lambda v, *_: texts.append(v.text))
    direct.subscribe_message("HEARTBEAT", lambda m, *_: modes.append(json.loads(m.fields_json)["custom_mode"]))
    known = {"attitude", "position", "now_armed", "place", "home"}
    until(lambda: modes and known <= seen.keys() and any(healthy))
    seen["local_position_ok"] = any(healthy)
    armed, mass = [seen["now_armed"]], [param.get_param_float("WV_MASS")]
    first = modes[-1]
    files = Ftp(system).list_directory("/logs").entries
    logs = [entry.size_bytes for entry in LogFiles(system).get_entries()]
    param.set_param_float("WV_MASS", 2.8)
    mass.append(param.get_param_float("WV_MASS"))
    for act, wanted in ((action.arm, True), (action.disarm, False)):
        act()
        until(lambda wanted=wanted: seen["now_armed"] == wanted)
        armed.append(seen["now_armed"])
    fields = {f"param{k}": 0 for k in range(1, 8)} | {"param1": 1, "command": 176, "confirmation": 0}
    fields |= {"target_system": 1, "target_component": 1}
    direct.send_message(MavlinkMessage("COMMAND_LONG", 0, 0, 1, 1, json.dumps(fields)))
    until(lambda: modes[-1] != first)
    del seen["now_armed"]
    count = len(param.get_all_params().float_params)
    return (
        seen
        | {"armed": armed, "mass": mass, "modes": [first, modes[-1]], "texts": texts, "parameters": count}
        | {
            "files": [file.name for file in files],
            "logs": logs,
        }
    )


def main():
    station = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    station.add_any_connection(f"udpout://127.0.0.1:{sys.argv[1]}")
    system = station.first_autopilot(DISCOVERY)
    if system is None:
        print(json.dumps({"system": None}))
    else:
        found = {"system": system.get_system_id(), "components": list(system.component_ids())} | explore(system)
        print(json.dumps(found))
    sys.stdout.flush()
    station.destroy()


main()
