"""Guidance, navigation and control of vehicles that are hard to steer.

\b
trimtab demo                                     fly a first scenario: a table and a picture
trimtab list                                     every scenario
trimtab list hovercraft/spin                     all settings of one scenario, with unit and meaning
trimtab new vehicle my_bike                      a template of a new vehicle, with test and page; also law, sensor …
trimtab run hovercraft/spin --plot spin.png      simulate it, ideal and real
trimtab run hovercraft/spin --set world.vehicle.mass=3.2 --without navigation-error
trimtab run hovercraft/forward --navigation ins  navigate by IMU and ultrasonic network instead of an error model
trimtab budget hovercraft/forward                cost of each imperfection
trimtab campaign hovercraft/spin --runs 4000     success rate over many runs, with confidence bounds
trimtab falsify hovercraft/zero-velocity --spread 'world.vehicle.mass=uniform(80%, 120%)'
trimtab rare hovercraft/spin --spread 'world.vehicle.mass=normal(100%, 5%)' --success 'peak:yaw_rate <= 4'
trimtab tune hovercraft/zero-velocity --gain autopilot.law.k1=0.5:3 --gain autopilot.law.k2=1:5
trimtab map hovercraft/zero-velocity --x delay=0:0.6 --y loss=0:0.9 --success 'error_rms:yaw_rate <= 0.6'
trimtab reproduce hovercraft2006                 recompute a publication's figures, with verdicts
trimtab calibrate noise still/run.mcap           noise of a sensor at rest; Q and R of a filter
trimtab calibrate thrust thrust.csv --out boat.toml  parameters from force readings, with errors
trimtab identify hovercraft/spin flight.mcap --fit world.vehicle.mass   parameters from a flight
trimtab linearise hypersonic --output h --output V     trim, poles, modes and zeros of a vehicle
trimtab design hypersonic --out gain.json        a gain, and a certificate that proves its stability
trimtab plan examples/hall.toml --out plan.csv   a feasible path between obstacles
trimtab vehicle hovercraft/forward --listen udp://:14550           a simulated vehicle behind a real link
trimtab fly hovercraft/forward --link udp://127.0.0.1:14550        the autopilot for it, in real time
trimtab console hovercraft/pilot                 fly a simulated craft from a page in a browser
trimtab replay here/flight.mcap                  replay a log's frames; the result is bit-identical
trimtab plot here/flight.mcap truth.yaw_rate     plot signals of a log
trimtab compare a/run.mcap b/run.mcap            first difference of two logs, or of a log and its rerun
trimtab convert there/vehicle.mcap --as ros2 --out bag   a flight for RViz; also for Rerun
"""

import click

from trimtab import __version__
from trimtab.commands.verbs import Verbs

VERBS = (
    "demo",
    "list",
    "new",
    "run",
    "budget",
    "campaign",
    "falsify",
    "rare",
    "map",
    "tune",
    "trim",
    "linearise",
    "zeros",
    "design",
    "calibrate",
    "identify",
)
VERBS += (
    "plan",
    "reproduce",
    "vehicle",
    "fly",
    "console",
    "inject",
    "replay",
    "link-test",
    "live-faults",
    "export",
    "firmware",
    "plot",
    "compare",
    "convert",
    "completion",
)

main = Verbs(VERBS, help=__doc__, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
main = click.version_option(__version__, prog_name="trimtab")(main)

if __name__ == "__main__":
    main()
