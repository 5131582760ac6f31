"""Forces of hexahedral spectral elements: gradient, stress and its divergence, one line of nodes at a time.

Unknowns and quadrature points are the (N + 1)^3 Gauss-Lobatto-Legendre nodes. With A = w J dxi/dx by node (metric 0 to
8, row the reference direction), the weighted gradient of a field is H = A^T grad_ref. The deviatoric stress is computed
from the field `w`, the pressure from the field `u` or `w` (moduli). The pressure is filtered: F removes the highest
Legendre polynomial along each direction, so the pressure is in the space of order N - 1,

    p = F[ K F[J div u] / F[J] ],

which is symmetric, exact for a constant dilatation on any geometry, and for N = 1 the mean dilatation (Nagtegaal, Parks
& Rice 1974; Hughes 1980). The number of constraints is a third of the unknowns, so there is no locking.

A *position* is a node of an element. On the CPU the positions of 16 elements are interleaved, so that one register
contains the same node of 16 elements. On a GPU a thread block has one or a few elements, and a thread one node.
"""

import functools
from string import Template
from typing import Any

import warp as wp

from warp_kernels import FUSED

LANES = 16
"""Number of elements that a CPU thread computes together."""

BLOCK = 128
"""Number of threads of a GPU block."""

READERS = wp.constant(128)
"""Number of threads, after those of the elements, that store the readings."""

CPU_OPTIONS = {"cpu_compiler_flags": FUSED["cpu_compiler_flags"]}


def places(order: int, gpu: bool) -> int:
    """Return the number of positions of an element: its nodes on the CPU, padded to a power of two on a GPU."""
    nodes = (order + 1) ** 3
    return 1 << (nodes - 1).bit_length() if gpu else nodes


CPU_BODY = Template("""
    constexpr int n = $n, P = n * n * n, L = $lanes;
    typedef $real V __attribute__((ext_vector_type($lanes)));
    typedef $real Loose __attribute__((ext_vector_type($lanes), aligned(sizeof($real))));  // anywhere in memory
    const $real* D = derivative.data;
    const $real* top = filter.data;
    const $real* top_w = filter.data + n;
    const $real* weight = filter.data + 2 * n;
    const long count = conn.shape[0], first = long(block) * P * L;
    V x[3][P], s[9][P], d[P], G, K;
    const V mix = *reinterpret_cast<const Loose*>(moduli.data + 2 * moduli.shape[1] + long(block) * L);
    K = *reinterpret_cast<const Loose*>(moduli.data + moduli.shape[1] + long(block) * L);
    G = *reinterpret_cast<const Loose*>(moduli.data + long(block) * L);
    auto metric_at = [&](int row, int q) {
        return *reinterpret_cast<const Loose*>(metric.data + row * count + first + q * L);
    };
    auto gather = [&](auto field, const int* index) {
        for (int q = 0; q < P; ++q)
            for (int l = 0; l < L; ++l) {
                const $real* value = reinterpret_cast<const $real*>(field.data + index[first + q * L + l]);
                for (int c = 0; c < 3; ++c) reinterpret_cast<$real*>(&x[c][q])[l] = value[c];
            }
    };
    auto gradient = [&](int i, int j, int k, V g[3][3]) {
        for (int c = 0; c < 3; ++c) {
            V a = 0, b = 0, e = 0;
            for (int m = 0; m < n; ++m) {
                a += D[i * n + m] * x[c][(m * n + j) * n + k];
                b += D[j * n + m] * x[c][(i * n + m) * n + k];
                e += D[k * n + m] * x[c][(i * n + j) * n + m];
            }
            g[c][0] = a; g[c][1] = b; g[c][2] = e;
        }
    };
    auto reduce = [&]() {
        for (int stride = 1; stride < P; stride *= n)
            for (int r = 0; r < P; ++r)
                if ((r / stride) % n == 0) {
                    V share = 0;
                    for (int m = 0; m < n; ++m) share += top_w[m] * d[r + m * stride];
                    for (int m = 0; m < n; ++m) d[r + m * stride] -= top[m] * share;
                }
    };
    if ($single) {
        gather(w, w_conn.data);
    } else {
        gather(u, conn.data);
        for (int q = 0; q < P; ++q)
            for (int l = 0; l < L; ++l) {
                if (mix[l] == 0) continue;
                const $real* value = reinterpret_cast<const $real*>(w.data + w_conn.data[first + q * L + l]);
                for (int c = 0; c < 3; ++c) reinterpret_cast<$real*>(&x[c][q])[l] = value[c];
            }
    }
    for (int i = 0, q = 0; i < n; ++i)
        for (int j = 0; j < n; ++j)
            for (int k = 0; k < n; ++k, ++q) {
                V g[3][3], sum = 0;
                gradient(i, j, k, g);
                for (int c = 0; c < 3; ++c)
                    for (int r = 0; r < 3; ++r) {
                        sum += metric_at(3 * r + c, q) * g[c][r];
                        if ($single) s[3 * c + r][q] = g[c][r];
                    }
                d[q] = sum / (weight[i] * weight[j] * weight[k]);
            }
    reduce();
    for (int q = 0; q < P; ++q) d[q] *= K * metric_at(10, q);
    reduce();
    if (!$single) gather(w, w_conn.data);
    for (int i = 0, q = 0; i < n; ++i)
        for (int j = 0; j < n; ++j)
            for (int k = 0; k < n; ++k, ++q) {
                V g[3][3], A[9], H[3][3];
                if ($single) {
                    for (int c = 0; c < 3; ++c) for (int r = 0; r < 3; ++r) g[c][r] = s[3 * c + r][q];
                } else {
                    gradient(i, j, k, g);
                }
                for (int r = 0; r < 9; ++r) A[r] = metric_at(r, q);
                for (int c = 0; c < 3; ++c)
                    for (int e = 0; e < 3; ++e) H[c][e] = g[c][0] * A[e] + g[c][1] * A[3 + e] + g[c][2] * A[6 + e];
                const V shear = G * metric_at(9, q), third = (H[0][0] + H[1][1] + H[2][2]) * ($real)(2.0 / 3.0);
                V stress[3][3];
                for (int c = 0; c < 3; ++c)
                    for (int e = 0; e < 3; ++e) stress[c][e] = shear * (H[c][e] + H[e][c]);
                for (int c = 0; c < 3; ++c) stress[c][c] += d[q] - shear * third;
                for (int c = 0; c < 3; ++c)
                    for (int r = 0; r < 3; ++r)
                        s[3 * c + r][q] =
                            A[3 * r] * stress[c][0] + A[3 * r + 1] * stress[c][1] + A[3 * r + 2] * stress[c][2];
            }
    for (int i = 0, q = 0; i < n; ++i)
        for (int j = 0; j < n; ++j)
            for (int k = 0; k < n; ++k, ++q)
                for (int c = 0; c < 3; ++c) {
                    V f = 0;
                    for (int m = 0; m < n; ++m) {
                        f += D[m * n + i] * s[3 * c][(m * n + j) * n + k];
                        f += D[m * n + j] * s[3 * c + 1][(i * n + m) * n + k];
                        f += D[m * n + k] * s[3 * c + 2][(i * n + j) * n + m];
                    }
                    *reinterpret_cast<Loose*>(force.data + c * count + first + q * L) = f;
                }
""")

