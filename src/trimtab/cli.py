"""Guidance, navigation and control of vehicles that are hard to steer.

\b
trimtab demo                                     the first flight: a table and a picture
trimtab list                                     every scenario
trimtab list hovercraft/spin                     every setting of one, with unit and meaning
trimtab new vehicle my_bike                      a vehicle of your own, with test and page; also law, sensor …
trimtab run hovercraft/spin --plot spin.png      fly it, ideal beside real
trimtab run hovercraft/spin --set world.vehicle.mass=3.2 --without navigation-error
trimtab run hovercraft/forward --navigation ins  flown on IMU and ultrasonic network, not on an error model
trimtab budget hovercraft/forward                what each imperfection costs
trimtab campaign hovercraft/spin --runs 4000     how often it succeeds, with bounds
trimtab falsify hovercraft/zero-velocity --spread 'world.vehicle.mass=uniform(80%, 120%)'
trimtab rare hovercraft/spin --spread 'world.vehicle.mass=normal(100%, 5%)' --success 'peak:yaw_rate <= 4'
trimtab tune hovercraft/zero-velocity --gain autopilot.law.k1=0.5:3 --gain autopilot.law.k2=1:5
trimtab map hovercraft/zero-velocity --x delay=0:0.6 --y loss=0:0.9 --success 'error_rms:yaw_rate <= 0.6'
trimtab reproduce hovercraft2006                 a publication computed again, with verdicts
trimtab calibrate noise still/run.mcap           noise of a sensor at rest, and a filter's Q and R
trimtab calibrate thrust thrust.csv --out boat.toml  from a gauge's readings to numbers with their errors
trimtab identify hovercraft/spin flight.mcap --fit world.vehicle.mass   the same from a flight
trimtab linearise hypersonic --output h --output V     trim, poles, modes and zeros of any vehicle
trimtab design hypersonic --out gain.json        a gain, and a certificate that proves it
trimtab plan examples/hall.toml --out plan.csv   a path between obstacles that the hovercraft can fly
trimtab vehicle hovercraft/forward --listen udp://:14550           a vehicle behind a real line
trimtab fly hovercraft/forward --link udp://127.0.0.1:14550        and its autopilot in real time
trimtab console hovercraft/pilot                 fly a simulated craft from a page in a browser
trimtab replay here/flight.mcap                  a log's frames once more: the same to the bit
trimtab plot here/flight.mcap truth.yaw_rate     any signals of a log, by their paths
trimtab compare a/run.mcap b/run.mcap            where two logs first differ; of one, where a rerun does
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
