"""Output of --json. The names are stable and contain units. Standard output contains nothing but the JSON object."""

import json
from typing import Any


def print_json(facts: dict[str, Any]) -> None:
    """Print one JSON object to standard output."""
    from palmfield.types import json_value

    print(json.dumps(facts, indent=2, default=json_value, allow_nan=False))