GPU_BODY = Template("""
    constexpr int n = $n, P = n * n * n, B = $block;
    __shared__ $real s[9][B];
    __shared__ $real d[B];
    __shared__ $real D[n * n];
    __shared__ $real top[3 * n];
    const int t = threadIdx.x, q = t % $places, base = t - q;
    const int i = q / (n * n), j = (q / n) % n, k = q % n;
    const bool live = q < P;
    const long count = conn.shape[0], at = block;
    const int element = block / $places;
    // Within a warp the threads of an element need no block barrier
    auto sync = [&]() {
        if ($places <= 32) __syncwarp(); else __syncthreads();
    };
    const $real G = moduli.data[element], K = moduli.data[moduli.shape[1] + element];
    const $real mix = moduli.data[2 * moduli.shape[1] + element];
    const $real* wv = reinterpret_cast<const $real*>(w.data + w_conn.data[at]);
    const $real* uv = ($single || mix != 0) ? wv : reinterpret_cast<const $real*>(u.data + conn.data[at]);
    $real A[11], g[3][3], H[3][3];
    for (int r = 0; r < 11; ++r) A[r] = metric.data[r * count + at];
    for (int m = t; m < n * n; m += B) D[m] = derivative.data[m];
    for (int m = t; m < 3 * n; m += B) top[m] = filter.data[m];
    for (int c = 0; c < 3; ++c) s[c][t] = uv[c];
    __syncthreads();
    auto gradient = [&]() {
        for (int c = 0; c < 3; ++c) {
            $real a = 0, b = 0, e = 0;
            for (int m = 0; m < n; ++m) {
                a += D[i * n + m] * s[c][base + (m * n + j) * n + k];
                b += D[j * n + m] * s[c][base + (i * n + m) * n + k];
                e += D[k * n + m] * s[c][base + (i * n + j) * n + m];
            }
            g[c][0] = a; g[c][1] = b; g[c][2] = e;
        }
    };
    auto reduce = [&]() {
        for (int r = 0, stride = 1; r < 3; ++r, stride *= n) {
            const int m0 = (q / stride) % n;
            $real share = 0;
            sync();
            if (live)
                for (int m = 0; m < n; ++m) share += top[n + m] * d[t + (m - m0) * stride];
            sync();
            if (live) d[t] -= top[m0] * share;
        }
    };
    if (live) {
        gradient();
        $real sum = 0;
        for (int c = 0; c < 3; ++c) for (int r = 0; r < 3; ++r) sum += A[3 * r + c] * g[c][r];
        d[t] = sum / (top[2 * n + i] * top[2 * n + j] * top[2 * n + k]);
    }
    reduce();
    if (live) d[t] *= K * A[10];
    reduce();
    if (!$single) {
        for (int c = 0; c < 3; ++c) s[c][t] = wv[c];
        sync();
        if (live) gradient();
    }
    sync();
    if (live) {
        for (int c = 0; c < 3; ++c)
            for (int e = 0; e < 3; ++e) H[c][e] = g[c][0] * A[e] + g[c][1] * A[3 + e] + g[c][2] * A[6 + e];
        const $real shear = G * A[9];
        const $real third = (H[0][0] + H[1][1] + H[2][2]) * ($real)(2.0 / 3.0);
        for (int c = 0; c < 3; ++c) {
            $real stress[3];
            for (int e = 0; e < 3; ++e) stress[e] = shear * (H[c][e] + H[e][c]);
            stress[c] += d[t] - shear * third;
            for (int r = 0; r < 3; ++r)
                s[3 * c + r][t] = A[3 * r] * stress[0] + A[3 * r + 1] * stress[1] + A[3 * r + 2] * stress[2];
        }
    }
    sync();
    if (live)
        for (int c = 0; c < 3; ++c) {
            $real f = 0;
            for (int m = 0; m < n; ++m) {
                f += D[m * n + i] * s[3 * c][base + (m * n + j) * n + k];
                f += D[m * n + j] * s[3 * c + 1][base + (i * n + m) * n + k];
                f += D[m * n + k] * s[3 * c + 2][base + (i * n + j) * n + m];
            }
            force.data[c * count + at] = f;
        }
    __syncthreads();
""")


