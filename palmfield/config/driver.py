"""Keys of palmfield.driver."""

from collections.abc import Container
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from palmfield.config.base import Config, NonNegative, Positive, Vector

BOARDS_FOLDER = Path(__file__).parents[1] / "drive" / "boards"
if TYPE_CHECKING:
    BoardName = str
else:
    # Each file in this folder is one board. The folder is listed because config may not import drive
    BoardName = Literal[tuple(sorted(module.name for module in iter_modules([str(BOARDS_FOLDER)])))]
Switch = Literal["on", "off"]
SAFETY_KEYS = ("ramp_s", "on_time_s", "duty_limit", "head_m", "head_radius_m", "head_limit_dB")
"""Keys that limit the level and duration of the sound of any board; used by `palmfield safety` and `drive`."""
Bits = Annotated[str, Field(pattern="^[01]{1,64}$")]


class DriverConfig(Config):
    plugin: ClassVar[str] = "palmfield.driver"
    about: ClassVar[str] = "The board that plays the drive. Only drives that the board can play are simulated."
    renamed: ClassVar[dict[str, str]] = {"device": "board"}

    board: BoardName = Field(
        "ideal",
        description="ideal: any phase and amplitude at any rate; other boards: the drive decoded from their bytes "
        "(boards.md)",
    )
    duty_exponent: Annotated[float, Field(ge=0.5, le=4)] = Field(
        2.0,
        description="exponent g of the pulse-width law p/p_M = sin(pi duty)^(g/2), for am_quantity duty and board "
        "autd2018: 2 for rectangular pulses; 1.5 measured on a device (Hasegawa and Shinoda 2018)",
    )
    compensate: Switch | None = Field(
        None,
        description="whether the drive compensates dead and inverted transducers and calibrated phases (default: "
        "on, except for board ideal on arrays without a calibration)",
    )
    dither: Switch | None = Field(
        None,
        description="on/off boards: intermediate amplitudes by switching on a share of the transducers (default off)",
    )
    packet_header: Bits | None = Field(None, description="autd2018: bits before the payload (default 10100101)")
    packet_footer: Bits | None = Field(None, description="autd2018: bits after the payload (default 1011010)")
    packet_bit_order: Literal["msb_first", "lsb_first"] | None = Field(
        None, description="autd2018: order of the bits in each field (default msb_first)"
    )
    packet_lsb_m: Positive | None = Field(
        None, description="autd2018: value of the lowest bit of a coordinate (default 0.000025)"
    )
    packet_baud: Annotated[int, Field(gt=0)] | None = Field(
        None, description="autd2018: baud rate of the serial line to the first unit (default 230400)"
    )
    pwm_edge: Literal["leading", "trailing", "centre"] | None = Field(
        None, description="autd2018: point of a pulse that stays fixed as its width changes (default centre)"
    )
    hop_delay_s: NonNegative | None = Field(
        None, description="autd2018: delay added by each unit that forwards a packet (default 4e-8)"
    )
    skew_s: NonNegative | None = Field(
        None, description="autd2018: largest timing difference between units after synchronisation (default 0)"
    )
    clock_drift_ppm: NonNegative | None = Field(
        None, description="autd2018: largest difference between the clocks of the units (default 0)"
    )
    sync: Switch | None = Field(
        None, description="autd2018: whether the clocks are synchronised every 500 us (default on)"
    )
    board_sound_speed_m_s: Positive | None = Field(
        None, description="autd2018: speed of sound that the units use to compute the focus (default: air at 20 C)"
    )
    ramp_s: NonNegative = Field(
        0.0, description="rise time of the sound at the beginning, and fall time at the end, on a real board"
    )
    on_time_s: Positive | None = Field(
        None, description="longest time with sound in one play on a real board (default: no limit)"
    )
    duty_limit: Annotated[float, Field(gt=0, le=1)] = Field(
        1.0, description="largest share of any 10 s with sound on a real board"
    )
    head_m: Vector | None = Field(
        None, description="centre of the ball that contains the head of a person, in the frame of the first array"
    )
    head_radius_m: Annotated[float, Field(gt=0, le=0.5)] = Field(0.1, description="radius of that ball")
    head_limit_dB: Annotated[float, Field(ge=40, le=150)] | None = Field(
        None,
        description="highest sound pressure level allowed in that ball; above it the board does not play (default: "
        "warning only)",
    )

    def of_board(self, keys: Container[str]) -> dict[str, Any]:
        """Return the values of the keys in `keys` that the scene sets."""
        return {key: value for key, value in self.model_dump(exclude_none=True).items() if key in keys}

    @property
    def board_keys(self) -> dict[str, Any]:
        """Return the keys that the scene sets and that apply only to the board."""
        own = self.model_dump(exclude={"board", "compensate", "duty_exponent", *SAFETY_KEYS}, exclude_none=True)
        if "dither" in own:
            own["dither"] = own["dither"] == "on"
        return own
