"""Typed configuration of the four modules. These models are the one source of the scene's keys, units and defaults."""

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from palmfield.acoustics.air import LIMITS
from palmfield.errors import SceneError


def _split(value: Any) -> Any:
    return value.split() if isinstance(value, str) else value


Layout = Literal[
    "uhev1", "sonicsurface", "autd2018", "autd2018_2x2", "autd3", "autd3_2x2", "two_bow_as_printed",
    "two_bow_corrected", "sites",
]  # fmt: skip
Numbers = Annotated[tuple[Annotated[int, Field(ge=0)], ...], BeforeValidator(_split)]
Names = Annotated[tuple[str, ...], BeforeValidator(_split)]
Shares = Annotated[tuple[Annotated[float, Field(gt=0)], ...], BeforeValidator(_split)]


Vector = Annotated[tuple[float, float, float], BeforeValidator(_split)]
Positive = Annotated[float, Field(gt=0)]
Length = Annotated[float, Field(ge=5e-4, le=1.0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
ArpLaw = Literal["default", "alpha"]
Base = Literal["bonded", "free_slip", "free", "springs"]
Side = Literal["fixed", "free", "roller", "absorbing"]
SPRINGS = ("base_normal_Pa_m", "base_tangential_Pa_m", "base_normal_Pa_s_m", "base_tangential_Pa_s_m")
OVERRIDES = ("density_kg_m3", "shear_relaxed_Pa", "shear_branch_Pa", "relaxation_time_s", "bulk_Pa")


def _air(name: str) -> Any:
    low, high = LIMITS[name]
    return Field(ge=low, le=high)


class Config(BaseModel):
    """Keys of one plugin instance. Values arrive as MJCF text; a value that does not fit is a SceneError."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    plugin: ClassVar[str]
    about: ClassVar[str]


class ArrayConfig(Config):
    plugin: ClassVar[str] = "palmfield.array"
    about: ClassVar[str] = "A transducer array and the air around it. Its frame is that of a site."

    layout: Layout = Field("uhev1", description="arrangement of the transducers (docs/arrays.md), or `sites`")
    sites: str | None = Field(
        None, description="layout sites: each site whose name begins with this is a transducer, emitting along its z"
    )
    site: str = Field("array", description="site whose frame is the array frame: z points out of the emitting face")
    p0_Pa_m: Positive = Field(
        2.53, description="peak pressure of one transducer at 1 m at full drive; a calibration (published: 1.27-8.02)"
    )
    p0_low_Pa_m: Positive | None = Field(None, description="lower end of p0, for an uncertainty band")
    p0_high_Pa_m: Positive | None = Field(None, description="upper end of p0, for an uncertainty band")
    directivity: Literal["layout", "point", "piston", "t4010a1"] = Field(
        "layout", description="sound off a transducer's axis: the layout's own, none, a baffled piston, or as measured"
    )
    piston_radius_m: Annotated[float, Field(gt=0, le=0.0061)] | None = Field(
        None, description="radius of the baffled piston (default: the layout's)"
    )
    dead: Numbers = Field((), description="transducers that emit nothing, counted from 0 in the layout's order")
    inverted: Numbers = Field((), description="transducers wired the other way round")
    resonance_Hz: Annotated[float, Field(ge=20e3, le=80e3)] = Field(40e3, description="resonance of the transducers")
    quality: Annotated[float, Field(ge=1, le=1000)] = Field(25.0, description="quality of that resonance")
    response: Literal["auto", "on", "off"] = Field(
        "auto", description="ring-up and flight time of the sound; auto drops them where their bound allows"
    )
    precision: Literal["fast", "accurate"] = Field(
        "fast", description="field: float32 throughout, or distances and phases in float64 at half the speed"
    )
    temperature_C: Annotated[float, _air("temperature_C")] = Field(20.0, description="air temperature")
    humidity_percent: Annotated[float, _air("humidity_percent")] = Field(50.0, description="relative humidity")
    pressure_Pa: Annotated[float, _air("pressure_Pa")] = Field(101325.0, description="static air pressure")
    compute: Annotated[str, Field(pattern=r"^(auto|cpu|cuda:\d+)$")] = Field(
        "auto", description="where the field kernels run: auto, cpu or cuda:N"
    )

    @model_validator(mode="after")
    def _range(self) -> Self:
        if (self.p0_low_Pa_m is None) != (self.p0_high_Pa_m is None):
            raise ValueError("p0_low_Pa_m and p0_high_Pa_m belong together; give both or neither")
        if self.p0_low_Pa_m is not None and not self.p0_low_Pa_m <= self.p0_Pa_m <= (self.p0_high_Pa_m or 0):
            raise ValueError("p0_low_Pa_m <= p0_Pa_m <= p0_high_Pa_m is needed")
        if (self.layout == "sites") != (self.sites is not None):
            raise ValueError("layout 'sites' needs sites, and sites needs layout 'sites'")
        return self


class StimulusConfig(Config):
    plugin: ClassVar[str] = "palmfield.stimulus"
    about: ClassVar[str] = "Where the focus is and how strong, over time."

    focus_m: Vector = Field((0.0, 0.0, 0.2), description="focus, or centre of its path, in `frame`")
    frame: str = Field("array", description="`array`, or the name of a site in whose frame focus and path are given")
    path: Literal["point", "circle"] = Field("point", description="path of the focus, in the frame's x-y plane")
    path_diameter_m: Positive | None = Field(None, description="diameter of the circle")
    path_rate_Hz: Positive | None = Field(None, description="turns a second")
    path_points: Annotated[int, Field(ge=0, le=100000)] = Field(
        0, description="points a turn, each held until the next; 0 moves without steps"
    )
    modulation: Literal["none", "am"] = Field("none", description="none, or sinusoidal amplitude modulation")
    am_of: Literal["pressure", "arp"] | None = Field(
        None, description="what the sine modulates: the sound pressure, or the radiation pressure (ARP)"
    )
    am_frequency_Hz: Annotated[float, Field(gt=0, le=2000)] | None = Field(None, description="modulation frequency")
    am_depth: Fraction | None = Field(None, description="modulation depth m: (1 + m sin wt)/(1 + m)")
    arp_peak_Pa: Positive | None = Field(
        None, description="sets the level: |p|^2/(rho c^2) at the focus at the loudest moment; excludes drive_amplitude"
    )
    drive_amplitude: Fraction | None = Field(
        None, description="sets the level: pressure amplitude of each transducer relative to full drive (default 1)"
    )
    start_s: NonNegative = Field(0.0, description="the sound starts at this time")
    stop_s: Positive | None = Field(None, description="the sound stops at this time (default: never)")
    ramp_s: NonNegative = Field(0.0, description="raised-cosine ramp of the ARP after start_s")
    control_rate_Hz: Annotated[float, Field(ge=0, le=40e3)] = Field(
        0.0, description="rate at which the device gets new frames, held in between; 0 follows the skin's steps"
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.modulation == "am":
            missing = [k for k in ("am_of", "am_frequency_Hz", "am_depth") if getattr(self, k) is None]
            if missing:
                raise ValueError(f"modulation 'am' needs {', '.join(missing)}")
        if self.path == "circle" and (self.path_diameter_m is None or self.path_rate_Hz is None):
            raise ValueError("path 'circle' needs path_diameter_m and path_rate_Hz")
        if self.arp_peak_Pa is not None and self.drive_amplitude is not None:
            raise ValueError("arp_peak_Pa and drive_amplitude both set the level; give one")
        if self.stop_s is not None and self.stop_s <= self.start_s:
            raise ValueError(f"stop_s {self.stop_s} must be later than start_s {self.start_s}")
        return self


class SkinConfig(Config):
    plugin: ClassVar[str] = "palmfield.skin"
    about: ClassVar[str] = "The surface that the sound meets and the viscoelastic skin layer on part of it."

    body: str = Field("hand", description="body that carries the surface; its frame is the surface's frame")
    shape: Literal["hand", "disc", "mesh"] = Field("hand", description="parametric hand, flat disc, or a mesh file")
    hand: str = Field("open_men_p50", description="shape hand: a preset in hand_models/ or the path of a .toml file")
    mesh: str | None = Field(None, description="shape mesh: .obj, .ply or .stl file, relative to the scene")
    mesh_unit: Literal["m", "cm", "mm", "in"] | None = Field(None, description="shape mesh: unit of the file")
    radius_m: Length | None = Field(None, description="shape disc: radius; the loaded face is z = 0, looking along +z")
    thickness_m: Length | None = Field(None, description="shape disc: thickness")
    patch_site: str | None = Field(
        None, description="site on the body at the middle of the skin layer (shapes hand and mesh)"
    )
    patch_radius_m: Positive | None = Field(None, description="radius of the skin layer (default: the plan's)")
    depth_m: Positive = Field(
        0.02, description="greatest depth of the layer; a hand's own depth to bone applies where it is less"
    )
    material: str = Field("palm", description="a preset of palmfield.skin.material")
    materials: Names = Field(
        (), description="presets of several sheets from the surface down, in place of `material`; needs `shares`"
    )
    shares: Shares = Field((), description="thickness of each sheet as a share of the layer; they add up to 1")
    density_kg_m3: Positive | None = Field(None, description="overrides the preset")
    shear_relaxed_Pa: Positive | None = Field(None, description="overrides the preset: long-time shear modulus")
    shear_branch_Pa: NonNegative | None = Field(None, description="overrides the preset: modulus of the Maxwell branch")
    relaxation_time_s: Positive | None = Field(None, description="overrides the preset: time of the Maxwell branch")
    bulk_Pa: Positive | None = Field(None, description="overrides the preset: bulk modulus")
    base: Base = Field("bonded", description="inner face of the layer; springs needs base_normal and base_tangential")
    base_normal_Pa_m: Positive | None = Field(None, description="base springs: stiffness per area along the normal")
    base_tangential_Pa_m: Positive | None = Field(None, description="base springs: stiffness per area along the base")
    base_normal_Pa_s_m: NonNegative | None = Field(None, description="base springs: damping per area along the normal")
    base_tangential_Pa_s_m: NonNegative | None = Field(
        None, description="base springs: damping per area along the base"
    )
    foundation_normal_Pa_m: Positive | None = Field(
        None, description="stiffness per area of what lies below the layer, in place of a bonded base"
    )
    foundation_tangential_Pa_m: Positive | None = Field(
        None, description="the same along the base, relaxing as the deepest material"
    )
    side: Side = Field("fixed", description="cut faces of the layer; absorbing lets waves out; a disc takes roller too")
    arp_law: ArpLaw = Field("default", description="radiation-pressure law (see `palmfield info`)")
    body_sound: Literal["none", "shadows", "scattering"] = Field(
        "none", description="what other parts of the body do to the sound: nothing, shadows by rays, boundary elements"
    )
    accuracy: Annotated[float, Field(ge=0.002, le=0.5)] = Field(
        0.05, description="wanted relative error of the skin displacement"
    )
    max_frequency_Hz: Annotated[float, Field(gt=0, le=2000)] | None = Field(
        None, description="highest frequency to resolve (default: from the stimulus)"
    )
    solver: Literal["auto", "full", "reduced"] = Field(
        "auto",
        description="steps the whole layer, or a small model made for the stimulus; auto takes the cheaper that can",
    )
    element_m: Positive | None = Field(None, description="pins the element edge at the focus")
    step_s: Positive | None = Field(None, description="pins the skin's time step; must divide the scene's timestep")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.shape == "disc" and (self.radius_m is None or self.thickness_m is None):
            raise ValueError("shape 'disc' needs radius_m and thickness_m")
        if self.shape == "mesh" and (self.mesh is None or self.mesh_unit is None):
            raise ValueError("shape 'mesh' needs mesh and mesh_unit")
        if self.shape != "disc" and self.patch_site is None:
            raise ValueError(f"shape '{self.shape}' needs patch_site")
        if (self.foundation_normal_Pa_m is None) != (self.foundation_tangential_Pa_m is None):
            raise ValueError("foundation_normal_Pa_m and foundation_tangential_Pa_m belong together; give both")
        if self.foundation is not None and self.base != "bonded":
            raise ValueError(f"foundation_normal_Pa_m stands in for a bonded base, base is '{self.base}': drop one")
        if self.base == "free" and self.side != "fixed":
            raise ValueError(f"base 'free' with side '{self.side}' lets the layer fly away: fix one of them")
        given = [key for key in SPRINGS if getattr(self, key) is not None]
        if self.base == "springs" and not set(SPRINGS[:2]) <= set(given):
            raise ValueError("base 'springs' needs base_normal_Pa_m and base_tangential_Pa_m")
        if self.base != "springs" and given:
            raise ValueError(f"{given[0]} belongs to base 'springs', base is '{self.base}': drop it or set base")
        self._check_sheets()
        if self.side == "roller" and self.shape != "disc":
            raise ValueError("side 'roller' needs the symmetry of shape 'disc'; use fixed or free")
        return self

    def _check_sheets(self) -> None:
        if len(self.materials) != len(self.shares):
            raise ValueError(f"materials has {len(self.materials)} names, shares {len(self.shares)}: give one for each")
        if self.shares and abs(sum(self.shares) - 1.0) > 1e-6:
            raise ValueError(f"shares add up to {sum(self.shares):g}; they must to 1")
        own = [key for key in ("material", *OVERRIDES) if key in self.model_fields_set]
        if self.materials and own:
            raise ValueError(f"materials names every sheet's preset and {own[0]} that of one: drop one of the two")

    @property
    def springs(self) -> tuple[float, float, float, float] | None:
        """Stiffness [Pa/m] and damping [Pa s/m] per area, normal and tangential of each, of a base of springs."""
        if self.base != "springs":
            return None
        normal, tangential, normal_loss, tangential_loss = (getattr(self, key) or 0.0 for key in SPRINGS)
        return normal, tangential, normal_loss, tangential_loss

    @property
    def foundation(self) -> tuple[float, float] | None:
        """Normal and tangential stiffness per area of what lies below the layer [Pa/m], or None."""
        if self.foundation_normal_Pa_m is None or self.foundation_tangential_Pa_m is None:
            return None
        return self.foundation_normal_Pa_m, self.foundation_tangential_Pa_m


class DriverConfig(Config):
    plugin: ClassVar[str] = "palmfield.driver"
    about: ClassVar[str] = "The device that plays the drive; what it can't play is not simulated either."

    device: Literal["ideal", "sonicsurface"] = Field(
        "ideal", description="ideal: continuous phase and amplitude at any rate; sonicsurface: decoded from its bytes"
    )


CONFIGS: tuple[type[Config], ...] = (ArrayConfig, StimulusConfig, SkinConfig, DriverConfig)


def parse(model: type[Config], values: dict[str, str], element: str) -> Config:
    """Typed configuration from a plugin instance's texts.

    values: key -> text, only the keys that the scene sets
    element: how the message names the instance, e.g. `plugin 'palmfield.skin' instance 'skin'`
    Raises SceneError with element, key, value and what is allowed.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise SceneError(f"{element}: " + "; ".join(_explain(model, values, e) for e in error.errors())) from None


def _explain(model: type[Config], values: dict[str, str], error: Any) -> str:
    if not error["loc"]:
        return error["msg"].removeprefix("Value error, ")
    key = str(error["loc"][0])
    if key not in model.model_fields:
        return f"unknown key '{key}'; allowed: {', '.join(model.model_fields)}"
    return f"key '{key}' has value '{values[key]}'; allowed: {allowed(model, key)}"


def allowed(model: type[Config], key: str) -> str:
    """What a key takes, in words, e.g. `number > 0` or `bonded | free_slip`."""
    schema = model.model_json_schema()["properties"][key]
    options = [o for o in schema.get("anyOf", [schema]) if o.get("type") != "null"]
    option = options[0]
    if "enum" in option:
        return " | ".join(option["enum"])
    if option.get("type") == "array":
        kinds = {"integer": "whole numbers >= 0", "number": "decimals > 0", "string": "names"}
        return "three finite numbers" if option.get("maxItems") == 3 else kinds[option["items"]["type"]]
    if option.get("type") == "string":
        return f"text like {option['pattern']}" if "pattern" in option else "text"
    words = "whole number" if option.get("type") == "integer" else "finite number"
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    bounds = [f"{sign} {option[name]:g}" for name, sign in signs.items() if name in option]
    return " ".join([words, " and ".join(bounds)]).strip()


def unit(key: str) -> str:
    """Unit that a key's name carries, e.g. `Pa/m` for `foundation_normal_Pa_m`; empty for a pure number or text."""
    units = {
        "_kg_m3": "kg/m^3", "normal_Pa_m": "Pa/m", "tangential_Pa_m": "Pa/m", "_Pa_s_m": "Pa s/m", "_Pa_m": "Pa m",
        "_Pa": "Pa", "_m": "m",
        "_s": "s", "_Hz": "Hz", "_C": "C", "_percent": "%",
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