GPU_BODY_1 = Template("""
    // Order 1: the eight nodes of an element are neighbours in a warp and exchange values by shuffles
    const int q = block % 8, element = block / 8;
    const long count = conn.shape[0], at = block;
    const $real* wv = reinterpret_cast<const $real*>(w.data + w_conn.data[at]);
    const $real* uv = reinterpret_cast<const $real*>(u.data + conn.data[at]);
    const $real G = moduli.data[element], K = moduli.data[moduli.shape[1] + element];
    const $real mix = moduli.data[2 * moduli.shape[1] + element];
    $real A[11], own[3], g[3][3], H[3][3], flux[3][3];
    for (int r = 0; r < 11; ++r) A[r] = metric.data[r * count + at];
    // Along direction r the number of the other node differs in this bit; it is ahead if the bit is not set
    const int bit[3] = {4, 2, 1};
    $real half[3];
    for (int r = 0; r < 3; ++r) half[r] = q & bit[r] ? -($real)0.5 : ($real)0.5;
    auto gradient = [&]() {
        for (int c = 0; c < 3; ++c)
            for (int r = 0; r < 3; ++r)
                g[c][r] = half[r] * (__shfl_xor_sync(0xffffffff, own[c], bit[r]) - own[c]);
    };
    auto mean = [&]($real d) {
        for (int r = 0; r < 3; ++r) d = ($real)0.5 * (d + __shfl_xor_sync(0xffffffff, d, bit[r]));
        return d;
    };
    for (int c = 0; c < 3; ++c) own[c] = $single || mix != 0 ? wv[c] : uv[c];
    gradient();
    $real d = 0;
    for (int c = 0; c < 3; ++c) for (int r = 0; r < 3; ++r) d += A[3 * r + c] * g[c][r];
    d = mean(mean(d) * K * A[10]);
    if (!$single) {
        for (int c = 0; c < 3; ++c) own[c] = wv[c];
        gradient();
    }
    for (int c = 0; c < 3; ++c)
        for (int e = 0; e < 3; ++e) H[c][e] = g[c][0] * A[e] + g[c][1] * A[3 + e] + g[c][2] * A[6 + e];
    const $real shear = G * A[9], third = (H[0][0] + H[1][1] + H[2][2]) * ($real)(2.0 / 3.0);
    for (int c = 0; c < 3; ++c) {
        $real stress[3];
        for (int e = 0; e < 3; ++e) stress[e] = shear * (H[c][e] + H[e][c]);
        stress[c] += d - shear * third;
        for (int r = 0; r < 3; ++r)
            flux[c][r] = A[3 * r] * stress[0] + A[3 * r + 1] * stress[1] + A[3 * r + 2] * stress[2];
    }
    for (int c = 0; c < 3; ++c) {
        $real f = 0;
        for (int r = 0; r < 3; ++r)
            f -= half[r] * (flux[c][r] + __shfl_xor_sync(0xffffffff, flux[c][r], bit[r]));
        force.data[c * count + at] = f;
    }
""")


