"""What computed a log, for who wants to compute it again."""

import platform

from trimtab import __version__


def provenance() -> dict[str, str]:
    """The version, and the class of machine within which compiled code gives the same bits: processor and system."""
    return {"version": __version__, "machine": f"{platform.machine()} {platform.system()}"}
