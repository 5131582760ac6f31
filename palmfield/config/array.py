"""Keys of palmfield.array."""

from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from palmfield.config.base import Config, Numbers, Positive

Layout = Literal[
    "uhev1", "sonicsurface", "autd2018", "autd2018_2x2", "autd3", "autd3_2x2", "autd3_3x2", "autd3_4x2",
    "two_bow_as_printed", "two_bow_corrected", "stratos_explore", "openmpd", "openmpd_rows", "ultraino", "sites", "csv",
]  # fmt: skip
AIR_LIMITS = {"temperature_C": (-20.0, 50.0), "humidity_percent": (0.0, 100.0), "pressure_Pa": (10e3, 200e3)}
"""Limits of the air that ISO 9613-1 covers. The lowest pressure is the pressure at an altitude of about 16 km."""
DIRECTIVITIES_FOLDER = Path(__file__).parents[1] / "acoustics" / "directivities"
if TYPE_CHECKING:
    DirectivityName = str
else:
    # Each file in this folder is one form. The folder is listed because config may not import acoustics
    DirectivityName = Literal[("layout", *sorted(module.name for module in iter_modules([str(DIRECTIVITIES_FOLDER)])))]


def _air(name: str) -> Any:
    low, high = AIR_LIMITS[name]
    return Field(ge=low, le=high)


class ArrayConfig(Config):
    plugin: ClassVar[str] = "palmfield.array"
    about: ClassVar[str] = "A transducer array and the air around it. The array frame is the frame of a site."
    files: ClassVar[tuple[str, ...]] = ("calibration", "transducers")
    renamed: ClassVar[dict[str, str]] = {"compute": "the scene's palmfield_device text"}

    layout: Layout = Field("uhev1", description="layout of the transducers (docs/arrays.md), or `sites`, or `csv`")
    sites: str | None = Field(
        None, description="layout sites: each site whose name begins with this text is a transducer that emits along z"
    )
    transducers: str | None = Field(None, description="layout csv: CSV file of transducer positions (docs/arrays.md)")
    site: str = Field("array", description="site whose frame is the array frame: z points out of the emitting face")
    calibration: str | None = Field(
        None, description="JSON file with the calibration of this array (docs/calibration.md)"
    )
    p0_Pa_m: Positive | None = Field(
        None, description="peak pressure of one transducer at 1 m at full drive (default: that of the layout)"
    )
    p0_low_Pa_m: Positive | None = Field(None, description="lower end of the range of key p0_Pa_m")
    p0_high_Pa_m: Positive | None = Field(None, description="upper end of the range of key p0_Pa_m")
    directivity: DirectivityName = Field(
        "layout",
        description="directivity of the transducers: that of the layout, or a named form (docs/concepts/array.md)",
    )
    piston_radius_m: Annotated[float, Field(gt=0, le=0.0061)] | None = Field(
        None, description="radius of the baffled piston (default: that of the layout)"
    )
    dead: Numbers = Field(
        (), description="dead transducers, which emit no sound; numbers from 0 in the order of the layout"
    )
    inverted: Numbers = Field((), description="transducers with reversed polarity")
    resonance_Hz: Annotated[float, Field(ge=20e3, le=80e3)] = Field(
        40e3, description="resonance frequency of the transducers"
    )
    quality: Annotated[float, Field(ge=1, le=1000)] | None = Field(
        None, description="quality factor of that resonance (default: that of the layout, 25)"
    )
    response: Literal["auto", "on", "off"] = Field(
        "auto", description="ring-up and flight time of the sound; auto: on if the error without them is too large"
    )
    array_face: Literal["absorbing", "rigid"] = Field(
        "absorbing",
        description="face of the array: absorbs the echo of a flat disc, or reflects echoes until they have decayed",
    )
    precision: Literal["fast", "accurate"] = Field(
        "fast",
        description="precision of the field: float32 throughout, or float64 for distances and phases at half the speed",
    )
    temperature_C: Annotated[float, _air("temperature_C")] = Field(20.0, description="air temperature")
    humidity_percent: Annotated[float, _air("humidity_percent")] = Field(50.0, description="relative humidity")
    pressure_Pa: Annotated[float, _air("pressure_Pa")] = Field(101325.0, description="static air pressure")

    @model_validator(mode="after")
    def _range(self) -> Self:
        low, high = self.p0_low_Pa_m, self.p0_high_Pa_m
        if (low is None) != (high is None):
            raise ValueError("p0_low_Pa_m and p0_high_Pa_m must be given together; give both or neither")
        if low is not None and high is not None:
            if self.p0_Pa_m is None:
                raise ValueError(
                    "p0_low_Pa_m and p0_high_Pa_m are the range of key p0_Pa_m, which is missing; give it as well"
                )
            if not low <= self.p0_Pa_m <= high:
                raise ValueError("p0_Pa_m is outside its range; required: p0_low_Pa_m <= p0_Pa_m <= p0_high_Pa_m")
        if (self.layout == "csv") != (self.transducers is not None):
            raise ValueError("layout 'csv' and key transducers need each other; give both or neither")
        if (self.layout == "sites") != (self.sites is not None):
            raise ValueError("layout 'sites' and key sites need each other; give both or neither")
        return self
