"""A board at the end of a transport: started, sent frames, stopped, with a clock; and the log of what was sent when."""

import time
from typing import Self

from palmfield.drive.board import Board
from palmfield.drive.frame_log import FrameLog
from palmfield.drive.transport import PortLost, Transport
from palmfield.errors import DeviceError, OutputError


class BoardLink:
    """An open board. Use as a context manager, or close it: it is silenced then.

    simulated: whether its clock is not the wall's: a record of frames that span a minute takes no minute, and holds the
    frames which the line would have carried
    log: gets each piece of bytes with its time; closed with the link
    """

    def __init__(
        self, board: Board, transport: Transport, *, simulated: bool = False, log: FrameLog | None = None
    ) -> None:
        assert board.line is not None
        self.board, self.transport, self.line = board, transport, board.line
        self.frames = 0
        self._log = log
        self._clock: float | None = 0.0 if simulated else None
        self._begin = self.now()
        self._sounding = True  # boards may sound from power-up on
        self._lost = self._closed = False

    def now(self) -> float:
        """Seconds on this link's clock."""
        return time.monotonic() if self._clock is None else self._clock

    def wait_until(self, when: float) -> None:
        """Return when the clock shows `when`."""
        if self._clock is None:
            time.sleep(max(0.0, when - self.now()))
        else:
            self._clock = max(self._clock, when)

    def start(self) -> None:
        """Send what puts the board into a known, silent state. Raises DeviceError when the port is gone."""
        self._send_whole(self.board.start)

    def write(self, frame: bytes) -> bool:
        """Send one whole frame.

        False after a write timeout: part of the frame may be on the line, so send a frame from its start.
        Raises DeviceError when the port is gone, or takes no bytes for 2 s.
        """
        self._sounding = True
        through = self._send(frame)
        self.frames += through
        return through

    def off(self) -> None:
        """Silence the board, unless nothing was sent since it was last silenced; returns when the bytes are out.

        Raises DeviceError when the port is gone.
        """
        if self._lost or not self._sounding:
            return
        self._send_whole(self.board.stop)
        try:
            self.transport.flush()
        except PortLost as error:
            raise self._gone() from error
        self._sounding = False

    def _send_whole(self, data: bytes) -> None:
        while data and not self._send(data):
            pass
        self.wait_until(self.now() + (self.line.time_s(len(data)) if self._clock is not None else 0.0))

    def _send(self, data: bytes) -> bool:
        try:
            through = self.transport.write(data)
        except PortLost as error:
            raise self._gone() from error
        except OutputError:
            self._lost = True
            raise
        if self._log is not None:
            self._log.add(self.now() - self._begin, data, whole=through)
        return through

    def close(self) -> None:
        """Silence the board and free the port. Raises DeviceError when the port is gone and nobody was told yet."""
        if self._closed:
            return
        self._closed = True
        try:
            self.off()
        finally:
            self.transport.close()
            if self._log is not None:
                self._log.close()

    def _gone(self) -> DeviceError:
        self._lost = True
        return DeviceError(
            f"lost the board on {self.transport.name} after {self.frames} frames; {self.board.when_host_dies}"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
