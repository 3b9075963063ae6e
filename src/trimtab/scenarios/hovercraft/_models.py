"""Model of the hovercraft at rest, with all six states, for `trimtab design hovercraft --stabilisability`."""

from trimtab.core.signals import PlanarForce
from trimtab.design.model import StateSpaceModel, model_of_vehicle
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState


def model() -> StateSpaceModel:
    """Return the model of the hovercraft. States: velocity, position and heading. Input: force at the rudder pivot."""
    return model_of_vehicle(Hovercraft(), HovercraftState(), PlanarForce(0.0, 0.0))
