"""Fitting an interface takes its members and nothing else: no base class, no registration."""

import pytest

from trimtab.core import interfaces
from trimtab.core.time import ms


class Gyro:
    period = ms(10)

    def init(self, key): ...
    def measure(self, motion): ...
    def step(self, t, state, motion): ...


class Zero:
    reads = ("yaw_rate",)

    def init(self, key): ...
    def step(self, t, state, estimate): ...


class Fusion:
    listens = ("imu",)

    def init(self, key): ...
    def step(self, t, state, frame): ...


class Thruster:
    period = ms(20)

    def neutral(self): ...
    def init(self, key): ...
    def step(self, t, state, command): ...


class Boat:
    def dynamics(self, t, x, u): ...
    def motion(self, t, x, u): ...


FITS = {
    "Sensor": Gyro,
    "Channel": Gyro,
    "Law": Zero,
    "Estimator": Fusion,
    "Allocation": Zero,
    "Actuators": Thruster,
    "Vehicle": Boat,
}


@pytest.mark.parametrize(("interface", "cls"), FITS.items())
def test_class_with_all_members_satisfies_the_interface(interface, cls):
    assert isinstance(cls(), getattr(interfaces, interface))


@pytest.mark.parametrize(
    ("interface", "cls"),
    [
        ("Sensor", Thruster),
        ("Law", Gyro),
        ("Estimator", Zero),
        ("Actuators", Gyro),
        ("Vehicle", Gyro),
        ("Estimator", Boat),
    ],
)
def test_class_without_a_member_fails_the_interface(interface, cls):
    assert not isinstance(cls(), getattr(interfaces, interface))


def test_hovercraft_satisfies_the_vehicle_interface():
    from trimtab.vehicles.hovercraft import Hovercraft

    assert isinstance(Hovercraft(), interfaces.Vehicle)
