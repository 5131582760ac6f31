"""Where Warp kernels run."""

import os

import warp as wp

from palmfield.errors import PalmfieldError


def _start() -> None:
    """Initialise Warp without its notice that there is no GPU, which C code writes straight to standard error."""
    wp.config.log_level = wp.LOG_WARNING
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


_start()


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
