"""Settings of an instrument: keys with limits, set in Python or in a table of a TOML file."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from palmfield.config.base import allowed
from palmfield.errors import MeasurementError, did_you_mean, naming
from palmfield.files import read_toml, reading

Vector3 = Annotated[tuple[float, float, float], Field()]


class Settings(BaseModel):
    """Base of the settings of instruments. Unknown keys and values outside the limits raise MeasurementError.

    instrument: name in messages, and name of the table in a TOML file
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    instrument: ClassVar[str]

    def __init__(self, **values: Any):
        try:
            super().__init__(**values)
        except ValidationError as error:
            messages = dict.fromkeys(_explained(type(self), values, one) for one in error.errors())
            raise MeasurementError(f"{self.instrument}: " + "; ".join(messages)) from None


Model = TypeVar("Model", bound=Settings)


def _explained(model: type[Settings], values: dict[str, Any], error: Any) -> str:
    if not error["loc"]:
        return str(error["msg"]).removeprefix("Value error, ")
    key = str(error["loc"][0])
    if key not in model.model_fields:
        near = did_you_mean(key, model.model_fields)
        return f"unknown key '{key}'{near}; allowed: {', '.join(model.model_fields)}"
    limits = allowed(model, key)
    if key not in values:
        return f"key '{key}' is missing; give {limits}"
    near = did_you_mean(str(values[key]), limits.split(" | ")) if " | " in limits else ""
    return f"key '{key}' has value {values[key]!r}{near}; allowed: {limits}"


def read_settings(path: str | Path, model: type[Model]) -> Model:
    """Read settings from the table of a TOML file with the name of the instrument.

    Raises MeasurementError for a file that cannot be read as TOML, lacks the table or has others, or has invalid keys.
    """
    file = Path(path)
    with reading(file, MeasurementError, "a TOML file in UTF-8"):
        table = read_toml(file)
    name = model.instrument
    for other in table:
        if other != name:
            raise MeasurementError(f"{file}: has [{other}]{did_you_mean(other, [name])}; allowed: [{name}]")
    if not isinstance(table.get(name), dict):
        raise MeasurementError(f"{file}: has no table [{name}]; begin with it, and put keys below")
    with naming(f"{file}"):
        return model(**table[name])
