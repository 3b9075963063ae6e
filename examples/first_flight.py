"""Drive a hovercraft forward over a radio, ideal and real. Writes first-flight.png."""

import matplotlib.pyplot as plt

from trimtab import build, simulate

scenario = build("hovercraft/forward")
flights = {
    "ideal": scenario.ideal(),
    "over the radio, on its own sensors": build("hovercraft/forward", {"navigation": "ins"}),
}
flights["over the radio, with errors as published"] = scenario

figure, (plan, speed) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
for (name, flown), colour in zip(flights.items(), ("0.55", "C0", "C1"), strict=True):
    log = simulate(flown, seed=0)
    plan.plot(log["truth.east"], log["truth.north"], color=colour, label=name)
    speed.plot(log.t, log["truth.surge_velocity"], color=colour)
plan.set(xlabel="east (m)", ylabel="north (m)", xlim=(-1, 1), xticks=(-1, 0, 1))
speed.set(xlabel="time (s)", ylabel="speed forward (m/s)")
figure.legend(loc="outside upper center", ncols=3)
figure.savefig("first-flight.png", dpi=110)
