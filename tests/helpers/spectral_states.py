"""Forces, states, momentum and energy of bodies on spectral elements, by float64 sums on the host."""

from typing import NamedTuple

import numpy as np
import warp as wp

from palmfield.skin.solvers.spectral_elements.run import branch_step, copies_of, state_size


class State(NamedTuple):
    """Displacement u [m] at a step, velocity v [m/s] half a step before it, y = u - q [m] by branch and copy."""

    u: np.ndarray
    v: np.ndarray
    strain: np.ndarray


def element_forces(model, u, w, shear=None):
    """Nodal sums of internal forces [N], (nodes, 3): deviatoric part of w, pressure of u, both (nodes, 3).

    shear: shear modulus by sheet [Pa], default the relaxed one. Where the pressure follows w, w counts for both.
    """
    return forces_of(model, u, w, model.moduli if shear is None else model.moduli_of(shear))


def forces_of(model, u, w, moduli):
    spare = wp.zeros(1, dtype=wp.int32, device=model.device)
    model.launch(model.vectors(u), model.vectors(w), model.conn, model.conn, moduli, spare)
    parts = model.force.numpy()[:, model.layout.at].reshape(3, -1).astype(np.float64)
    nodes = model.solid.elements.ravel()
    return np.stack([np.bincount(nodes, part, minlength=len(model.solid.nodes)) for part in parts], axis=1)


def copies(model):
    """The laws, and node and law of each copy."""
    laws, keys, _ = copies_of(model.solid, model.materials)
    return laws, keys // len(laws), keys % len(laws)


def numbers(run):
    found = np.zeros(state_size(run.model.solid, run.model.materials))
    run.numbers(found)
    return found.reshape(-1, 3)


def state(run):
    nodes, rows = len(run.model.solid.nodes), numbers(run)
    count = len(copies(run.model)[1])
    return State(rows[:nodes], rows[nodes : 2 * nodes], rows[2 * nodes + count :].reshape(-1, count, 3))


def place(run, u, v):
    """Put a body that has not moved yet into another state with branches at rest: both (nodes, 3)."""
    rows = np.zeros_like(numbers(run))
    nodes, of_copy = len(u), copies(run.model)[1]
    rows[:nodes], rows[nodes : 2 * nodes], rows[2 * nodes : 2 * nodes + len(of_copy)] = u, v, u[of_copy]
    run.begin(rows.ravel(), run.table.frames)


def momentum(run):
    """Sum of mass times velocity [kg m/s], shape (3,)."""
    return run.model.mass @ state(run).v


def energy(run, before, after):
    """E of the step between two states [J]; see `Stepper`."""
    model, h, holds = run.model, run.step_s, run.holds
    laws, copy_node, copy_law = copies(model)
    shear = [m.shear_relaxed_Pa for m in model.materials]
    total = 0.5 * model.mass @ (after.v * after.v).sum(axis=1)
    total += 0.5 * np.einsum("rc,rcd,rd->", before.u[holds.rows], holds.spring, after.u[holds.rows])
    # Pressure that follows w takes the dashpot's and branches' shares as well
    total += 0.5 * (before.u * element_forces(model, after.u, after.u, shear)).sum()
    for law, (branches, viscous_s) in enumerate(laws):
        mine = np.array([m.relaxation == laws[law] for m in model.materials])
        own = [g if here else 0.0 for g, here in zip(shear, mine, strict=True)]
        rows = np.flatnonzero(copy_law == law)

        def product(a, b, mine=mine, own=own):
            """a K_d b: the deviatoric part, and the pressure where the bulk follows."""
            bulk = np.array([m.bulk_Pa if m.bulk_relaxes else 0.0 for m in model.materials]) * mine
            moduli = model.moduli_of(own).numpy()
            moduli[1, : len(model.solid.sheet)] = bulk[model.solid.sheet]
            return (a * forces_of(model, b, b, model.put(moduli))).sum()

        if viscous_s > 0.0:
            total -= 0.25 * h * viscous_s * product(after.v, after.v)
        for branch, (g, tau) in enumerate(branches):
            e, ch = branch_step(h, tau)
            if ch == 0.0:
                continue
            y0, y1 = np.zeros((2, *before.u.shape))
            y0[copy_node[rows]], y1[copy_node[rows]] = before.strain[branch, rows], after.strain[branch, rows]
            total += 0.5 * g * h / ch * (product(y0, y1) + 0.5 * (1.0 - e) * product(y0, y0))
    return float(total)
