from trimtab.analysis.campaign.campaign import Campaign as Campaign
from trimtab.analysis.campaign.search.falsify import falsify as falsify
from trimtab.analysis.campaign.search.tune import tune as tune
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
from trimtab.logs.mcap import read_mcap, write_mcap
from trimtab.logs.metrics import Target as Target
from trimtab.logs.metrics import metrics as metrics
from trimtab.loop.autopilot import Autopilot as Autopilot
from trimtab.loop.scenario import Scenario as Scenario
from trimtab.loop.settings import with_settings as with_settings
from trimtab.loop.world import World as World
from trimtab.plots.run import plot_run as plot_run
from trimtab.run.error_budget import error_budget as error_budget
from trimtab.run.replay import replay as replay
from trimtab.run.simulate import simulate as simulate
from trimtab.run.simulate import simulate_batch as simulate_batch
from trimtab.scenarios.build import build as build
from trimtab.scenarios.catalogue import scenario_names as scenario_names
from trimtab.scenarios.settings_table import settings as settings
from trimtab.vehicle_model import linearise as linearise
from trimtab.vehicle_model import trim as trim

read_log = read_mcap
write_log = write_mcap

__version__: str
HOMES: dict[str, str]
