"""How hands move: keyframes, trajectories, recorded tracking, and a tracked hand's motion carried over to another one.

from palmfield.hand import articulate, load_preset
from palmfield.motion import read_stream
from palmfield.motion.retarget import retarget
motion = retarget(articulate(load_preset("open_men_p50")), read_stream("recorded.csv"))
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.motion.joints import HandJoints, hand_joints, joints_at
    from palmfield.motion.keyframes import Curve
    from palmfield.motion.pose import HandPose
    from palmfield.motion.prediction import Noise, Predictor, Resampled, resample
    from palmfield.motion.retarget import Retargeted, RetargetReport
    from palmfield.motion.source import HandMotion, motion_of
    from palmfield.motion.tracking import Stream, StreamReport, read_stream, stream_of, stream_report, write_stream
    from palmfield.motion.trajectory import from_callable, read_trajectory, write_trajectory

_WHERE = {
    **dict.fromkeys(("HandJoints", "hand_joints", "joints_at"), "joints"),
    "Curve": "keyframes",
    "HandPose": "pose",
    **dict.fromkeys(("Noise", "Predictor", "Resampled", "resample"), "prediction"),
    **dict.fromkeys(("RetargetReport", "Retargeted"), "retarget"),
    **dict.fromkeys(("HandMotion", "motion_of"), "source"),
    **dict.fromkeys(
        ("Stream", "StreamReport", "read_stream", "stream_of", "stream_report", "write_stream"), "tracking"
    ),
    **dict.fromkeys(("from_callable", "read_trajectory", "write_trajectory"), "trajectory"),
}
__all__ = [
    "Curve",
    "HandJoints",
    "HandMotion",
    "HandPose",
    "Noise",
    "Predictor",
    "Resampled",
    "RetargetReport",
    "Retargeted",
    "Stream",
    "StreamReport",
    "from_callable",
    "hand_joints",
    "joints_at",
    "motion_of",
    "read_stream",
    "read_trajectory",
    "resample",
    "stream_of",
    "stream_report",
    "write_stream",
    "write_trajectory",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
