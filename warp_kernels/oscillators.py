"""Exact steps of damped oscillators under loads that are linear in time or rotate at a constant rate."""

import warp as wp

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": "-march=native -O3 -ffp-contract=fast"})


@wp.func_native(
    snippet="""
    const int count = counts.data[group];
    const double* __restrict sr = poles.data + size_t(group) * 2 * width;
    const double* __restrict si = sr + width;
    const double* __restrict nr = residues.data + size_t(group) * 4 * width;
    const double* __restrict ni = nr + width;
    const double* __restrict lr = ni + width;
    const double* __restrict li = lr + width;
    double* __restrict yr = state.data + size_t(node) * 2 * width;
    double* __restrict yi = yr + width;
    for (int n = 0; n < segments; ++n) {
        #pragma clang fp reassociate(on)
        const double h = durations.data[kind.data[n]];
        const double* __restrict er = decay.data + (size_t(kind.data[n]) * groups + group) * 2 * width;
        const double* __restrict ei = er + width;
        const double* __restrict now = drive.data + (size_t(node) * segments + n) * 7;
        const double fr = now[0], fi = now[1], dr = now[2], di = now[3], cr = now[4], ci = now[5], rate = now[6];
        for (int j = 0; j < count; ++j) {
            const double xr = -sr[j] * h, xi = -(rate + si[j]) * h;
            const double square = xr * xr + xi * xi;
            const double inverse = 1.0 / (square > 1e-6 ? square : 1.0);
            const double ar = cr - er[j], ai = ci - ei[j];
            double pr = (ar * xr + ai * xi) * inverse, pi = (ai * xr - ar * xi) * inverse;
            const double br = cr - pr, bi = ci - pi;
            double qr = (br * xr + bi * xi) * inverse, qi = (bi * xr - br * xi) * inverse;
            const double x2r = xr * xr - xi * xi, x2i = 2.0 * xr * xi;
            const double ur = 1.0 + xr / 2.0 + x2r / 6.0, ui = xi / 2.0 + x2i / 6.0;
            const double vr = 0.5 + xr / 3.0 + x2r / 8.0, vi = xi / 3.0 + x2i / 8.0;
            const bool large = square > 1e-6;
            pr = large ? pr : er[j] * ur - ei[j] * ui;
            pi = large ? pi : er[j] * ui + ei[j] * ur;
            qr = large ? qr : er[j] * vr - ei[j] * vi;
            qi = large ? qi : er[j] * vi + ei[j] * vr;
            const double zr = er[j] * yr[j] - ei[j] * yi[j] + h * (fr * pr - fi * pi + dr * qr - di * qi);
            const double zi = er[j] * yi[j] + ei[j] * yr[j] + h * (fr * pi + fi * pr + dr * qi + di * qr);
            yr[j] = zr;
            yi[j] = zi;
        }
        const int row = rows.data[n];
        if (row < 0) continue;
        // The load at the end of the segment
        const double gr = (fr + dr) * cr - (fi + di) * ci, gi = (fr + dr) * ci + (fi + di) * cr;
        double a = 0.0, b = 0.0, c = 0.0, d = 0.0, e = 0.0, f = 0.0, g = 0.0, k = 0.0;
        for (int j = 0; j < count; ++j) {
            const double wr = sr[j] * yr[j] - si[j] * yi[j] + gr, wi = sr[j] * yi[j] + si[j] * yr[j] + gi;
            a += nr[j] * yr[j] - ni[j] * yi[j];
            b += nr[j] * yi[j] + ni[j] * yr[j];
            c += lr[j] * yr[j] - li[j] * yi[j];
            d += lr[j] * yi[j] + li[j] * yr[j];
            e += nr[j] * wr - ni[j] * wi;
            f += nr[j] * wi + ni[j] * wr;
            g += lr[j] * wr - li[j] * wi;
            k += lr[j] * wi + li[j] * wr;
        }
        double* __restrict to = result.data + (size_t(row) * nodes + node) * 8;
        to[0] = a; to[1] = b; to[2] = c; to[3] = d; to[4] = e; to[5] = f; to[6] = g; to[7] = k;
    }
"""
)
def advance(
    node: wp.int32,
    nodes: wp.int32,
    group: wp.int32,
    groups: wp.int32,
    width: wp.int32,
    segments: wp.int32,
    counts: wp.array(dtype=wp.int32),
    poles: wp.array(dtype=wp.float64),
    residues: wp.array(dtype=wp.float64),
    kind: wp.array(dtype=wp.int32),
    durations: wp.array(dtype=wp.float64),
    decay: wp.array(dtype=wp.float64),
    drive: wp.array(dtype=wp.float64),
    rows: wp.array(dtype=wp.int32),
    state: wp.array(dtype=wp.float64),
    result: wp.array(dtype=wp.float64),
):
    """Advance in C, so that the loop over the poles is vectorised."""
    ...


@wp.kernel
def march(
    nodes: wp.int32,
    groups: wp.int32,
    width: wp.int32,
    segments: wp.int32,
    group: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    poles: wp.array(dtype=wp.float64),
    residues: wp.array(dtype=wp.float64),
    kind: wp.array(dtype=wp.int32),
    durations: wp.array(dtype=wp.float64),
    decay: wp.array(dtype=wp.float64),
    drive: wp.array(dtype=wp.float64),
    rows: wp.array(dtype=wp.int32),
    state: wp.array(dtype=wp.float64),
    result: wp.array(dtype=wp.float64),
):
    """Integrate y_j' = s_j y_j + F over all segments, one node per thread; store u = sum r_j y_j and u' at requested
    segment ends.

    On a segment of length h the load is F = (f + d t / h) e^{-i rate t}, so
    y(h) = e^{sh} y(0) + h (f p + d q) with x = -(i rate + s) h, c = e^{-i rate h}, p = (c - e^{sh}) / x and q = (c - p)
    / x; for |x| < 0.001 their series in x are used.

    group: set of poles of each node, (nodes,); counts: number of poles of each set, (groups,)
    poles: (groups, 2, width), real parts first; residues: (groups, 4, width), of normal and lateral motion
    kind: index of the duration of a segment, (segments,); decay: e^{sh}, (kinds, groups, 2, width)
    drive: f, d, c and rate of each segment, (nodes, segments, 7); rows: result row of its end, or -1, (segments,)
    state: y, (nodes, 2, width); result: u and u', normal and lateral, complex, (rows, nodes, 8)
    """
    node = wp.tid()
    advance(
        node,
        nodes,
        group[node],
        groups,
        width,
        segments,
        counts,
        poles,
        residues,
        kind,
        durations,
        decay,
        drive,
        rows,
        state,
        result,
    )
