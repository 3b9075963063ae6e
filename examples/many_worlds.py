"""Fly thousands of runs with varied parameters: success rate, and the worst run."""

from pathlib import Path

import numpy as np

from trimtab import Campaign
from trimtab.logs.mcap import write_mcap


def main() -> None:
    """Bring the hovercraft to rest with uncertain mass, inertia and radio."""
    campaign = Campaign(
        "hovercraft/zero-velocity",
        runs=1000,
        seed=1,
        settings={"links": "measured", "world.uplink.capacity": "32"},
        spread={
            "world.vehicle.mass": "normal(100%, 5%)",
            "world.vehicle.inertia": "normal(100%, 10%)",
            "world.uplink.latency": "uniform(50%, 150%)",
        },
        metrics=["settling:yaw_rate", "error_rms:yaw_rate"],
        success=["settling:yaw_rate <= 14"],
    )
    found = campaign.run()
    print("at rest within 14 s:", found.success, f"at {100 * found.success.level:.0f} % confidence")
    worst = int(np.argmax(found.columns["error_rms:yaw_rate"]))
    print(f"worst: run {worst}, mass {found.columns['world.vehicle.mass'][worst]:.3f} kg")
    log = campaign.rerun(worst)
    write_mcap(log, Path("worst.mcap"))
    print(log)


if __name__ == "__main__":
    main()
