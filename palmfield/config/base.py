"""What the keys of all modules share: their model, their types, and how a bad value is told."""

import json
import re
from functools import lru_cache
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from palmfield.errors import PalmfieldError, SceneError, did_you_mean, naming


def split(value: Any) -> Any:
    """A text's words; any other value as it is."""
    return value.split() if isinstance(value, str) else value


Numbers = Annotated[tuple[Annotated[int, Field(ge=0)], ...], BeforeValidator(split)]
Names = Annotated[tuple[str, ...], BeforeValidator(split)]
Shares = Annotated[tuple[Annotated[float, Field(gt=0)], ...], BeforeValidator(split)]
Decimals = Annotated[tuple[float, ...], BeforeValidator(split)]
Vector = Annotated[tuple[float, float, float], BeforeValidator(split)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]


JOINED, NUMBER = re.compile(r"\d_\d"), re.compile(r"number|decimals")


class Config(BaseModel):
    """Keys of one plugin instance. Values arrive as MJCF text; a value that does not fit is a SceneError.

    plugin: name of the plugin; about: what its keys say, in a sentence; files: keys that name files
    renamed: what has another name since the last version -> what to use: a key (`device`: "board"), or a value of a
        key (`solver=full`: "wedges"). They stay known for one version so that a scene that has them is told what to do
    refused: values that make sense elsewhere but not in a scene (`solver=axisymmetric`) -> why, and what to do
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    plugin: ClassVar[str]
    about: ClassVar[str]
    files: ClassVar[tuple[str, ...]] = ()
    renamed: ClassVar[dict[str, str]] = {}
    refused: ClassVar[dict[str, str]] = {}

    @classmethod
    def element(cls, name: str) -> str:
        """Name of an instance in messages."""
        return f"plugin '{cls.plugin}' instance '{name}'"


class naming_keys(naming):
    """An error of palmfield's that leaves the block names the element of a scene, and the keys of its settings.

    element: name of the element in messages. config: its keys, whose value of the refused setting is named.
    setting: the refused setting of errors that name none.
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
    """All keys that a scene may hold without MuJoCo refusing it: those that there are, and renamed ones."""
    gone = [name for name in model.renamed if "=" not in name and name not in model.model_fields]
    return [*model.model_fields, *gone]


def parse(model: type[Config], values: dict[str, str], element: str) -> Config:
    """Typed configuration from a plugin instance's texts.

    values: key -> text, only the keys that the scene sets
    element: how the message names the instance, e.g. `plugin 'palmfield.skin' instance 'skin'`
    Raises SceneError with element, key, value and what is allowed, or what to do instead.
    """
    advice = [text for key, value in values.items() for text in _advice(model, key, value)]
    advice += [text for key, value in values.items() for text in _joined(model, key, value)]
    if advice:
        raise SceneError(f"{element}: " + "; ".join(advice))
    try:
        return _validated(model, tuple(values.items()))
    except ValidationError as error:
        told = dict.fromkeys(_explain(model, values, e) for e in error.errors())
        raise SceneError(f"{element}: " + "; ".join(told)) from None


def recorded(model: type[T], text: str) -> T:
    """The configuration that `model_dump_json` has written, for example into a result.

    Values that are those of a key that isn't given are left out, as some keys may not be given beside others.
    Raises SceneError for what isn't such a text.
    """
    try:
        held = json.loads(text)
        # As JSON has them: tuples are lists there
        usual = json.loads(model.model_construct().model_dump_json())
        given = {key: value for key, value in held.items() if value != usual.get(key)}
        # As JSON again, in which bytes of tables are text
        return model.model_validate_json(json.dumps(given))
    except (ValueError, AttributeError) as error:
        raise SceneError(
            f"the stored keys of plugin '{model.plugin}' cannot be read: {error}; run the scene again"
        ) from None


@lru_cache(maxsize=256)
def _validated(model: type[Config], values: tuple[tuple[str, str], ...]) -> Config:
    """The configuration of these texts: the same object for the same texts, as what is kept for it asks it often."""
    return model.model_validate(dict(values))


