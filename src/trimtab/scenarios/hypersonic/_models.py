"""The hypersonic vehicle as a model for `trimtab design hypersonic --stabilisability`: nine states, at its trim."""

from trimtab.design.model import StateSpaceModel
from trimtab.laws.path_inversion import InputLimits
from trimtab.scenarios.hypersonic._design import NOMINAL, H, V
from trimtab.scenarios.hypersonic._internal import design_model, find_trim


def model() -> StateSpaceModel:
    """Return flight in the vertical plane with its bending modes, under fuel ratio and elevator, at its trim."""
    plant = design_model(NOMINAL, H, V)
    level = find_trim(plant, InputLimits(), "hypersonic trim")
    return plant._replace(x0=level.x, u0=level.u)
