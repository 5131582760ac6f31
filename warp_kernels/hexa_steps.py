"""Kernels for the steps of hexahedral elements: geometry, time step of nodes, loads, readings and largest rates.

Time integration is by central differences: v(+1/2) = v(-1/2) + h a, u += h v(+1/2). A Maxwell branch is stored as
y = u - q. For u linear over the step y <- e y + c h v is exact, e = exp(-h / tau), c = (1 - e) tau / h, c(0) = 0.
"""

import functools
from string import Template
from typing import Any

import warp as wp

from warp_kernels import EXACT
from warp_kernels.hexa import CPU_OPTIONS, LANES, point_reading

NODE_BLOCK = 64
"""Number of threads of a GPU block of nodes, small so that the few nodes of a layer use many processors."""


@functools.cache
def geometry(real: Any) -> Any:
    """Return the kernel of the metric (see hexa.element_forces) without its last row, which needs F; by position.

    x: node positions [m], shape (nodes,); conn: by position; slot: node of the element by position, n^3 and above for
    padding; element: element by position; at: position by element and node, shape (E, n^3); weights: of the rule, (n,)
    volume: w J by position [m^3]; determinant: J by position [m^3], negative in an inverted element
    """
    vec3 = wp.types.vector(length=3, dtype=real)
    mat33 = wp.types.matrix(shape=(3, 3), dtype=real)

    @wp.kernel(module="unique", module_options=EXACT)
    def kernel(
        x: wp.array(dtype=wp.vec3d),
        conn: wp.array(dtype=wp.int32),
        slot: wp.array(dtype=wp.int32),
        element: wp.array(dtype=wp.int32),
        at: wp.array2d(dtype=wp.int32),
        derivative: wp.array2d(dtype=real),
        weights: wp.array(dtype=real),
        metric: wp.array2d(dtype=real),
        volume: wp.array(dtype=real),
        determinant: wp.array(dtype=real),
    ):
        position = wp.tid()
        n = weights.shape[0]
        q = slot[position]
        if q >= n * n * n:
            return
        e = element[position]
        i = q // (n * n)
        j = (q // n) % n
        k = q % n
        here = x[conn[position]]
        slope = mat33()
        for m in range(n):
            # Differences are computed before rounding, because the body may be far from the origin
            a = x[conn[at[e, (m * n + j) * n + k]]] - here
            b = x[conn[at[e, (i * n + m) * n + k]]] - here
            c = x[conn[at[e, (i * n + j) * n + m]]] - here
            for d in range(3):
                slope[d, 0] = slope[d, 0] + derivative[i, m] * real(a[d])
                slope[d, 1] = slope[d, 1] + derivative[j, m] * real(b[d])
                slope[d, 2] = slope[d, 2] + derivative[k, m] * real(c[d])
        r0 = vec3(slope[0, 0], slope[1, 0], slope[2, 0])
        r1 = vec3(slope[0, 1], slope[1, 1], slope[2, 1])
        r2 = vec3(slope[0, 2], slope[1, 2], slope[2, 2])
        weight = weights[i] * weights[j] * weights[k]
        jacobian = wp.dot(r0, wp.cross(r1, r2))
        determinant[position] = jacobian
        volume[position] = weight * jacobian
        c0 = weight * wp.cross(r1, r2)
        c1 = weight * wp.cross(r2, r0)
        c2 = weight * wp.cross(r0, r1)
        for d in range(3):
            metric[d, position] = c0[d]
            metric[3 + d, position] = c1[d]
            metric[6 + d, position] = c2[d]
        metric[9, position] = real(1.0) / (weight * jacobian)

    return kernel


NODE_BODY = Template("""
    constexpr int L = $lanes, T = $together;
    typedef $real Real;
    const int first = block * L, step = clock.data[0] - 1, begin = starts.data[block], end = starts.data[block + 1];
    const long count = force.shape[1], copies = strain.shape[1];
    Real* U = reinterpret_cast<Real*>(u.data) + 3 * first;
    Real* V = reinterpret_cast<Real*>(v.data) + 3 * first;
    Real* W = reinterpret_cast<Real*>(w.data);
    // A GPU thread waits only for memory, so data that do not depend on the forces are loaded before them
    Real moved[3 * L], speed[3 * L], keep[L], push[L], y[3 * L], f[3][L] = {};
    int row[L];
    for (int m = 0; m < 3 * L; ++m) moved[m] = U[m], speed[m] = V[m];
    for (int m = 0; m < 3 * L; ++m) y[m] = reinterpret_cast<Real*>(strain.data + first)[m];
    for (int l = 0; l < L; ++l) keep[l] = pace.data[first + l][0], push[l] = pace.data[first + l][1];
    for (int l = 0; l < L; ++l) row[l] = held.data[first + l];
    for (int l = 0; l < L && first + l < areas.shape[0]; ++l) {
        const int i = first + l;
        Real pressure;
        if ($moving) {
            const Real x = places.data[i][0] - spot.data[step][1], y = places.data[i][1] - spot.data[step][2];
            pressure = spot.data[step][0] * Real(exp(-spread * (x * x + y * y)));
        } else {
            const Real* pressures = frames.data + long(frame.data[step]) * frames.shape[1];
            pressure = pressures[i] + share.data[step] * (pressures[frames.shape[1] + i] - pressures[i]);
        }
        for (int c = 0; c < 3; ++c) f[c][l] = -pressure * areas.data[i][c];
    }
    for (int s = begin; s < end; s += T) {
        int source[T * L];
        for (int k = 0; k < T; ++k)
            for (int l = 0; l < L; ++l) source[k * L + l] = T == 1 || s + k < end ? sources.data[(s + k) * L + l] : -1;
        for (int k = 0; k < T; ++k)
            for (int l = 0; l < L; ++l)
                for (int c = 0; c < 3; ++c)
                    f[c][l] -= T == 1 || s + k < end ? force.data[c * count + source[k * L + l]] : Real(0);
    }
    for (int l = 0; l < L; ++l) {
        Real mine[3];
        if (row[l] < 0) {
            for (int c = 0; c < 3; ++c) mine[c] = keep[l] * speed[3 * l + c] + push[l] * f[c][l];
        } else {
            Real total[3];
            for (int c = 0; c < 3; ++c) {
                total[c] = f[c][l];
                for (int d = 0; d < 3; ++d) total[c] -= spring33.data[row[l]].data[c][d] * moved[3 * l + d];
            }
            for (int c = 0; c < 3; ++c) {
                mine[c] = 0;
                for (int d = 0; d < 3; ++d)
                    mine[c] += keep33.data[row[l]].data[c][d] * speed[3 * l + d]
                             + push33.data[row[l]].data[c][d] * total[d];
            }
        }
        for (int c = 0; c < 3; ++c) speed[3 * l + c] = mine[c];
    }
    for (int m = 0; m < 3 * L; ++m) {
        moved[m] += step_s * speed[m];
        V[m] = speed[m];
        U[m] = moved[m];
    }
    if ($one_law) {
        for (int m = 0; m < 3 * L; ++m) moved[m] += viscous.data[0] * speed[m];
        for (int b = 0; b < branches.shape[0]; ++b) {
            Real* own = reinterpret_cast<Real*>(strain.data + b * copies + first);
            const Real e = branches.data[b][0], ch = branches.data[b][1], g = branches.data[b][2];
            for (int m = 0; m < 3 * L; ++m) {
                own[m] = e * y[m] + ch * speed[m];
                moved[m] += g * own[m];
            }
            if (b + 1 == branches.shape[0]) break;
            for (int m = 0; m < 3 * L; ++m) y[m] = reinterpret_cast<Real*>(strain.data + (b + 1) * copies + first)[m];
        }
        for (int m = 0; m < 3 * L; ++m) W[3 * first + m] = moved[m];
    } else {
        for (int l = 0; l < L; ++l)
            for (int copy = copy_starts.data[first + l]; copy < copy_starts.data[first + l + 1]; ++copy) {
                const int law = copy_laws.data[copy];
                Real total[3];
                for (int c = 0; c < 3; ++c) total[c] = moved[3 * l + c] + viscous.data[law] * speed[3 * l + c];
                for (int b = laws.data[law][0], k = 0; b < laws.data[law][1]; ++b, ++k) {
                    Real* own = reinterpret_cast<Real*>(strain.data + k * copies + copy);
                    for (int c = 0; c < 3; ++c) {
                        own[c] = branches.data[b][0] * own[c] + branches.data[b][1] * speed[3 * l + c];
                        total[c] += branches.data[b][2] * own[c];
                    }
                }
                for (int c = 0; c < 3; ++c) W[3 * copy + c] = total[c];
            }
    }
""")


@functools.cache
def node_step(real: Any, moving: bool, one_law: bool, gpu: bool) -> Any:
    """Return the kernel of the step of nodes: force summed in a fixed order, load, constraint, motion, copies.

    A thread computes LANES nodes on the CPU, one on a GPU. Arrays by node are padded to whole threads.
    moving: whether the load is a Gaussian spot; otherwise it is given by frames
    one_law: whether all elements have the same relaxation law; then copies are nodes
    starts, sources: by thread, rows of `sources` (flat) with a position to sum for every lane; lanes with fewer
        positions have positions without force
    areas: outward area of the surface nodes, which are the first nodes [m^2], shape (surface,); places: x and y [m]
    spot: by step, peak [Pa] and x, y of the centre [m]; spread: 4 ln 2 / fwhm^2 [1/m^2]
    frames: pressure by frame and surface node [Pa]; frame: frame of each step; share: weight of the next frame
    pace: by node, keep [1] and push [s/kg] of v <- keep v + push f
    held: row of the three matrices for nodes that are fixed or damped in some directions, or -1
    keep33, push33, spring33: matrices as keep and push, and a spring [N/m]
    copy_starts, copy_laws: copies of a node, one for each relaxation law of its elements, csr
    laws: by law, first and last branch; branches: by branch, e, c h [s], g; viscous: by law, eta / G [s]
    strain: y by branch of the law and copy [m]; w: displacement for the shear stress, by copy [m]
    clock: number of started steps; done: number of completed steps, including this one
    """
    vec3 = wp.types.vector(length=3, dtype=real)
    vec2 = wp.types.vector(length=2, dtype=real)
    mat33 = wp.types.matrix(shape=(3, 3), dtype=real)
    names = {
        "lanes": 1 if gpu else LANES,
        "real": "double" if real is wp.float64 else "float",
        "moving": "true" if moving else "false",
        "one_law": "true" if one_law else "false",
        # Number of forces loaded together by a GPU thread; a node of a layer has 6 to 12
        "together": 8 if gpu else 1,
    }

    @wp.func_native(snippet=NODE_BODY.substitute(names))
    def advance(
        block: wp.int32,
        starts: wp.array(dtype=wp.int32),
        sources: wp.array(dtype=wp.int32),
        force: wp.array2d(dtype=real),
        areas: wp.array(dtype=vec3),
        places: wp.array(dtype=vec2),
        spot: wp.array(dtype=vec3),
        spread: real,
        frames: wp.array2d(dtype=real),
        frame: wp.array(dtype=wp.int32),
        share: wp.array(dtype=real),
        pace: wp.array(dtype=vec2),
        held: wp.array(dtype=wp.int32),
        keep33: wp.array(dtype=mat33),
        push33: wp.array(dtype=mat33),
        spring33: wp.array(dtype=mat33),
        copy_starts: wp.array(dtype=wp.int32),
        copy_laws: wp.array(dtype=wp.int32),
        laws: wp.array(dtype=wp.vec2i),
        branches: wp.array(dtype=vec3),
        viscous: wp.array(dtype=real),
        step_s: real,
        u: wp.array(dtype=vec3),
        v: wp.array(dtype=vec3),
        w: wp.array(dtype=vec3),
        strain: wp.array2d(dtype=vec3),
        clock: wp.array(dtype=wp.int32),
    ): ...

    @wp.kernel(module="unique", module_options={} if gpu else CPU_OPTIONS, enable_backward=False)
    def kernel(
        starts: wp.array(dtype=wp.int32),
        sources: wp.array(dtype=wp.int32),
        force: wp.array2d(dtype=real),
        areas: wp.array(dtype=vec3),
        places: wp.array(dtype=vec2),
        spot: wp.array(dtype=vec3),
        spread: real,
        frames: wp.array2d(dtype=real),
        frame: wp.array(dtype=wp.int32),
        share: wp.array(dtype=real),
        pace: wp.array(dtype=vec2),
        held: wp.array(dtype=wp.int32),
        keep33: wp.array(dtype=mat33),
        push33: wp.array(dtype=mat33),
        spring33: wp.array(dtype=mat33),
        copy_starts: wp.array(dtype=wp.int32),
        copy_laws: wp.array(dtype=wp.int32),
        laws: wp.array(dtype=wp.vec2i),
        branches: wp.array(dtype=vec3),
        viscous: wp.array(dtype=real),
        step_s: real,
        u: wp.array(dtype=vec3),
        v: wp.array(dtype=vec3),
        w: wp.array(dtype=vec3),
        strain: wp.array2d(dtype=vec3),
        clock: wp.array(dtype=wp.int32),
        done: wp.array(dtype=wp.int32),
    ):
        block = wp.tid()
        advance(
            block,
            starts,
            sources,
            force,
            areas,
            places,
            spot,
            spread,
            frames,
            frame,
            share,
            pace,
            held,
            keep33,
            push33,
            spring33,
            copy_starts,
            copy_laws,
            laws,
            branches,
            viscous,
            step_s,
            u,
            v,
            w,
            strain,
            clock,
        )
        if block == 0:
            done[0] = clock[0]

    return kernel


@functools.cache
def reading(real: Any) -> Any:
    """Return the kernel of hexa.point_reading for the last step; one thread per point."""
    vec3 = wp.types.vector(length=3, dtype=real)
    read = point_reading(real)

    @wp.kernel(module="unique", module_options=EXACT)
    def kernel(
        done: wp.array(dtype=wp.int32),
        slots: wp.array(dtype=wp.int32),
        nodes: wp.array2d(dtype=wp.int32),
        shares: wp.array2d(dtype=real),
        u: wp.array(dtype=vec3),
        v: wp.array(dtype=vec3),
        displacement: wp.array2d(dtype=vec3),
        velocity: wp.array2d(dtype=vec3),
    ):
        read(wp.tid(), nodes.shape[0], done[0], slots, nodes, shares, u, v, displacement, velocity)

    return kernel


@functools.cache
def power_step(real: Any) -> Any:
    """Return the kernel of a power iteration in each element: x <- M^-1 K x, normalised; one thread per element.

    at: positions of the nodes of an element, shape (E, n^3); force: K x by component and position; mass: by position
    [kg]; x: by position, of unit length in the mass of the element; rate: x K x by element [1/s^2], a lower bound of
    the largest eigenvalue
    """
    vec3 = wp.types.vector(length=3, dtype=real)

    @wp.kernel(module="unique", module_options=EXACT)
    def kernel(
        at: wp.array2d(dtype=wp.int32),
        force: wp.array2d(dtype=real),
        mass: wp.array(dtype=real),
        x: wp.array(dtype=vec3),
        rate: wp.array(dtype=real),
    ):
        e = wp.tid()
        product = real(0.0)
        square = real(0.0)
        for q in range(at.shape[1]):
            p = at[e, q]
            f = vec3(force[0, p], force[1, p], force[2, p])
            product += wp.dot(x[p], f)
            square += wp.dot(f, f) / mass[p]
        rate[e] = product
        scale = real(1.0) / wp.sqrt(square)
        for q in range(at.shape[1]):
            p = at[e, q]
            x[p] = vec3(force[0, p], force[1, p], force[2, p]) * (scale / mass[p])

    return kernel
