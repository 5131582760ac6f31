"""Read designs from the command line and tables, assign their keys to instances of a scene, and check values."""

import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from palmfield.config import CONFIGS, FILE_KEYS, allowed
from palmfield.errors import SceneError, naming, reason_of
from palmfield.files import regular
from palmfield.session.open_scene import as_text, instances_of
from palmfield.session.scene_text import Instance
from palmfield.session.worlds import BOUND
from palmfield.studies.sweeps.design import Design, Range, Value, check_range, grid, listed, random, sobol

COMPONENT = re.compile(r"(?P<key>.+)\[(?P<place>\d+)\]")
STIMULUS = "palmfield.stimulus"
_CONFIGS = {config.plugin: config for config in CONFIGS}
FORMS = (
    "KEY=a:b:n (n numbers from a to b), KEY=a:b:n:log (logarithmic spacing), KEY=v1,v2,..., KEY=value (the same "
    "for all points) or KEY= (removed)"
)
DRAWN_FORMS = "KEY=a:b, KEY=a:b:log, KEY=v1,v2,... (one of them), KEY=value (the same for all points) or KEY= (removed)"


class _Place(NamedTuple):
    """The value that a key of a sweep sets. component: index in a vector, None for the whole value"""

    instance: Instance
    key: str
    component: int | None


def _may_differ(place: _Place) -> bool:
    """Return whether the value may differ between worlds of one model."""
    return place.instance.plugin == STIMULUS and place.key not in BOUND


@dataclass(frozen=True)
class SceneKeys:
    """The keys of a design, and the keys that all its points share, checked against one scene.

    instances: plugin instances of the scene
    places: key -> the value that it sets
    fixed: values that all points share, by `INSTANCE.KEY`; None removes a key
    """

    instances: tuple[Instance, ...]
    places: dict[str, tuple[_Place, ...]]
    fixed: dict[str, Value | None]

    def of_point(self, point: Mapping[str, Value | None]) -> dict[str, Value | None]:
        """Return keys for `palmfield.Simulation` from the values of a point.

        Raises SceneError for a component if the key is no vector or the vector is too short.
        """
        result: dict[str, Value | None] = dict(self.fixed)
        for key, value in point.items():
            for instance, name, component in self.places[key]:
                full = f"{instance.name}.{name}"
                result[full] = value if component is None else self._replaced(result, instance, name, component, value)
        return result

    def of_model(self, point: Mapping[str, Value]) -> tuple[tuple[str, Value], ...]:
        """Return the values that all points of one model must share. Values of stimuli that may differ are excluded."""
        own = {key: value for key, value in point.items() if not all(map(_may_differ, self.places[key]))}
        return tuple(sorted(own.items()))

    def differing(self, point: Mapping[str, Value]) -> dict[str, Value | None]:
        """Return those keys of `of_point` that may differ between worlds of one model."""
        own = self.of_point(point)
        names = [f"{p.instance.name}.{p.key}" for key in point for p in self.places[key] if _may_differ(p)]
        return {name: own[name] for name in dict.fromkeys(names)}

    def files(self, design: Design) -> list[str]:
        """Return the files named by the scene, the shared keys and the design, each once."""
        named = [(key, text) for instance in self.instances for key, text in instance.keys.items()]
        named += [(full.rpartition(".")[2], str(value)) for full, value in self.fixed.items()]
        named += [(key.rpartition(".")[2], str(value)) for key, several in design.values.items() for value in several]
        return sorted({text for key, text in named if key in FILE_KEYS})

    def _replaced(
        self, keys: dict[str, Value | None], instance: Instance, name: str, component: int, value: Value | None
    ) -> tuple[float, ...]:
        """Return the vector of a key with one component replaced."""
        current = keys.get(f"{instance.name}.{name}", instance.keys.get(name))
        if current is None:
            field = _CONFIGS[instance.plugin].model_fields[name] if instance.plugin in _CONFIGS else None
            current = () if field is None else field.default
        element = f"key '{instance.name}.{name}[{component}]'"
        try:
            vector = [float(part) for part in as_text(current).split()]
            if component < len(vector):
                vector[component] = float(value)  # type: ignore[arg-type]
                return tuple(vector)
        except (TypeError, ValueError):
            raise SceneError(f"{element} has value {value!r} in {current!r}; allowed: numbers in a vector") from None
        raise SceneError(f"{element}: the key has {len(vector)} numbers; allowed: 0 to {len(vector) - 1}")