def _advice(model: type[Config], key: str, value: str) -> list[str]:
    """What to use in place of a key or a value that is renamed or refused; nothing for others."""
    if key in model.renamed:
        use = model.renamed[key]
        now = model.renamed.get(f"{use}={value}")
        return [f"key '{key}' is renamed: use {use}" + (f" with value '{now}'" if now is not None else "")]
    both = f"{key}={value}"
    if both in model.renamed:
        return [f"key '{key}' has value '{value}', which is renamed: use {model.renamed[both]}"]
    return [f"key '{key}' has value '{value}', {model.refused[both]}"] if both in model.refused else []


def _joined(model: type[Config], key: str, value: str) -> list[str]:
    """Digits joined by an underscore are a number to Python, and a slip in a scene."""
    if key not in model.model_fields or not JOINED.search(value):
        return []
    takes = allowed(model, key)
    return [f"key '{key}' has value '{value}'; allowed: {takes}"] if NUMBER.search(takes) else []


def _explain(model: type[Config], values: dict[str, str], error: Any) -> str:
    if not error["loc"]:
        return error["msg"].removeprefix("Value error, ")
    key = str(error["loc"][0])
    if key not in model.model_fields:
        return unknown_key(model, key)
    takes = allowed(model, key)
    near = did_you_mean(values[key], takes.split(" | ")) if " | " in takes else ""
    commas = "," in values[key] and isinstance(model.model_fields[key].default, tuple)
    mend = f"; write '{' '.join(values[key].replace(',', ' ').split())}', with spaces in place of commas"
    return f"key '{key}' has value '{values[key]}'{near}; allowed: {takes}" + (mend if commas else "")


def unknown_key(model: type[Config], key: str) -> str:
    """What to say of a key that a module doesn't have."""
    near = did_you_mean(key, model.model_fields)
    # A list of thirty keys hides the one that was meant
    known = ", ".join(model.model_fields)
    listed = f"the keys that `palmfield keys {model.plugin.removeprefix('palmfield.')}` lists" if near else known
    return f"unknown key '{key}'{near}; allowed: {listed}"


def allowed(model: type[BaseModel], key: str) -> str:
    """What a key takes, in words, e.g. `number > 0` or `bonded | free_slip`."""
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
    """The JSON schema of each key; of a whole model, so that it is made once for all its keys."""
    properties: dict[str, Any] = model.model_json_schema()["properties"]
    return properties


def unit(key: str) -> str:
    """Unit that a key's name carries, e.g. `Pa/m` for `foundation_normal_Pa_m`; empty for a pure number or text."""
    units = {
        "_kg_m3": "kg/m^3", "normal_Pa_m": "Pa/m", "tangential_Pa_m": "Pa/m", "_Pa_s_m": "Pa s/m", "_Pa_m": "Pa m",
        "_Pa": "Pa", "_m_s": "m/s", "_m": "m",
        "_s": "s", "_Hz": "Hz", "_C": "C", "_percent": "%", "_deg": "deg", "_ppm": "ppm", "_dB": "dB",
    }  # fmt: skip
    return next((text for ending, text in units.items() if key.endswith(ending)), "")


def table(model: type[Config]) -> list[tuple[str, str, str, str, str]]:
    """Rows (key, unit, allowed, default, meaning) of a module's keys."""
    rows = []
    for key, info in model.model_fields.items():
        default = info.default
        if isinstance(default, tuple):
            default = " ".join(f"{x:g}" for x in default)
        text = "" if default is None else str(default)
        rows.append((key, unit(key), allowed(model, key), text, info.description or ""))
    return rows


def renamed_table(model: type[Config]) -> list[tuple[str, str]]:
    """Rows (key, or key and value, of the last version; what to use) of what is renamed."""
    return [(name.replace("=", " "), use) for name, use in model.renamed.items()]
