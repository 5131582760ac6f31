"""Where Warp kernels run."""

import warp as wp

from palmfield.errors import PalmfieldError

wp.config.log_level = wp.LOG_WARNING


def resolve(device: str = "auto") -> str:
    """Name of the Warp device for `auto`, `cpu` or `cuda:N`; `auto` takes the first GPU if there is one.

    Raises PalmfieldError when the device is not on this machine.
    """
    if device == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    known = [str(d) for d in wp.get_devices()]
    if device not in known:
        raise PalmfieldError(f"device '{device}' is not on this machine; use one of auto, {', '.join(known)}")
    return device
