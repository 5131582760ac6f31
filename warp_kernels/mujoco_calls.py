"""Loops in C over many mjData, on the CPU: calls of MuJoCo functions, and copies to and from MuJoCo arrays.

The arguments are addresses of functions and of foreign memory; the kernels do not depend on MuJoCo's structs.
"""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)

CALL = """
    typedef void (*function_t)(void*, void*);
    ((function_t)function)((void*)model, (void*)datas[i]);
"""
READ = "return ((double*)source)[offset];"
WRITE = "((double*)target)[offset] = value;"
PUSH = """
    typedef void (*function_t)(void*, void*, const double*, const double*, const double*, int, double*);
    double push[6];
    double point[3];
    for (int k = 0; k < 6; k++) push[k] = forces[6 * row + k];
    for (int k = 0; k < 3; k++) point[k] = ((double*)origins)[3 * body + k];
    ((function_t)function)((void*)model, (void*)data, push, push + 3, point, body, (double*)target);
"""


@wp.func_native(CALL)
def call(function: wp.uint64, model: wp.uint64, datas: wp.array(dtype=wp.uint64), i: wp.int32): ...


@wp.func_native(READ)
def read(source: wp.uint64, offset: wp.int32) -> wp.float64: ...


@wp.func_native(WRITE)
def write(target: wp.uint64, offset: wp.int32, value: wp.float64): ...


@wp.func_native(PUSH)
def push(
    function: wp.uint64,
    model: wp.uint64,
    data: wp.uint64,
    forces: wp.array(dtype=wp.float64),
    row: wp.int32,
    origins: wp.uint64,
    body: wp.int32,
    target: wp.uint64,
): ...


@wp.kernel
def call_each(function: wp.uint64, model: wp.uint64, datas: wp.array(dtype=wp.uint64)):
    """Call a function with a model and each mjData; dim: number of mjData."""
    call(function, model, datas, wp.tid())


@wp.kernel
def take(sources: wp.array(dtype=wp.uint64), offsets: wp.array(dtype=wp.int32), result: wp.array2d(dtype=wp.float64)):
    """Read float64 numbers at some offsets from addresses, shape (w, n); dim: the same."""
    w, i = wp.tid()
    result[w, i] = read(sources[w], offsets[i])


@wp.kernel
def put(targets: wp.array(dtype=wp.uint64), offsets: wp.array(dtype=wp.int32), values: wp.array2d(dtype=wp.float64)):
    """Write float64 numbers (w, n) at some offsets from addresses; dim: (w, n)."""
    w, i = wp.tid()
    write(targets[w], offsets[i], values[w, i])


@wp.kernel
def push_bodies(
    function: wp.uint64,
    model: wp.uint64,
    datas: wp.array(dtype=wp.uint64),
    origins: wp.array(dtype=wp.uint64),
    targets: wp.array(dtype=wp.uint64),
    bodies: wp.array(dtype=wp.int32),
    forces: wp.array(dtype=wp.float64),
):
    """Add forces and torques at the origins of bodies, (w n 6,), to generalised forces, by mj_applyFT; dim: w.

    origins: addresses of body positions; targets: addresses of generalised forces
    """
    w = wp.tid()
    count = bodies.shape[0]
    for i in range(count):
        push(function, model, datas[w], forces, w * count + i, origins[w], bodies[i], targets[w])
