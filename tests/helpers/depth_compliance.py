"""What flat sheets give way by at one wavenumber, by the polynomials in depth of `palmfield.skin.fem.depth`."""

import numpy as np

from palmfield.skin.fem.depth import impedance


def depth_compliance(k, f_Hz, sheets, base="bonded"):
    """Normal compliance of the top of sheets on a base [m/Pa], shape (n,): positive when pushed in."""
    return np.linalg.inv(impedance(k, f_Hz, sheets, base))[:, 1, 1].astype(complex)
