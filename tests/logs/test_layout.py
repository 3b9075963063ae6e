"""The Foxglove layout in the docs shows topics of our logs in configured panels."""

import json
from pathlib import Path

from trimtab.logs.frames import frame_topics
from trimtab.logs.messages import EVENTS

LAYOUT = Path(__file__).parents[2] / "docs" / "live" / "trimtab-foxglove.json"


def panels(node):
    return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])


def test_every_panel_is_configured_and_shows_existing_topics():
    layout = json.loads(LAYOUT.read_text())
    configured = layout["configById"]
    assert sorted(panels(layout["layout"])) == sorted(configured)
    topics = {topic.name for topic in frame_topics()}
    kinds = {name.partition("!")[0]: config for name, config in configured.items()}
    assert kinds["map"]["followTopic"] in topics
    assert set(kinds["3D"]["topics"]) <= topics
    assert kinds["RosOut"]["topicToRender"] == EVENTS
    assert all(path["value"].startswith("/truth.") for path in kinds["Plot"]["paths"])
