from trimtab.campaign.campaign import Campaign as Campaign
from trimtab.compiler.compiled_function import compile as compile
from trimtab.core.errors import InputError as InputError
from trimtab.core.quantity import option as option
from trimtab.core.quantity import part as part
from trimtab.core.quantity import period as period
from trimtab.core.quantity import quantity as quantity
from trimtab.core.record import record as record
from trimtab.core.record import replace as replace
from trimtab.core.time import ms as ms
from trimtab.core.time import seconds as seconds
from trimtab.export.export_c import export_c as export_c
from trimtab.links.open_link import open_link as open_link
from trimtab.logs.metrics import Target as Target
from trimtab.loop.autopilot import Autopilot as Autopilot
from trimtab.loop.scenario import Scenario as Scenario
from trimtab.loop.world import World as World
from trimtab.run.simulate import simulate as simulate
from trimtab.run.simulate import simulate_batch as simulate_batch
from trimtab.scenarios.build import build as build

__version__: str
HOMES: dict[str, str]
