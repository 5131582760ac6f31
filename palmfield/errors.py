"""Errors that users see. Each message is one line: what was found, what is allowed, how to mend it."""


class PalmfieldError(Exception):
    """Base of every error that a user can cause and mend; the command line prints it and exits with 2."""


class SceneError(PalmfieldError):
    """A scene, or a file that it names, says something that cannot be built."""


class DeviceError(PalmfieldError):
    """A board or a GPU cannot do what is asked of it, or a board cannot be reached."""


class OutputError(PalmfieldError):
    """Results cannot be written or read back."""
