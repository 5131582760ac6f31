"""The process of the page, and the simulation side of the link to it, which starts it and never waits for it."""

import contextlib
import importlib.util
import os
import queue
import signal
import sys
import threading
from multiprocessing import get_context
from multiprocessing.connection import Connection

from palmfield.closing import Closing
from palmfield.errors import OutputError, PalmfieldError
from palmfield.studies.view.messages import Address, End, FromPage, FromSimulation, Ready

STARTS_WITHIN_S = 60.0
ENDS_WITHIN_S = 5.0
KINDER = 5
"""Increase of the niceness of the page process relative to the simulation."""


class Link(Closing):
    """Context manager with a page in a separate process, which it ends.

    Separate threads send and receive. So a page that does not respond cannot block the simulation.

    address: address for the browser
    """

    def __init__(self, place: Address) -> None:
        """place: address of the page. Raises OutputError if the page cannot be shown there."""
        # Spawned, not forked, because the page must not get the state of Warp or MuJoCo
        context = get_context("spawn")
        self._talk, talk = context.Pipe()
        self._process = context.Process(target=run_page, args=(talk, place), name="palmfield view", daemon=True)
        self._process.start()
        # Otherwise the pipe would stay open after the end of the process
        talk.close()
        self._inbox: queue.SimpleQueue[FromPage | None] = queue.SimpleQueue()
        self._outbox: queue.SimpleQueue[FromSimulation] = queue.SimpleQueue()
        self.closed = False
        try:
            self.address = self._first_word()
        except BaseException:
            self._process.terminate()
            raise
        threading.Thread(target=_receive, args=(self._talk, self._inbox), daemon=True).start()
        self._sender = threading.Thread(target=_send, args=(self._talk, self._outbox), daemon=True)
        self._sender.start()

    def _first_word(self) -> str:
        try:
            if not self._talk.poll(STARTS_WITHIN_S):
                raise OutputError(
                    f"the page did not respond for {STARTS_WITHIN_S:g} s; check whether the machine is overloaded"
                )
            ready = self._talk.recv()
        except (EOFError, ConnectionError):
            raise OutputError("the page process ended during its start; its output is above") from None
        assert isinstance(ready, Ready)
        if ready.failed:
            raise OutputError(ready.failed)
        return ready.address

    @property
    def pid(self) -> int | None:
        """Id of the process of the page."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Return whether the process of the page runs."""
        return self._process.is_alive()

    def send(self, message: FromSimulation) -> None:
        """Queue a message to be sent after earlier ones."""
        self._outbox.put(message)

    def received(self, wait_s: float = 0.0) -> list[FromPage]:
        """Return the messages since the last call. Wait up to `wait_s` [s] for one.

        Sets `closed` if the page has ended.
        """
        messages: list[FromPage] = []
        if not wait_s and self._inbox.empty():
            return messages
        with contextlib.suppress(queue.Empty):
            while True:
                one = self._inbox.get(timeout=wait_s) if wait_s and not messages else self._inbox.get_nowait()
                if one is None:
                    self.closed = True
                    break
                messages.append(one)
        return messages

    def close(self) -> None:
        """End the process of the page, and wait for its end."""
        self.send(End())
        self._process.join(ENDS_WITHIN_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(ENDS_WITHIN_S)
        self._talk.close()


def _receive(talk: Connection, inbox: "queue.SimpleQueue[FromPage | None]") -> None:
    try:
        while True:
            inbox.put(talk.recv())
    except (EOFError, OSError):
        inbox.put(None)


def _send(talk: Connection, outbox: "queue.SimpleQueue[FromSimulation]") -> None:
    with contextlib.suppress(OSError):
        while True:
            message = outbox.get()
            talk.send(message)
            if isinstance(message, End):
                return


def need_viser() -> None:
    """Raise OutputError if the library viser is missing."""
    if importlib.util.find_spec("viser") is None:
        raise OutputError("a live view needs the package viser: pip install 'palmfield[view]'")


def run_page(talk: Connection, place: Address) -> None:
    """Show the messages that arrive, until the simulation closes the connection or requests the end."""
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
