"""Test the fit of single transducers on boards of a simulated laboratory, which shares no model with it.

    python scripts/verification/check_calibration.py [--boards 3]

It prints a table for docs/calibration.md.
"""

import argparse
from typing import Any

import numpy as np
from laboratory import Laboratory, speed_of_sound, strange_board

from palmfield.acoustics.arrays import layout
from palmfield.drive.calibration.element_fit import fit_elements
from palmfield.types import Air

PLACES = 8
P0 = 2.2


def judged(seed: int, exact: bool = False) -> dict[str, Any]:
    """Return errors of one board: phase [rad] and gain of active transducers, standard errors, and fault counts."""
    board = layout("sonicsurface")
    random = np.random.default_rng(seed)
    truth = strange_board(random, len(board))
    at = np.column_stack([random.uniform(-0.06, 0.06, (PLACES, 2)), random.uniform(0.15, 0.25, PLACES)])
    warm = 0.0 if exact else float(random.normal())
    wall: dict[str, Any] = {} if exact else {"plate_m": 0.3 + 0.01 * random.random(), "reflection": 0.1}
    lab = Laboratory(board.positions, truth, P0, 20.0 + warm, bits=8, noise=0.01, random=random, **wall)
    really = at if exact else at + random.normal(0.0, 1e-3, at.shape)
    sure = {"place_sd_m": 1e-5, "temperature_sd_K": 0.01} if exact else {}
    fit = fit_elements(board, Air(), at, lab.read(lab.each(really)), **sure)
    live = truth != 0.0
    found = np.array(fit.elements.polarity) * np.exp(1j * np.array(fit.elements.phase_rad))
    turn = (found / np.where(live, truth, 1.0))[live]
    turn = np.angle(turn * np.exp(-0.5j * np.angle((turn**2).sum())))
    wrong = int((np.abs(turn) > 0.5 * np.pi).sum())
    return {
        "phase": 0.5 * np.angle(np.exp(2j * turn)),
        "phase_sd": np.array(fit.elements.phase_sd_rad)[live],
        "gain": (np.array(fit.elements.gain) - np.abs(truth) / np.abs(truth[live]).mean())[live],
        "gain_sd": np.array(fit.elements.gain_sd)[live],
        "polarities": min(wrong, len(turn) - wrong),
        "silent": bool(np.array_equal(fit.elements.enabled, live)),
        "p0": fit.p0_Pa_m / (P0 * np.abs(truth[live]).mean()) - 1.0,
        "speed": fit.sound_speed_m_s - speed_of_sound(20.0 + warm),
        "speed_sd": fit.sound_speed_sd_m_s,
    }


def row(name: str, one: dict[str, Any]) -> str:
    covers = [100 * float(np.mean(np.abs(one[key]) < 1.96 * one[key + "_sd"])) for key in ("phase", "gain")]
    return (
        f"| {name} | {one['polarities']} | {'yes' if one['silent'] else 'no'} | "
        f"{np.degrees(np.sqrt(np.mean(one['phase'] ** 2))):.1f} | {covers[0]:.0f} | "
        f"{100 * np.sqrt(np.mean(one['gain'] ** 2)):.1f} | {covers[1]:.0f} | {100 * one['p0']:+.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boards", type=int, default=6)
    count = parser.parse_args().boards
    print(
        "| board | wrong polarities | silent ones found | phase, rms [deg] | within its 95 % [%] | gain, rms [%] | "
        "within its 95 % [%] | p0 [%] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for seed in range(count):
        print(row(str(seed), judged(seed)), flush=True)
    for seed in range(count, count + 2):
        print(row(f"{seed}, places and air exact, no wall", judged(seed, True)), flush=True)


if __name__ == "__main__":
    main()
