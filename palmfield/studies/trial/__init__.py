"""Hardware in the loop: where a hand is believed to be, what a board makes of it, and what the hand really gets."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.studies.trial.belief import Tracker
    from palmfield.studies.trial.latency import measure_latency
    from palmfield.studies.trial.live import Live
    from palmfield.studies.trial.recording import Recording, read_recording
    from palmfield.studies.trial.run import Trial, trial

_WHERE = {
    "Tracker": "belief",
    "measure_latency": "latency",
    "Live": "live",
    **dict.fromkeys(("Recording", "read_recording"), "recording"),
    **dict.fromkeys(("Trial", "trial"), "run"),
}
__all__ = ["Live", "Recording", "Tracker", "Trial", "measure_latency", "read_recording", "trial"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
