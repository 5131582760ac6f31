"""Base of the keys of all modules: the model, the types of values, and the error messages for invalid values."""

import json
import re
from functools import lru_cache
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from palmfield.errors import PalmfieldError, SceneError, did_you_mean, naming


def split(value: Any) -> Any:
    """Split a text into words; return any other value unchanged."""
    return value.split() if isinstance(value, str) else value


Numbers = Annotated[tuple[Annotated[int, Field(ge=0)], ...], BeforeValidator(split)]
Names = Annotated[tuple[str, ...], BeforeValidator(split)]
Amounts = Annotated[tuple[Annotated[float, Field(ge=0)], ...], BeforeValidator(split)]
Shares = Annotated[tuple[Annotated[float, Field(gt=0)], ...], BeforeValidator(split)]
Decimals = Annotated[tuple[float, ...], BeforeValidator(split)]
Vector = Annotated[tuple[float, float, float], BeforeValidator(split)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]


JOINED, NUMBER = re.compile(r"\d_\d"), re.compile(r"number|decimals")


class Config(BaseModel):
    """Keys of one plugin instance. The keys arrive as text from MJCF; a value that does not fit raises SceneError.

    plugin: name of the plugin; about: one sentence that describes its keys
    files: names of the keys whose values are file names
    renamed: old name -> new name, of a key (`device`: "board") or of a value of a key (`solver=full`: "wedges"). An old
        name is kept for one version, so that the error message can give the new name
    refused: values that other programs accept but scenes do not (`solver=axisymmetric`) -> reason and advice
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    plugin: ClassVar[str]
    about: ClassVar[str]
    files: ClassVar[tuple[str, ...]] = ()
    renamed: ClassVar[dict[str, str]] = {}
    refused: ClassVar[dict[str, str]] = {}

    @classmethod
    def element(cls, name: str) -> str:
        """Return the name of an instance in messages."""
        return f"plugin '{cls.plugin}' instance '{name}'"


class naming_keys(naming):
    """Add the scene element and the key to each palmfield error that is raised in the block.

    element: name of the element in messages; setting: name of the refused key, used if the error does not name one
    config: keys of the element; the message quotes the refused value
    """

    def __init__(self, element: str, config: Config | None = None, setting: str = ""):
        super().__init__(element)
        self.config, self.setting = config, setting

    def __exit__(self, kind: object, error: BaseException | None, at: object) -> None:
        if isinstance(error, PalmfieldError) and error.about[:1] != self.about:
            if key := error.setting or self.setting:
                value = getattr(self.config, key, None)
                words = f"{value:g}" if isinstance(value, float) else f"'{value}'"
                error.about = (f"key '{key}'" + ("" if value is None else f" has value {words}"), *error.about)
            if error.mends:
                keys = "key" if len(error.mends) == 1 else "keys"
                error.args = (f"{error.args[0]} (to change: {keys} {', '.join(error.mends)})",)
            error.setting, error.mends = "", ()
        super().__exit__(kind, error, at)


T = TypeVar("T", bound=Config)


def known_keys(model: type[Config]) -> list[str]:
    """Return all keys that MuJoCo must accept in a scene: the present keys and the renamed ones."""
    removed = [name for name in model.renamed if "=" not in name and name not in model.model_fields]
    return [*model.model_fields, *removed]


def parse(model: type[Config], values: dict[str, str], element: str) -> Config:
    """Return the typed configuration of a plugin instance.

    values: key -> text, only the keys that the scene sets
    element: name of the instance in messages, e.g. `plugin 'palmfield.skin' instance 'skin'`
    Raises SceneError with element, key, value and the allowed values or advice.
    """
    advice = [text for key, value in values.items() for text in _advice(model, key, value)]
    advice += [text for key, value in values.items() for text in _joined(model, key, value)]
    if advice:
        raise SceneError(f"{element}: " + "; ".join(advice))
    try:
        return _validated(model, tuple(values.items()))
    except ValidationError as error:
        messages = dict.fromkeys(_explain(model, values, e) for e in error.errors())
        raise SceneError(f"{element}: " + "; ".join(messages)) from None


def recorded(model: type[T], text: str) -> T:
    """Read a configuration that `model_dump_json` wrote, for example into a result.

    Values equal to a default are omitted before validation, since some keys exclude each other. Raises SceneError.
    """
    try:
        stored = json.loads(text)
        # Through JSON, so that tuples become lists as in `stored`
        defaults = json.loads(model.model_construct().model_dump_json())
        changed = {key: value for key, value in stored.items() if value != defaults.get(key)}
        # Validated as JSON, in which bytes of tables are text
        return model.model_validate_json(json.dumps(changed))
    except (ValueError, AttributeError) as error:
        raise SceneError(
            f"the stored keys of plugin '{model.plugin}' cannot be read: {error}; run the scene again"
        ) from None


@lru_cache(maxsize=256)
def _validated(model: type[Config], values: tuple[tuple[str, str], ...]) -> Config:
    """Return the configuration for these texts. Equal texts return the same object, which other caches use as a key."""
    return model.model_validate(dict(values))


def _advice(model: type[Config], key: str, value: str) -> list[str]:
    """Return the advice on a key or value that is renamed or refused; empty for others."""
    if key in model.renamed:
        use = model.renamed[key]
        now = model.renamed.get(f"{use}={value}")
        return [f"key '{key}' is renamed: use {use}" + (f" with value '{now}'" if now is not None else "")]
    both = f"{key}={value}"
    if both in model.renamed:
        return [f"key '{key}' has value '{value}', which is renamed: use {model.renamed[both]}"]
    return [f"key '{key}' has value '{value}', {model.refused[both]}"] if both in model.refused else []


def _joined(model: type[Config], key: str, value: str) -> list[str]:
    """Return the error message for a number with an underscore between digits, which Python would accept."""
    if key not in model.model_fields or not JOINED.search(value):
        return []
    limits = allowed(model, key)
    return [f"key '{key}' has value '{value}'; allowed: {limits}"] if NUMBER.search(limits) else []


def _explain(model: type[Config], values: dict[str, str], error: Any) -> str:
    if not error["loc"]:
        return error["msg"].removeprefix("Value error, ")
    key = str(error["loc"][0])
    if key not in model.model_fields:
        return unknown_key(model, key)
    limits = allowed(model, key)
    near = did_you_mean(values[key], limits.split(" | ")) if " | " in limits else ""
    commas = "," in values[key] and isinstance(model.model_fields[key].default, tuple)
    advice = f"; write '{' '.join(values[key].replace(',', ' ').split())}', with spaces in place of commas"
    return f"key '{key}' has value '{values[key]}'{near}; allowed: {limits}" + (advice if commas else "")


def unknown_key(model: type[Config], key: str) -> str:
    """Return the error message for a key that a module does not have."""
    near = did_you_mean(key, model.model_fields)
    keys = ", ".join(model.model_fields)
    listed = f"the keys that `palmfield keys {model.plugin.removeprefix('palmfield.')}` lists" if near else keys
    return f"unknown key '{key}'{near}; allowed: {listed}"


def allowed(model: type[BaseModel], key: str) -> str:
    """Return the allowed values of a key, in words, e.g. `number > 0` or `bonded | free_slip`."""
    schema = _properties(model)[key]
    options = [o for o in schema.get("anyOf", [schema]) if o.get("type") != "null"]
    option = options[0]
    if "enum" in option:
        return " | ".join(option["enum"])
    if option.get("type") == "array":
        item = option.get("items", {})
        signs = {"exclusiveMinimum": "decimals > 0", "minimum": "finite numbers >= 0"}
        positive = next((words for name, words in signs.items() if name in item), "finite numbers")
        kinds = {"integer": "whole numbers >= 0", "number": positive, "string": "names"}
        return "three finite numbers" if option.get("maxItems") == 3 else kinds[item["type"]]
    if option.get("type") == "string":
        return f"text like {option['pattern']}" if "pattern" in option else "text"
    if option.get("type") == "boolean":
        return "true | false"
    words = "whole number" if option.get("type") == "integer" else "finite number"
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    bounds = [f"{sign} {option[name]:g}" for name, sign in signs.items() if name in option]
    return " ".join([words, " and ".join(bounds)]).strip()


@lru_cache(maxsize=32)
def _properties(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON schema of each key; computed once for a whole model."""
    properties: dict[str, Any] = model.model_json_schema()["properties"]
    return properties


