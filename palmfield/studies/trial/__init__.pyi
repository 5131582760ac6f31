from .course import Tracker as Tracker
from .latency import measure_latency as measure_latency
from .live import Live as Live
from .recording import Recording as Recording
from .recording import read_recording as read_recording
from .run import Trial as Trial
from .run import trial as trial
