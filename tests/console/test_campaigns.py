"""A campaign's store on a page: its rows, and a rerun beside the nominal run."""

import asyncio
import json
import shutil

import numpy as np
import pytest
from starlette.requests import Request

from trimtab.analysis.campaign.campaign import Campaign
from trimtab.console.campaigns import CampaignFeed
from trimtab.core.errors import InputError


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign") / "mass.zarr"
    spread = {"world.vehicle.mass": "normal(100%, 5%)"}
    settings = {"duration": "3", "autopilot.law.k1": "1.2"}
    Campaign("hovercraft/zero-velocity", runs=6, seed=4, spread=spread, settings=settings).run(store=folder)
    return folder


def ask(feed, path, body=""):
    """The answer of a route."""

    async def receive():
        return {"type": "http.request", "body": body.encode()}

    method = "POST" if body else "GET"
    for route in feed.routes():
        scope = {"type": "http", "path": path, "root_path": "", "method": method, "headers": [], "query_string": b""}
        match, more = route.matches(scope)
        if match.value == 2:
            return asyncio.run(route.endpoint(Request(scope | more, receive)))
    raise AssertionError(path)


@pytest.fixture(scope="module")
def feed(store):
    return CampaignFeed(store)


@pytest.mark.thorough
def test_columns_declare_their_roles_and_rows_match(feed):
    hello = feed.feed._hello
    roles = {c["path"]: c["role"] for c in hello["columns"]}
    assert roles["run"] == "run"
    assert roles["world.vehicle.mass"] == "drawn"
    assert roles["success"] == "outcome"
    rows = np.frombuffer(ask(feed, "/campaign/rows").body, "<f8").reshape(-1, len(roles))
    assert rows[:, list(roles).index("run")].tolist() == [0, 1, 2, 3, 4, 5]


def test_run_is_rerun_beside_the_nominal_flight(feed):
    answer = json.loads(ask(feed, "/campaign/fly", '{"run": 3}').body)
    flights = feed.feed.flights
    assert flights[answer["flight"]].about["title"] == "run 3"
    assert flights[answer["nominal"]].about["title"] == "nominal"
    assert answer["command"].endswith("--rerun 3")
    own, nominal = (ask(feed, f"/flights/{k}/rows").body for k in (answer["flight"], answer["nominal"]))
    assert len(own) == len(nominal) > 1000
    assert own != nominal


@pytest.mark.parametrize("body", ['{"run": 6}', '{"run": true}', '{"run": "1"}', "{}", "}{"])
def test_rejects_invalid_run_number(feed, body):
    assert ask(feed, "/campaign/fly", body).status_code == 400


def test_store_cannot_make_the_console_run_a_file(store, tmp_path):
    copied = tmp_path / "other.zarr"
    shutil.copytree(store, copied)
    for file in copied.rglob("zarr.json"):
        file.write_text(file.read_text().replace("hovercraft/zero-velocity", "evil.py:scenario"))
    with pytest.raises(InputError, match="not in the catalogue"):
        CampaignFeed(copied)