def scene_keys(scene: str | Path, design: Design, fixed: Mapping[str, Value | None]) -> SceneKeys:
    """Check a design and the keys that all points share against a scene.

    Raises SceneError for a scene that cannot be read, unknown instances and keys, two keys that set the same value, and
    values that are invalid for all values of the other keys.
    """
    places: dict[str, tuple[_Place, ...]] = {}
    set_by: dict[tuple[str, str], list[tuple[str, int | None]]] = {}
    for key in [*sorted(fixed, key=lambda key: COMPONENT.fullmatch(key) is not None), *design.keys]:
        found = COMPONENT.fullmatch(key)
        plain, component = (found["key"], int(found["place"])) if found else (key, None)
        instances, changes = instances_of(scene, {plain: ""})
        by_name = {instance.name: instance for instance in instances}
        name = plain.rpartition(".")[2]
        places[key] = tuple(_Place(by_name[owner], name, component) for owner in changes)
        for owner in changes:
            for other, part in set_by.setdefault((owner, name), []):
                # One component may be swept of a vector that all points share
                whole_first = part is None and component is not None and other in fixed
                if not whole_first and (component is None or part is None or part == component):
                    raise SceneError(f"keys '{other}' and '{key}' both set {owner}.{name}; give one of them")
            set_by[owner, name].append((key, component))
    for key, values in (*((key, (value,)) for key, value in fixed.items()), *design.values.items()):
        for place in places[key]:
            for value in dict.fromkeys(values):
                _check_value(place, value)
    keys = SceneKeys(tuple(instances_of(scene, {})[0]), places, {})
    keys = replace(keys, fixed=keys.of_point(fixed))
    keys.of_point(design.point(0))
    return keys


def _check_value(place: _Place, value: Value | None) -> None:
    """Raise SceneError for a value of a key that is invalid for all values of the other keys."""
    config = _CONFIGS.get(place.instance.plugin)
    if config is None or value is None or place.component is not None:
        return
    try:
        config.model_validate({place.key: as_text(value)})
    except ValidationError as error:
        if any(wrong["loc"] and wrong["loc"][0] == place.key for wrong in error.errors()):
            raise SceneError(
                f"plugin '{place.instance.plugin}' instance '{place.instance.name}': key '{place.key}' has value "
                f"'{as_text(value)}'; allowed: {allowed(config, place.key)}"
            ) from None


def read_design(
    settings: Sequence[str],
    *,
    random_points: int | None = None,
    sobol_points: int | None = None,
    table: Path | None = None,
    seed: int = 0,
) -> tuple[Design, dict[str, Value | None]]:
    """Parse the design and the shared keys from texts such as `stimulus.am_frequency_Hz=50:300:6`.

    A shared key with value None is removed from the scene.

    settings: KEY=VALUES, in one of FORMS; with random_points or sobol_points in one of DRAWN_FORMS
    table: CSV file with keys in its first line and a row for each point; settings then define the shared keys
    Raises SceneError for an invalid text, an empty range, a repeated key, or several kinds of design at once.
    """
    kinds = [random_points is not None, sobol_points is not None, table is not None]
    if sum(kinds) > 1:
        raise SceneError("--random, --sobol and --list exclude each other; give one of them")
    drawn = random_points is not None or sobol_points is not None
    swept: dict[str, Range | list[Value]] = {}
    fixed: dict[str, Value | None] = {}
    for text in settings:
        key, equals, values = text.partition("=")
        key, values = key.strip(), values.strip()
        if not equals or not key:
            raise SceneError(f"--set {text} has no values; write {DRAWN_FORMS if drawn else FORMS}")
        if key in swept or key in fixed:
            raise SceneError(f"--set {text}: key '{key}' is given twice; give each key once")
        span = _values(key, values, drawn) if values else None
        if isinstance(span, list | Range):
            swept[key] = span
        else:
            fixed[key] = span
    if table is not None:
        if swept:
            raise SceneError(
                f"--set {next(iter(swept))} has several values, but --list already gives the points; "
                "give one of the two"
            )
        return _read_table(table, fixed), fixed
    if random_points is not None:
        return random(swept, random_points, seed), fixed
    if sobol_points is not None:
        return sobol(swept, sobol_points, seed), fixed
    if not swept:
        raise SceneError(f"the sweep has no values; give --set with several values: {FORMS}")
    return grid({key: span for key, span in swept.items() if not isinstance(span, Range)}), fixed


