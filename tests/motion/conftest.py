import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.hand.articulated import articulate
from palmfield.hand.preset import DIGITS, load_preset
from palmfield.motion.pose import HandPose
from palmfield.motion.tracking import Stream


def swing(time_s, wrist_deg=0.0):
    """A hand that goes round in decimetres about once in two seconds while all its joints move."""
    w = np.pi * time_s
    position = np.array([0.1 * np.sin(w), 0.08 * np.cos(0.7 * w), 0.2 + 0.05 * np.sin(1.3 * w)])
    turn = Rotation.from_euler("xyz", [20 * np.sin(0.8 * w), 15 * np.sin(w), 30 * np.sin(0.6 * w)], degrees=True)
    share = 0.5 - 0.5 * np.cos(1.1 * w)
    angles = {f"{d}_{joint}_flexion": 60.0 * share for d in DIGITS[1:] for joint in ("mcp", "pip", "dip")}
    angles |= {"index_mcp_abduction": 8.0 * np.sin(1.3 * w), "little_mcp_abduction": 6.0 + 6.0 * np.sin(1.3 * w)}
    angles |= {"thumb_cmc_abduction": 30.0 * share, "thumb_mp_flexion": 25.0 * share, "thumb_ip_flexion": 30.0 * share}
    if wrist_deg:
        angles |= {"wrist_flexion": wrist_deg * share}
    return HandPose(position, turn.as_quat(scalar_first=True), angles)


def disturbed(stream, position_m, angle_rad, seed=0):
    """The stream with a tracker's noise."""
    rng = np.random.default_rng(seed)
    turned = Rotation.from_quat(stream.quaternions.reshape(-1, 4), scalar_first=True)
    noise = Rotation.from_rotvec(rng.normal(0.0, angle_rad, (turned.as_quat().shape[0], 3)))
    quaternions = (noise * turned).as_quat(scalar_first=True).reshape(stream.quaternions.shape)
    positions = stream.positions + rng.normal(0.0, position_m, stream.positions.shape)
    return Stream(stream.times_s, positions, quaternions, stream.radii, stream.flags)


@pytest.fixture(name="swing", scope="session")
def _swing():
    return swing


@pytest.fixture(name="disturbed", scope="session")
def _disturbed():
    return disturbed


@pytest.fixture(scope="session")
def median():
    return articulate(load_preset("open_men_p50"))