@functools.cache
def point_reading(real: Any) -> Any:
    """Return the function that stores displacement and velocity at points p = first, first + stride ... of a step.

    done: number of completed steps; slots: row of the readings of each step, or -1
    nodes, shares: surface nodes of a point and their weights, (p, n^2); displacement, velocity: by row and point
    """
    vec3 = wp.types.vector(length=3, dtype=real)

    @wp.func
    def read(
        first: wp.int32,
        stride: wp.int32,
        done: wp.int32,
        slots: wp.array(dtype=wp.int32),
        nodes: wp.array2d(dtype=wp.int32),
        shares: wp.array2d(dtype=real),
        u: wp.array(dtype=vec3),
        v: wp.array(dtype=vec3),
        displacement: wp.array2d(dtype=vec3),
        velocity: wp.array2d(dtype=vec3),
    ):
        row = wp.int32(-1)
        if done > 0:
            row = slots[done - 1]
        if row >= 0:
            for p in range(first, nodes.shape[0], stride):
                place = vec3()
                speed = vec3()
                for a in range(nodes.shape[1]):
                    place += shares[p, a] * u[nodes[p, a]]
                    speed += shares[p, a] * v[nodes[p, a]]
                displacement[row, p] = place
                velocity[row, p] = speed

    return read


@functools.cache
def element_forces(order: int, real: Any, single: bool, gpu: bool) -> Any:
    """Return the kernel of internal forces: LANES elements per CPU thread, one node per GPU thread (blocks of BLOCK).

    single: whether every element computes its pressure from `w`, so that `u` is not read
    Arguments of the kernel, for E elements (padded) of Q = places(order, gpu) positions:
    u: displacement [m], shape (nodes,); w: displacement for the shear stress, shape (copies of nodes,)
    conn, w_conn: by position, index into u and w; clock: one number, increased by one at each call
    threads: number of element threads, followed by READERS threads
    done, slots, nodes, shares, v [m/s], displacement, velocity: see point_reading; u is still that of the last step
    metric: shape (11, E Q): A [m^2] (9 rows), 1 / (w J) [1/m^3] and 1 / F[J] [1/m^3]
    moduli: shape (3, E): G [Pa], K [Pa], and 1 if the pressure follows w, 0 if u
    derivative: D of the rule, (n, n); filter: top, top_weights and weights of the rule, (3 n,)
    force: internal force by component and position [N], shape (3, E Q)
    """
    vec3 = wp.types.vector(length=3, dtype=real)
    read = point_reading(real)
    names = {
        "n": order + 1,
        "real": "double" if real is wp.float64 else "float",
        "lanes": LANES,
        "block": max(BLOCK, places(order, True)),
        "places": places(order, True),
        "single": "true" if single else "false",
    }

    body = (GPU_BODY_1 if order == 1 else GPU_BODY) if gpu else CPU_BODY

    @wp.func_native(snippet=body.substitute(names))
    def forces(
        block: wp.int32,
        u: wp.array(dtype=vec3),
        w: wp.array(dtype=vec3),
        conn: wp.array(dtype=wp.int32),
        w_conn: wp.array(dtype=wp.int32),
        metric: wp.array2d(dtype=real),
        moduli: wp.array2d(dtype=real),
        derivative: wp.array2d(dtype=real),
        filter: wp.array(dtype=real),
        force: wp.array2d(dtype=real),
    ): ...

    @wp.kernel(module="unique", module_options={} if gpu else CPU_OPTIONS, enable_backward=False)
    def kernel(
        u: wp.array(dtype=vec3),
        w: wp.array(dtype=vec3),
        conn: wp.array(dtype=wp.int32),
        w_conn: wp.array(dtype=wp.int32),
        metric: wp.array2d(dtype=real),
        moduli: wp.array2d(dtype=real),
        derivative: wp.array2d(dtype=real),
        filter: wp.array(dtype=real),
        force: wp.array2d(dtype=real),
        clock: wp.array(dtype=wp.int32),
        threads: wp.int32,
        done: wp.array(dtype=wp.int32),
        slots: wp.array(dtype=wp.int32),
        nodes: wp.array2d(dtype=wp.int32),
        shares: wp.array2d(dtype=real),
        v: wp.array(dtype=vec3),
        displacement: wp.array2d(dtype=vec3),
        velocity: wp.array2d(dtype=vec3),
    ):
        block = wp.tid()
        if block < threads:
            forces(block, u, w, conn, w_conn, metric, moduli, derivative, filter, force)
            return
        if block == threads:
            clock[0] = clock[0] + 1
        read(block - threads, READERS, done[0], slots, nodes, shares, u, v, displacement, velocity)

    return kernel
