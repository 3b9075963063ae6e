"""Model of the hovercraft for `trimtab design hovercraft --stabilisability`: all six states, at rest."""

from trimtab.core.signals import PlanarForce
from trimtab.design.model import StateSpaceModel, model_of_vehicle
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState


def model() -> StateSpaceModel:
    """Return the model. States: velocity, position and heading. Input: the force at the rudder pivot."""
    return model_of_vehicle(Hovercraft(), HovercraftState(), PlanarForce(0.0, 0.0))
