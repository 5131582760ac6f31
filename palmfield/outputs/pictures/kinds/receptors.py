"""Draw the afferents of a skin: the rate of each on the skin, and its spikes over time, by class."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from palmfield.outputs.afferents import mean_rates, spikes_of
from palmfield.outputs.pictures.options import Kind, Options, chosen_skin, limits_of
from palmfield.outputs.skin_view import view_of_skin

TITLES = {"sa1": "SA1", "ra1": "RA1", "pc": "PC"}


def receptors(result: xr.DataTree, options: Options) -> Figure:
    """Draw the mean rate of each afferent on the skin, and all spikes below it.

    The afferent with most spikes is on top.
    """
    name, skin = chosen_skin(result, options, "afferent_motion")
    times, classes = skin["time"].values.astype(float), skin["afferent_class"].values
    view, rest = view_of_skin(result, name, skin), skin["rest_position"].values
    # Exact for a body in one piece, and the mean for one that bends
    turn = np.linalg.lstsq(np.column_stack([rest, np.ones(len(rest))]), view.vertices, rcond=None)[0]
    places = 1e3 * (np.column_stack([skin["afferent_position"].values, np.ones(len(classes))]) @ turn)[:, :2]
    fired = spikes_of(skin)
    rates = mean_rates(skin, fired)
    low, high = limits_of(options, 0.0, max(1.0, float(rates.max())))
    figure = Figure(figsize=(0.8 + 3.6 * len(fired), 6.4), layout="constrained")
    axes = figure.subplots(2, len(fired), squeeze=False, height_ratios=(3, 2))
    for (one, (moments, units)), on_skin, over_time in zip(fired.items(), *axes, strict=True):
        own, rate = places[classes == one], rates[classes == one]
        active = rate > 0.0
        on_skin.plot(*own[~active].T, ".", ms=2, color="0.75")
        points = on_skin.scatter(*own[active].T, c=rate[active], s=14, cmap="cividis", vmin=low, vmax=high)
        on_skin.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        on_skin.set_title(f"{TITLES[one]}: {active.sum()} of {len(rate)} fire")
        row = np.empty(len(classes))
        row[np.flatnonzero(classes == one)[np.argsort(rate, kind="stable")]] = np.arange(len(rate)) - (~active).sum()
        over_time.plot(1e3 * moments, row[units], "|", ms=3, color="black")
        over_time.set(xlabel="time [ms]", ylabel="active unit", xlim=(1e3 * times[0], 1e3 * times[-1]))
        over_time.set_ylim(-0.5, max(0.5, active.sum() - 0.5))
        if not len(moments):
            over_time.text(0.5, 0.5, "no spikes", ha="center", va="center", transform=over_time.transAxes)
            over_time.set_yticks([])
    figure.colorbar(points, ax=axes[0], label="mean rate [spikes/s]")
    return figure


KINDS = {
    "receptors": Kind(
        receptors,
        "spikes of the afferents, and their rate on the skin (key receptors)",
        frozenset({"limits", "skin"}),
        "spikes/s",
        place=13,
    ),
}
