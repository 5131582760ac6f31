"""Lines of a log of frames, as `palmfield.drive.frame_log` writes and reads them."""

import json


def log_line(time_s: float, data: bytes, *, whole: bool = True) -> str:
    """One piece of bytes, with the line's end. time_s: when its first byte was given to the port [s]"""
    return json.dumps({"t": round(time_s, 7), "hex": data.hex(), **({} if whole else {"cut": True})}) + "\n"
