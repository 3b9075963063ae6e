"""Services that a vehicle offers to ground stations in addition to telemetry, and their options.

Source: docs page, Ground stations.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.parameter_store import ParameterStore
from trimtab.flight.station.file_transfer import FileTransferService
from trimtab.flight.station.log_download import LogService
from trimtab.flight.station.missions import MissionService
from trimtab.flight.station.served_files import ServedFiles
from trimtab.flight.station.standard_services import Service
from trimtab.flight.station.telemetry import Place


class StationOptions(NamedTuple):
    """Options of the services that a vehicle offers to ground stations.

    log_folder: folder of the logs that stations may read, or None to offer no logs.  transfer_rate: maximum rate of
    file transfer (byte/s).
    origin: latitude, longitude and altitude of the origin of the world frame W, or None if they are unknown.
    store: file for parameters that a ground station asks to store, or None to store no parameters.
    """

    log_folder: Path | None = None
    transfer_rate: float = 20e3
    origin: Place | None = None
    store: ParameterStore | None = None


def station_services(endpoint: Endpoint, options: StationOptions, documents: Mapping[str, bytes]) -> list[Service]:
    """Return the services that a vehicle offers to ground stations. documents: content of each served file except logs,
    by name."""
    files, rate = ServedFiles(documents, options.log_folder), options.transfer_rate
    return [
        MissionService(endpoint),
        FileTransferService(endpoint, files, rate),
        LogService(endpoint, files, rate),
    ]
