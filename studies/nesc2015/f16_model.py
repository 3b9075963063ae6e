"""The F-16's coefficients against the checks of its model file.

F16_aero.dml contains sixteen flight conditions with the six coefficients of each.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from studies.nesc2015._data import DATA, FOOT
from trimtab.core.rotation import DEG
from trimtab.environment.atmosphere import standard_atmosphere
from trimtab.study import Row, at_most
from trimtab.vehicles.f16 import F16Controls, coefficients
from trimtab.vehicles.rigid_body import Airflow

SECTION = "F16_aero.dml, checkData"
RATES = ("bodyAngularRate_Roll", "bodyAngularRate_Pitch", "bodyAngularRate_Yaw")
SURFACES = ("elevatorDeflection", "aileronDeflection", "rudderDeflection")
COEFFICIENTS = (
    "aeroBodyForceCoefficient_X",
    "aeroBodyForceCoefficient_Y",
    "aeroBodyForceCoefficient_Z",
    "aeroBodyMomentCoefficient_Roll",
    "aeroBodyMomentCoefficient_Pitch",
    "aeroBodyMomentCoefficient_Yaw",
)


def coefficients_of(given: dict[str, float]) -> Any:
    """Return the computed coefficients (6,) for the inputs of a check."""
    speed, alpha, beta = given["trueAirspeed"] * FOOT, given["angleOfAttack"] * DEG, given["angleOfSideslip"] * DEG
    way = np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    elevator, aileron, rudder = (given[name] * DEG for name in SURFACES)
    flow = Airflow(speed * way, speed, np.array([given[name] for name in RATES]), standard_atmosphere(0.0))
    return np.asarray(coefficients(flow, F16Controls(elevator, aileron, rudder, throttle=0.0)))


def rows() -> Iterator[Row]:
    """Yield the largest difference of each check's six coefficients."""
    for i, check in enumerate(json.loads((DATA / "f16_checks.json").read_text(encoding="utf-8"))):
        wanted = np.array([check["outputs"][name] for name in COEFFICIENTS])
        off = float(np.max(np.abs(coefficients_of(check["inputs"]) - wanted)))
        what = f"{check['name'].lower()}: six coefficients, largest difference"
        yield at_most(f"check-{i}", what, 0.0, off, "[1] F16_aero.dml", high=1e-13)
