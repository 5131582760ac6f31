"""What `palmfield drive` makes of --live."""

import sys

from palmfield.hardware.live_focus import LiveInput
from palmfield.motion.replaying import address_by


def live_input(text: str, offset: tuple[float, float, float] | None) -> LiveInput:
    """Where foci come in. Raises DeviceError for what is no address."""

    def told(host: str, port: int) -> None:
        print(f"listening for foci at {host}:{port} by {by}; Ctrl-C ends it", file=sys.stderr, flush=True)

    host, port, by = address_by(text)
    return LiveInput(host, port, by, offset or (0.0, 0.0, 0.0), on_listening=told)
