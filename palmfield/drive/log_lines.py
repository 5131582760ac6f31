"""Lines of a log of frames, as `palmfield.drive.frame_log` writes and reads them."""

import json


def log_line(time_s: float, data: bytes, *, whole: bool = True) -> str:
    """Return the line of one piece of bytes, with newline; time_s: when the port received its first byte [s]."""
    return json.dumps({"t": round(time_s, 7), "hex": data.hex(), **({} if whole else {"cut": True})}) + "\n"
