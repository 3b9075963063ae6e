"""What commands print after --json, held to the JSON Schema that trimtab publishes of it."""

import functools
import json
from collections.abc import Mapping
from typing import Any

from trimtab.commands import output

compose = output.compose_answer


@functools.cache
def read_schema() -> dict[str, Any]:
    """The published schema."""
    return json.loads(output.ANSWERS.read_text("utf-8"))


@functools.cache
def _validator(verb: str) -> Any:
    from jsonschema import Draft202012Validator  # after the first answer: most tests print none

    schema = read_schema()
    assert verb in schema["$defs"], f"{verb} prints an answer that no schema describes"
    return Draft202012Validator({"$ref": f"#/$defs/{verb}", "$defs": schema["$defs"]})


def complaints(answer: Mapping[str, Any]) -> list[str]:
    """Where an answer is not what the schema says; of one that may be several things, of the likeliest."""
    verb, _, version = str(answer["answer"]).partition("/")
    assert int(version) == output.ANSWER_VERSION

    def explain(error: Any) -> list[str]:
        if not error.context:
            return [f"{error.json_path}: {error.message[:300]}"]
        branches: dict[Any, list[Any]] = {}
        for one in error.context:
            branches.setdefault(one.relative_schema_path[0], []).append(one)
        return [text for one in min(branches.values(), key=len) for text in explain(one)]

    return [text for error in _validator(verb).iter_errors(answer) for text in explain(error)]


def compose_checked(verb: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """The answer as it is printed; fails where it is not as the schema says."""
    answer = compose(verb, result)
    wrong = complaints(json.loads(json.dumps(answer)))
    assert not wrong, f"--json of {verb}: {wrong}"
    return answer
