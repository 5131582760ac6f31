"""The process of the page: its start and end."""

import contextlib
import importlib.util
import os
import signal
import sys
from multiprocessing.connection import Connection

from palmfield.errors import OutputError, PalmfieldError
from palmfield.studies.view.messages import Address, Ready

KINDER = 5
"""Increase of the page process's niceness relative to the simulation."""


def need_viser() -> None:
    """Raise OutputError if the library of the page is missing."""
    if importlib.util.find_spec("viser") is None:
        raise OutputError("a live view needs the package viser: pip install 'palmfield[view]'")


def run_page(talk: Connection, place: Address) -> None:
    """Show the messages that arrive, until the other end is closed or requests the end."""
    # Ctrl-C ends the simulation, which ends this process when its recording is complete
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(KINDER)
    # viser prints an address that is not that of the page
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - for the rest of the process
    try:
        from palmfield.studies.view.page import Page

        page = Page(talk, place)
    except (PalmfieldError, OSError) as error:
        talk.send(Ready("", str(error)))
        return
    talk.send(Ready(page.address))
    page.run()
    # Waiting threads of viser would delay the end of the process by seconds
    sys.stderr.flush()
    os._exit(0)
