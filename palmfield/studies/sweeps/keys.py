"""Assign the keys of a sweep to instances of one scene, and check their values."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from pydantic import ValidationError

from palmfield.config import CONFIGS, FILE_KEYS, allowed
from palmfield.errors import SceneError
from palmfield.session.open_scene import as_text, instances_of
from palmfield.session.scene_text import Instance
from palmfield.session.worlds import BOUND
from palmfield.studies.sweeps.design import Design, Value

COMPONENT = re.compile(r"(?P<key>.+)\[(?P<place>\d+)\]")
STIMULUS = "palmfield.stimulus"
_CONFIGS = {config.plugin: config for config in CONFIGS}


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