def unit(key: str) -> str:
    """Return the unit in the name of a key, e.g. `Pa/m` for `foundation_normal_Pa_m`; empty if it has none."""
    units = {
        "_per_cm2": "1/cm2",
        "_kg_m3": "kg/m^3", "normal_Pa_m": "Pa/m", "tangential_Pa_m": "Pa/m", "_Pa_s_m": "Pa s/m", "_Pa_m": "Pa m",
        "_Pa": "Pa", "_m_s": "m/s", "_m": "m",
        "_s": "s", "_Hz": "Hz", "_C": "C", "_percent": "%", "_deg": "deg", "_ppm": "ppm", "_dB": "dB",
    }  # fmt: skip
    return next((text for ending, text in units.items() if key.endswith(ending)), "")


def table(model: type[Config]) -> list[tuple[str, str, str, str, str]]:
    """Return rows (key, unit, allowed, default, meaning) of the keys of a module."""
    rows = []
    for key, info in model.model_fields.items():
        default = info.default
        if isinstance(default, tuple):
            default = " ".join(f"{x:g}" for x in default)
        text = "" if default is None else str(default)
        rows.append((key, unit(key), allowed(model, key), text, info.description or ""))
    return rows


def renamed_table(model: type[Config]) -> list[tuple[str, str]]:
    """Return rows (old key or old key and value, new name) of the renamed keys of a module."""
    return [(name.replace("=", " "), use) for name, use in model.renamed.items()]
