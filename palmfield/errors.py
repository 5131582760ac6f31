"""Errors that users see. Each message is one line: what was found, what is allowed, how to mend it."""


class PalmfieldError(Exception):
    """Base of every error that a user can cause and mend; the command line prints it and exits with 2."""


class SceneError(PalmfieldError):
    """A scene, or a file that it names, says something that cannot be built."""


class DeviceError(PalmfieldError):
    """A board cannot play what is asked of it, or cannot be reached."""


class OutputError(PalmfieldError):
    """Results cannot be written or read back."""


class naming_world:
    """An error of palmfield's that leaves the block says in which of several worlds it was."""

    def __init__(self, world: int):
        self.world = world

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, at: object) -> None:
        if isinstance(error, PalmfieldError):
            raise type(error)(f"world {self.world}: {error}") from None
