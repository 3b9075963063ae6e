import json

import jsonschema
import numpy as np

from trimtab.core.quantity import Quantity
from trimtab.logs.log import Log
from trimtab.logs.messages import group_by_topic, topic_schema


def test_paths_are_grouped_by_block_into_topics():
    paths = (
        "truth.heading",
        "sensors.navigation.value.yaw_rate",
        "sensors.navigation.fresh",
        "sensors.imu.age",
        "sensors.count",
        "downlink.navigation.age",
        "law.demand.FX",
    )
    assert group_by_topic(paths) == {
        "/truth": {"truth.heading": ("heading",)},
        "/sensors/navigation": {
            "sensors.navigation.value.yaw_rate": ("value", "yaw_rate"),
            "sensors.navigation.fresh": ("fresh",),
        },
        "/sensors/imu": {"sensors.imu.age": ("age",)},
        "/sensors": {"sensors.count": ("count",)},
        "/downlink/navigation": {"downlink.navigation.age": ("age",)},
        "/law": {"law.demand.FX": ("demand", "FX")},
    }


def made() -> dict:
    declared = {
        "law.demand.FX": Quantity("N", "Along the body's x axis.", frame="B"),
        "law.mode": Quantity("1", "Which law.", kind="mode", modes=("damp", "turn")),
        "law.on": Quantity("1", "Running.", kind="flag"),
        "law.count": Quantity("1", "Switches.", kind="count"),
        "law.p": Quantity("m", "Place.", shape=(3,)),
    }
    signals = {
        "law.demand.FX": np.zeros(2),
        "law.mode": np.zeros(2, np.int32),
        "law.on": np.zeros(2, bool),
        "law.count": np.zeros(2, np.int32),
        "law.p": np.zeros((2, 3)),
        "law.plain": np.zeros(2),
    }
    ticks = np.array([0, 1])
    log = Log(ticks / 1e7, ticks, signals, declared)
    return topic_schema(log, "/law", group_by_topic(log.paths)["/law"])


def test_schema_property_has_type_unit_and_description():
    schema = made()
    assert schema["type"] == "object"
    assert schema["title"] == "trimtab.law"
    FX = schema["properties"]["demand"]["properties"]["FX"]
    assert FX["type"] == "number"
    assert FX["unit"] == "N"
    assert FX["frame"] == "B"
    assert "Along the body's x axis. [N]" in FX["description"]
    assert schema["properties"]["on"]["type"] == "boolean"
    assert schema["properties"]["count"]["type"] == "integer"
    assert schema["properties"]["p"]["items"] == {"type": "number"}
    assert schema["properties"]["plain"] == {"type": "number"}


def test_schema_lists_mode_names():
    mode = made()["properties"]["mode"]
    assert mode["oneOf"] == [{"title": "damp", "const": 0}, {"title": "turn", "const": 1}]
    assert "0: damp, 1: turn" in mode["description"]


def test_schema_is_valid_and_without_unions():
    schema = made()
    jsonschema.Draft202012Validator.check_schema(schema)
    assert all(isinstance(p["type"], str) for p in schema["properties"].values())
    good = {"demand": {"FX": 1.5}, "mode": 1, "on": True, "count": 3, "p": [1, 2, 3], "plain": 0.5}
    jsonschema.validate(json.loads(json.dumps(good)), schema)
    for wrong in ({"mode": 2}, {"p": [1, 2]}, {"demand": {"FX": "1"}}):
        assert list(jsonschema.Draft202012Validator(schema).iter_errors(good | wrong))