def _values(key: str, text: str, drawn: bool) -> list[Value] | Range | Value:
    """Parse a text: several values, a range for random values, or one value."""
    parts = text.split(":")
    logarithmic = len(parts) > 2 and parts[-1] == "log"
    numbers = parts[:-1] if logarithmic else parts
    if len(numbers) > 1:
        return _range(key, text, numbers, logarithmic, drawn)
    if "," in text:
        words = [word.strip() for word in text.split(",")]
        if not all(words):
            raise SceneError(f"--set {key}={text} has an empty value between commas; write {FORMS}")
        return [_number(word) for word in words]
    return _number(text)


def _range(key: str, text: str, parts: list[str], logarithmic: bool, drawn: bool) -> list[Value] | Range:
    forms = DRAWN_FORMS if drawn else FORMS
    if len(parts) != (2 if drawn else 3):
        raise SceneError(f"--set {key}={text} is not a range; write {forms}")
    try:
        low, high = float(parts[0]), float(parts[1])
        count = 2 if drawn else int(parts[2])
    except ValueError:
        raise SceneError(f"--set {key}={text} is not a range of numbers; write {forms}") from None
    if count < 1:
        raise SceneError(f"--set {key}={text} is empty: it has {count} values; allowed: at least 1")
    if count == 1 and low == high:
        return [low]
    span = Range(low, high, logarithmic)
    check_range(key, span)
    if drawn:
        return span
    values = np.geomspace(low, high, count) if logarithmic else np.linspace(low, high, count)
    # Rounded, because 0.1 + 0.2 would be labelled 0.30000000000000004
    return [float(f"{value:.12g}") for value in values]


def _number(word: str) -> Value:
    """Parse a number, or numbers separated by spaces as a vector. Other text is returned unchanged."""
    try:
        parts = tuple(float(part) for part in word.split())
    except ValueError:
        return word
    return parts[0] if len(parts) == 1 else parts


def _read_table(path: Path, fixed: dict[str, Value | None]) -> Design:
    """Read the points of a CSV file. Raises SceneError if it cannot be read or is not a table."""
    try:
        with regular(path).open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file, skipinitialspace=True) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SceneError(f"--list {path} cannot be read: {reason_of(error)}") from None
    if len(rows) < 2:
        raise SceneError(f"--list {path} has {len(rows)} lines; allowed: a line of keys, then a line for each point")
    head = [cell.strip() for cell in rows[0]]
    twice = next((key for key, count in Counter(head).items() if count > 1 or key in fixed), None)
    if twice is not None:
        raise SceneError(f"--list {path}: key '{twice}' is given twice; give each key once")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(head) or not all(cell.strip() for cell in row):
            filled = sum(1 for cell in row if cell.strip())
            raise SceneError(
                f"--list {path}: line {number} has {filled} values for {len(head)} keys; give each a value"
            )
    columns = zip(*rows[1:], strict=True)
    with naming(f"--list {path}"):
        return listed({key: [_number(cell.strip()) for cell in one] for key, one in zip(head, columns, strict=True)})
