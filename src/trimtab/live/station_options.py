"""What a vehicle is asked to do for ground stations besides telling its state, and the services that do it.

Source: docs page, Ground stations.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from trimtab.live.parameter_store import ParameterStore
from trimtab.wire.file_transfer import FileTransferService
from trimtab.wire.log_download import LogService
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.missions import MissionService
from trimtab.wire.served_files import ServedFiles
from trimtab.wire.station import Service
from trimtab.wire.telemetry import Place


class StationOptions(NamedTuple):
    """What ground stations get of a vehicle.

    log_folder: whose logs may be read; None: there are none.  transfer_rate: bytes a second of a file at most.
    origin: where W is on the globe; None: nobody has said.  store: where parameters are stored when a station asks
    for it; None: nowhere.
    """

    log_folder: Path | None = None
    transfer_rate: float = 20e3
    origin: Place | None = None
    store: ParameterStore | None = None


def station_services(endpoint: Endpoint, options: StationOptions, documents: Mapping[str, bytes]) -> list[Service]:
    """The services of a vehicle's station. documents: files besides the logs, by name."""
    files, rate = ServedFiles(documents, options.log_folder), options.transfer_rate
    return [
        MissionService(endpoint),
        FileTransferService(endpoint, files, rate),
        LogService(endpoint, files, rate),
    ]
