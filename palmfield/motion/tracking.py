"""Read, write and assess a recorded stream of the 26 hand joints of OpenXR."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import ArticulatedHand, bone_poses
from palmfield.motion.joints import (
    ALL_FLAGS,
    FARTHEST_M,
    JOINTS,
    ORIENTATION_VALID,
    POSITION_VALID,
    USUAL_M,
    hand_joints,
    joints_at,
)
from palmfield.motion.pose import PoseCourse
from palmfield.tables import read_table, write_table
from palmfield.types import Float, Int

PARTS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "radius_m", "flags")
GAP = 1.5
"""Smallest time between packets that counts as a dropout, in usual periods."""


@dataclass(frozen=True)
class Stream:
    """Packets of tracked joints in the order of arrival.

    times_s: times of measurement [s], shape (n,); they may be out of order
    positions: positions of JOINTS in the world [m], shape (n, 26, 3)
    quaternions: orientations, w first (last in OpenXR), shape (n, 26, 4)
    radii: distance from each joint to the skin [m], shape (n, 26)
    flags: XrSpaceLocationFlags, shape (n, 26); joints not flagged as valid are ignored and may have any numbers
    """

    times_s: Float
    positions: Float
    quaternions: Float
    radii: Float
    flags: Int

    def __len__(self) -> int:
        return len(self.times_s)


@dataclass(frozen=True)
class StreamReport:
    """Quality of a stream.

    packets: number of packets; period_s: median time between two packets [s]; jitter_s: standard deviation of this
        time, without dropouts [s]
    dropouts: number of gaps without packets or without a hand; longest_s: longest gap [s]; lost: share of the total
        time in gaps
    reordered: number of packets out of order; repeated: number of packets with a repeated time
    invalid: share of joints in the packets without a valid position
    """

    packets: int
    period_s: float
    jitter_s: float
    dropouts: int
    longest_s: float
    lost: float
    reordered: int
    repeated: int
    invalid: float


def stream_report(stream: Stream) -> StreamReport:
    """Return the dropouts, the jitter and the order of the packets of a stream."""
    late = stream.times_s[1:] < np.maximum.accumulate(stream.times_s)[:-1]
    in_order = ordered(stream)
    times = in_order.times_s
    valid = (in_order.flags & POSITION_VALID) != 0
    period = float(np.median(np.diff(times)))
    valid_s = times[valid.any(axis=1)]
    between = np.diff(np.concatenate([times[:1], valid_s, times[-1:]]))
    gaps = between[between > GAP * period]
    usual = between[(between > 0.0) & (between <= GAP * period)]
    return StreamReport(
        packets=len(stream),
        period_s=period,
        jitter_s=float(np.sqrt(np.mean((usual - period) ** 2))) if len(usual) else 0.0,
        dropouts=len(gaps),
        longest_s=float(gaps.max()) if len(gaps) else 0.0,
        lost=float(np.sum(gaps - period) / (times[-1] - times[0])),
        reordered=int(np.count_nonzero(late)),
        repeated=len(stream) - len(times),
        invalid=float(1.0 - valid.mean()),
    )


def ordered(stream: Stream) -> Stream:
    """Return the packets in the order of their times. Of packets with equal times, only the first to arrive is kept."""
    _, order = np.unique(stream.times_s, return_index=True)
    return Stream(
        stream.times_s[order],
        stream.positions[order],
        stream.quaternions[order],
        stream.radii[order],
        stream.flags[order],
    )


def checked_stream(stream: Stream, what: str, places: Sequence[str] | None = None) -> Stream:
    """Return the stream with unit quaternions; invalid joints get a quaternion of 1, 0, 0, 0 and position 0.

    what: prefix of error messages
    places: name of each packet in error messages
    Raises SceneError for other shapes, for fewer than two different times, and for times that are not finite. Raises
    SceneError also if a joint flagged as valid has numbers that are not finite, a quaternion of length 0, or a radius
    that is not positive, and if the sizes are not those of a hand in metres.
    """
    n, j = len(stream.times_s), len(JOINTS)
    names = places or [f"packet {k + 1}" for k in range(n)]
    shapes = {"positions": (n, j, 3), "quaternions": (n, j, 4), "radii": (n, j), "flags": (n, j)}
    for name, shape in shapes.items():
        if np.shape(getattr(stream, name)) != shape:
            raise SceneError(f"{what}: {name} have shape {np.shape(getattr(stream, name))}; give {shape}")
    times = np.asarray(stream.times_s, dtype=np.float64)
    lost = np.flatnonzero(~np.isfinite(times))
    if len(lost):
        raise SceneError(f"{what}: {names[int(lost[0])]}, time_s is {times[lost[0]]:g}; give a finite number")
    if len(np.unique(times)) < 2:
        raise SceneError(f"{what}: {len(np.unique(times))} packets of different times; give two or more")
    placed, turned = (stream.flags & POSITION_VALID) != 0, (stream.flags & ORIENTATION_VALID) != 0
    lengths = np.linalg.norm(stream.quaternions, axis=2)
    faults = {
        "position is not finite": placed & ~np.isfinite(stream.positions).all(axis=2),
        "radius is not positive": placed & ~(stream.radii > 0.0),
        "quaternion has no length": turned & ~((lengths > 1e-6) & np.isfinite(lengths)),
    }
    for fault, bad in faults.items():
        if bad.any():
            k, joint = (int(i) for i in np.argwhere(bad)[0])
            place = f"{what}: {names[k]}, {JOINTS[joint]}"
            raise SceneError(f"{place}: {fault}, but it is flagged as valid; correct it, or its flags")
    far = np.argwhere(placed & (np.abs(stream.positions).max(axis=2) > FARTHEST_M))
    wrist, tip = JOINTS.index("wrist"), JOINTS.index("middle_tip")
    both = placed[:, wrist] & placed[:, tip]
    spans = np.linalg.norm(stream.positions[both, tip] - stream.positions[both, wrist], axis=1)
    span = float(np.median(spans)) if both.any() else 0.0
    if len(far) or (span > 0.0 and not USUAL_M[0] < span < USUAL_M[1]):
        reason = f"{names[int(far[0][0])]}, {JOINTS[far[0][1]]}: more than {FARTHEST_M:g} m away" if len(far) else ""
        reason = reason or f"wrist and tip of the middle finger are {span:.3g} m apart"
        raise SceneError(f"{what}: {reason}; give metres: allowed are {USUAL_M[0]:g} to {USUAL_M[1]:g} m for a hand")
    unit = np.where(
        turned[:, :, None], stream.quaternions / np.where(turned, lengths, 1.0)[:, :, None], [1.0, 0.0, 0.0, 0.0]
    )
    positions = np.where(placed[:, :, None], stream.positions, 0.0)
    radii = np.where(placed, stream.radii, 0.0)
    return Stream(times, positions, unit, radii, np.asarray(stream.flags, dtype=np.int32))


def read_stream(path: str | Path) -> Stream:
    """Read a stream from a CSV or NPZ table with one row per packet, in the order of arrival.

    Columns (arrays of one length in an NPZ): time_s and, for each of JOINTS, JOINT_x_m, JOINT_y_m, JOINT_z_m, JOINT_qw,
    JOINT_qx, JOINT_qy, JOINT_qz, JOINT_radius_m and JOINT_flags (XrSpaceLocationFlags as a whole number). Cells are
    numbers, which may be nan for an invalid joint. Other columns are refused.
    Raises SceneError like `read_trajectory` for the table and like `checked_stream` for its numbers.
    """
    file = Path(path)
    names = column_names()
    columns, places = read_table(file, gaps=[name for name in names[1:] if not name.endswith("_flags")])
    missing = [name for name in names if name not in columns]
    unknown = [name for name in columns if name not in names]
    if missing or unknown:
        fault = f"column '{missing[0]}' is missing" if missing else f"column '{unknown[0]}' is unknown"
        raise SceneError(f"{file}: {fault}; use time_s and JOINT_PART with JOINT palm, wrist, ... and PART {PARTS}")
    table = np.stack([columns[name] for name in names[1:]], axis=1).reshape(len(places), len(JOINTS), len(PARTS))
    flags = table[:, :, 8]
    bad = np.argwhere((flags != np.round(flags)) | (flags < 0.0) | (flags > ALL_FLAGS))
    if len(bad):
        k, joint = bad[0]
        raise SceneError(
            f"{file}: {places[k]}, column {JOINTS[joint]}_flags: {flags[k, joint]:g}; "
            f"use a whole number from 0 to {ALL_FLAGS}, the sum of XrSpaceLocationFlags"
        )
    stream = Stream(columns["time_s"], table[:, :, :3], table[:, :, 3:7], table[:, :, 7], flags.astype(np.int32))
    return checked_stream(stream, str(file), places)


def write_stream(path: str | Path, stream: Stream) -> None:
    """Write a stream to a CSV or NPZ file that `read_stream` reads.

    Raises SceneError like `checked_stream`, OutputError for a file that cannot be written.
    """
    checked = checked_stream(stream, "tracking stream")
    table = np.concatenate(
        [checked.positions, checked.quaternions, checked.radii[:, :, None], checked.flags[:, :, None]], axis=2
    )
    rows = np.column_stack([checked.times_s, table.reshape(len(checked), -1)])
    write_table(Path(path), column_names(), rows)


def column_names() -> list[str]:
    """Return the column names of the table of a stream: the time, and then the columns of each joint."""
    return ["time_s", *(f"{joint}_{part}" for joint in JOINTS for part in PARTS)]


def stream_of(hand: ArticulatedHand, motion: PoseCourse, times_s: ArrayLike) -> Stream:
    """Return the samples of an ideal tracker for the motion of a hand, at times [s], shape (n,)."""
    times = np.asarray(times_s, dtype=np.float64)
    joints = hand_joints(hand)
    positions, quaternions = [], []
    for time in times:
        pose = motion(float(time))
        turn = Rotation.from_quat(pose.quaternion, scalar_first=True)
        origins, rotations = bone_poses(hand, pose.angles_deg)
        positions.append(turn.apply(joints_at(hand, joints, origins, rotations)) + pose.position)
        turned = turn.as_matrix() @ rotations[joints.bones] @ joints.frames
        quaternions.append(Rotation.from_matrix(turned).as_quat(scalar_first=True))
    n = len(positions)
    flags = np.full((n, len(JOINTS)), ALL_FLAGS, dtype=np.int32)
    radii = np.tile(joints.radii, (n, 1))
    return Stream(times, np.array(positions), np.array(quaternions), radii, flags)
