"""Model of the hypersonic vehicle at trim, with nine states, for `trimtab design hypersonic --stabilisability`."""

from trimtab.design.model import StateSpaceModel
from trimtab.laws.path_inversion import InputLimits
from trimtab.scenarios.hypersonic._design import NOMINAL, H, V
from trimtab.scenarios.hypersonic._internal import design_model, find_trim


def model() -> StateSpaceModel:
    """Return the model at its trim point. States: longitudinal flight and bending modes. Inputs: fuel ratio,
    elevator."""
    plant = design_model(NOMINAL, H, V)
    level = find_trim(plant, InputLimits(), "hypersonic trim")
    return plant._replace(x0=level.x, u0=level.u)
