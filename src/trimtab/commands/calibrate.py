"""`trimtab calibrate`: group of the calibration procedures."""

import click

from trimtab.commands.calibrate_bench import PROCEDURES
from trimtab.commands.calibrate_files import compare, show, simulate_bench
from trimtab.commands.calibrate_guided import measure
from trimtab.commands.calibrate_link import calibrate_link
from trimtab.commands.calibrate_noise import calibrate_noise


@click.group()
def command() -> None:
    """Calibrate parameters of a control loop from measured data. Every result has a standard error.

    Each procedure reads a CSV file with units in its headings, and adds its results to a calibration file. Commands
    that simulate, analyse or fly a scenario use this file with --calibration.

    \b
    trimtab calibrate rudder servo.csv --out boat.toml       servo table, from pulses and angles
    trimtab calibrate hull hull.csv --out boat.toml          force direction, from the rudder angle
    trimtab calibrate thrust thrust.csv --out boat.toml      thrust, from speed and rudder angle
    trimtab calibrate reverse reverse.csv --out boat.toml    ratio of reverse to forward thrust
    trimtab calibrate inertia spin-up.csv --force '1.1 N' --rudder '-20 deg' --out boat.toml
    trimtab calibrate friction coast.csv --out boat.toml     friction, from coast-downs
    trimtab calibrate gyro sweep.csv --out boat.toml         gyro dynamics and inverse dynamics
    trimtab calibrate link up.csv --way up --out boat.toml   link delays, recorded by trimtab link-test
    trimtab calibrate noise still.csv --out boat.toml        noise of a sensor at rest; Q and R of a filter
    trimtab calibrate measure thrust thrust.csv              guided measurement; saves each value
    trimtab calibrate simulate bench                         simulated data of all procedures, for practice
    trimtab calibrate show boat.toml                         parameters in the file, with sources
    trimtab calibrate compare old.toml boat.toml --scenario hovercraft/forward
    trimtab run hovercraft/forward --calibration boat.toml
    """


for procedure in (*PROCEDURES, calibrate_link, calibrate_noise, measure, simulate_bench, show, compare):
    command.add_command(procedure)
