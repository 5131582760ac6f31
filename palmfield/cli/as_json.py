"""What commands print with --json: names are stable and carry units, nothing else goes to standard output."""

import json
from typing import Any


def print_json(facts: dict[str, Any]) -> None:
    """One JSON object on standard output."""
    from palmfield.types import json_value

    print(json.dumps(facts, indent=2, default=json_value, allow_nan=False))
