"""A client of the live view's page without a browser: it counts messages and operates controls."""

import time
from typing import Any, Self
from urllib.parse import urlsplit

import msgspec
import numpy as np
import viser
import zstandard
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.3, 0.3, 0.1], "fov": 1.0, "near": 0.01,
    "far": 10.0, "image_height": 600, "image_width": 800, "look_at": [0.0, 0.0, 0.1], "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip


class PageClient:
    """A connection to a page. Use it as a context manager.

    controls: last known properties of buttons, sliders and texts by label, with `uuid`
    """

    def __init__(self, address: str, headers: dict[str, str] | None = None) -> None:
        """Connect to a page. address: that of the page, without token. Raises InvalidStatus if the page refuses."""
        self._talk = connect(
            f"ws://{urlsplit(address).netloc}/", subprotocols=[f"viser-v{viser.__version__}"], max_size=None,  # type: ignore[list-item]
            additional_headers=headers or {}, origin=(headers or {}).get("Origin"), compression=None,
        )  # fmt: skip
        self._unpack = zstandard.ZstdDecompressor()
        self.controls: dict[str, dict[str, Any]] = {}
        self._by_uuid: dict[str, dict[str, Any]] = {}
        self._send(CAMERA)

    def _send(self, message: dict[str, Any]) -> None:
        self._talk.send(msgspec.msgpack.encode(message))

    def received(self, wait_s: float) -> list[dict[str, Any]]:
        """Return the messages of the next packet, none if none arrives in this time [s]."""
        try:
            packet = self._talk.recv(timeout=wait_s)
        except TimeoutError:
            return []
        assert isinstance(packet, bytes)
        length, packed = (int(n) for n in np.frombuffer(packet[:16], "<u8"))
        inner = self._unpack.decompress(packet[16 : 16 + packed], max_output_size=length)
        messages: list[dict[str, Any]] = msgspec.msgpack.decode(inner)["messages"]
        for message in messages:
            self._note(message)
        return messages

    def _note(self, message: dict[str, Any]) -> None:
        if message["type"] == "GuiUpdateMessage":
            self._by_uuid.get(message["uuid"], {}).update(message["updates"])
        elif "props" in message and "uuid" in message:
            held = {**message["props"], "value": message.get("value"), "uuid": message["uuid"]}
            self._by_uuid[message["uuid"]] = held
            if held.get("label"):
                self.controls[held["label"]] = held

    def until(self, seen: Any, seconds: float = 30.0) -> list[dict[str, Any]]:
        """Return messages up to the first with `seen(message)` true. Raises TimeoutError if there is none."""
        ends, all_messages = time.monotonic() + seconds, []
        while time.monotonic() < ends:
            for message in self.received(0.2):
                all_messages.append(message)
                if seen(message):
                    return all_messages
        raise TimeoutError(f"it did not come in {seconds:g} s; the page says: {self.texts}")

    def until_says(self, words: str, seconds: float = 30.0) -> None:
        """Wait until the page or a button shows these words. Raises TimeoutError as `until`."""
        if not self._says(words):
            self.until(lambda _: self._says(words), seconds)

    def _says(self, words: str) -> bool:
        labels = [str(one.get("label")) for one in self._by_uuid.values()]
        return any(words in text for text in (*self.texts, *labels))

    @property
    def texts(self) -> list[str]:
        """Return the texts in the HTML of the page."""
        return [one["content"] for one in self._by_uuid.values() if "content" in one]

    def press(self, label: str) -> None:
        """Press a button by its present label."""
        button = next(one for one in self._by_uuid.values() if one.get("label") == label)
        self._send({"type": "GuiUpdateMessage", "uuid": button["uuid"], "updates": {"value": True}})

    def turn(self, label: str, value: float | str) -> None:
        """Set a slider, a choice or a text, by its label."""
        self._send({"type": "GuiUpdateMessage", "uuid": self.controls[label]["uuid"], "updates": {"value": value}})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._talk.close()


def is_picture(message: dict[str, Any]) -> bool:
    """Return whether a message has a new state of a skin."""
    return message["type"] == "SceneNodeUpdateMessage" and "glb_data" in message["updates"]


def pictures_a_second(client: PageClient, seconds: float) -> float:
    """Return how many states of the first skin arrive per second."""
    count, began = 0, time.monotonic()
    names: set[str] = set()
    while time.monotonic() < began + seconds:
        for message in client.received(0.2):
            if is_picture(message):
                names.add(message["name"].rsplit("/", 1)[0])
                count += 1
    return count / max(len(names), 1) / (time.monotonic() - began)


__all__ = ["InvalidStatus", "PageClient", "is_picture", "pictures_a_second"]
