"""A disc that goes straight over an array at a constant speed, with a focus that is meant to stay on its middle."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

SPEED_m_s = np.array([0.2, 0.1, 0.05])
START_m = np.array([-0.02, -0.01, 0.12])


def true_place(time_s: float) -> np.ndarray:
    """Where the disc's middle is."""
    return START_m + SPEED_m_s * time_s


@pytest.fixture
def moving_scene(small_scene: Callable[..., Path], tmp_path: Path) -> Callable[..., Path]:
    """Writes the scene; keywords change keys as those of small_scene do."""

    def write(**changes: object) -> Path:
        stimulus = {"focus_m": "0 0 0", "frame": "centre", "modulation": "none"} | {
            key: None for key in ("am_quantity", "am_frequency_Hz", "am_depth")
        }
        changes["stimulus"] = stimulus | dict(changes.get("stimulus", {}))
        path = small_scene(duration_s=0.25, **changes)
        rows = [[t, *true_place(t), 0, 1, 0, 0] for t in np.linspace(0.0, 0.5, 6)]
        lines = ["time_s,x_m,y_m,z_m,qw,qx,qy,qz", *(",".join(repr(float(x)) for x in row) for row in rows)]
        (tmp_path / "straight.csv").write_text("\n".join(lines) + "\n")
        plain = tmp_path / "plain.xml"
        joint = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'
        still = plain.read_text().replace(joint, "").replace('gravcomp="1"', 'mocap="true"')
        plain.write_text(still)
        motion = (
            '<plugin plugin="palmfield.motion"><instance name="motion"><config key="body" value="pad"/>'
            '<config key="trajectory" value="straight.csv"/></instance></plugin>'
        )
        path.write_text(path.read_text().replace("<extension>", "<extension>" + motion, 1))
        return path

    return write
