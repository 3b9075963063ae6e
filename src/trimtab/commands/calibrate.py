"""`trimtab calibrate`: the group of its procedures."""

import click

from trimtab.commands.calibrate_bench import PROCEDURES
from trimtab.commands.calibrate_files import compare, show, simulate_bench
from trimtab.commands.calibrate_guided import measure
from trimtab.commands.calibrate_link import calibrate_link
from trimtab.commands.calibrate_noise import calibrate_noise


@click.group()
def command() -> None:
    """From measured data to the numbers that a loop believes, with their uncertainty.

    Each procedure takes a CSV file whose headings say their units, and adds to one calibration file; every verb takes
    that file with --calibration.

    \b
    trimtab calibrate rudder servo.csv --out boat.toml       pulses and angles: the servo's table
    trimtab calibrate hull hull.csv --out boat.toml          where the force points behind the rudder
    trimtab calibrate thrust thrust.csv --out boat.toml      force of the fan by speed and rudder
    trimtab calibrate reverse reverse.csv --out boat.toml    reverse over forward thrust
    trimtab calibrate inertia spin-up.csv --force '1.1 N' --rudder '-20 deg' --out boat.toml
    trimtab calibrate friction coast.csv --out boat.toml     from coast-downs
    trimtab calibrate gyro sweep.csv --out boat.toml         how the gyro follows, and its inverse
    trimtab calibrate link up.csv --way up --out boat.toml   delays, as trimtab link-test records them
    trimtab calibrate noise still.csv --out boat.toml        noise of a unit at rest, and a filter's Q and R
    trimtab calibrate measure thrust thrust.csv              walks you through it, a line saved at a time
    trimtab calibrate simulate bench                         all this data, of a virtual craft, to rehearse
    trimtab calibrate show boat.toml                         the file, with what each number came from
    trimtab calibrate compare old.toml boat.toml --scenario hovercraft/forward
    trimtab run hovercraft/forward --calibration boat.toml
    """


for procedure in (*PROCEDURES, calibrate_link, calibrate_noise, measure, simulate_bench, show, compare):
    command.add_command(procedure)
