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
    # Each file there is a board; its code lies in a layer above
    BoardName = Literal[tuple(sorted(module.name for module in iter_modules([str(BOARDS_FOLDER)])))]
Switch = Literal["on", "off"]
SAFETY_KEYS = ("ramp_s", "on_time_s", "duty_limit", "head_m", "head_radius_m", "head_limit_dB")
"""Keys about how loud and how long a board may sound, whichever it is; `palmfield safety` and `drive` heed them."""
Bits = Annotated[str, Field(pattern="^[01]{1,64}$")]


class DriverConfig(Config):
    plugin: ClassVar[str] = "palmfield.driver"
    about: ClassVar[str] = "The board that plays the drive; what it can't play is not simulated either."
    renamed: ClassVar[dict[str, str]] = {"device": "board"}

    board: BoardName = Field(
        "ideal",
        description="ideal: any phase and amplitude at any rate; others are decoded from their bytes (boards.md)",
    )
    duty_exponent: Annotated[float, Field(ge=0.5, le=4)] = Field(
        2.0,
        description="g of the pulses' law p/p_M = sin(pi duty)^(g/2), of am_quantity duty and board "
        "autd2018: 2 is that of rectangular pulses; 1.5 was measured on a device (Hasegawa and Shinoda 2018)",
    )
    compensate: Switch | None = Field(
        None,
        description="whether the drive makes up for transducers that are dead or inverted, or whose phase the scene "
        "knows (default: on, but for board ideal on arrays without a calibration)",
    )
    dither: Switch | None = Field(
        None, description="boards of full or off: amplitudes between by a share of transducers that is on (default off)"
    )
    packet_header: Bits | None = Field(None, description="autd2018: bits before a packet's payload (default 10100101)")
    packet_footer: Bits | None = Field(None, description="autd2018: bits after it (default 1011010)")
    packet_bit_order: Literal["msb_first", "lsb_first"] | None = Field(
        None, description="autd2018: which bit of each field comes first (default msb_first)"
    )
    packet_lsb_m: Positive | None = Field(
        None, description="autd2018: what the lowest bit of a coordinate is (default 0.000025)"
    )
    packet_baud: Annotated[int, Field(gt=0)] | None = Field(
        None, description="autd2018: rate of the serial line to the first unit [baud] (default 230400)"
    )
    pwm_edge: Literal["leading", "trailing", "centre"] | None = Field(
        None, description="autd2018: what of a pulse keeps its place as its width changes (default centre)"
    )
    hop_delay_s: NonNegative | None = Field(
        None, description="autd2018: delay of each unit that a packet passes (default 4e-8)"
    )
    skew_s: NonNegative | None = Field(
        None, description="autd2018: largest difference that the sync leaves between units (default 0)"
    )
    clock_drift_ppm: NonNegative | None = Field(
        None, description="autd2018: largest difference of units' clocks (default 0)"
    )
    sync: Switch | None = Field(None, description="autd2018: whether clocks are set every 500 us (default on)")
    board_sound_speed_m_s: Positive | None = Field(
        None, description="autd2018: speed of sound with which units place the focus (default that of air at 20 C)"
    )
    ramp_s: NonNegative = Field(
        0.0, description="time in which a real board's sound rises at the beginning and falls at the end"
    )
    on_time_s: Positive | None = Field(
        None, description="longest that a real board may sound in one play (default any)"
    )
    duty_limit: Annotated[float, Field(gt=0, le=1)] = Field(
        1.0, description="largest share of any 10 s that a real board may sound"
    )
    head_m: Vector | None = Field(
        None, description="middle of a ball in which a person's head may be, in the frame of the first array"
    )
    head_radius_m: Annotated[float, Field(gt=0, le=0.5)] = Field(0.1, description="radius of that ball")
    head_limit_dB: Annotated[float, Field(ge=40, le=150)] | None = Field(
        None, description="sound pressure level in that ball above which nothing is played (default: only warned of)"
    )

    def of_board(self, keys: Container[str]) -> dict[str, Any]:
        """Values of some keys as they are written, those that are set."""
        return {key: value for key, value in self.model_dump(exclude_none=True).items() if key in keys}

    @property
    def board_keys(self) -> dict[str, Any]:
        """Keys that are the board's own, those that are set."""
        own = self.model_dump(exclude={"board", "compensate", "duty_exponent", *SAFETY_KEYS}, exclude_none=True)
        if "dither" in own:
            own["dither"] = own["dither"] == "on"
        return own
