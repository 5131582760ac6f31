"""Total-Lagrangian particles: stress and pair forces, motion, pressure of a spot, displacement at points.

A site is the part of a particle in one material; away from interfaces, sites and particles are identical. All sums are
gathered, without atomic additions, so repeated runs give equal bits.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

vec6 = wp.types.vector(length=6, dtype=wp.float32)


@wp.func
def pack(s: wp.mat33) -> vec6:
    return vec6(s[0, 0], s[1, 1], s[2, 2], s[1, 2], s[0, 2], s[0, 1])


@wp.func
def unpack(s: vec6) -> wp.mat33:
    return wp.mat33(s[0], s[5], s[4], s[5], s[1], s[3], s[4], s[3], s[2])


@wp.func
def scaled_identity(x: wp.float32) -> wp.mat33:
    return wp.mat33(x, 0.0, 0.0, 0.0, x, 0.0, 0.0, 0.0, x)


@wp.func
def deviator(s: wp.mat33) -> wp.mat33:
    return s - scaled_identity(wp.trace(s) / 3.0)


@wp.func
def volume_change(h: wp.mat33) -> wp.float32:
    """Return det(I + h) - 1 without cancellation."""
    minors = (
        h[0, 0] * h[1, 1] - h[0, 1] * h[1, 0]
        + h[0, 0] * h[2, 2] - h[0, 2] * h[2, 0]
        + h[1, 1] * h[2, 2] - h[1, 2] * h[2, 1]
    )  # fmt: skip
    return wp.trace(h) + minors + wp.determinant(h)


@wp.kernel
def site_forces(
    owner: wp.array[wp.int32],
    count: wp.array[wp.int32],
    neighbour: wp.array2d[wp.int32],
    area: wp.array2d[wp.vec3],
    offset: wp.array2d[wp.vec3],
    spring: wp.array2d[wp.float32],
    moment: wp.array[wp.mat33],
    volume: wp.array[wp.float32],
    law: wp.array[wp.int32],
    remembers: wp.array[wp.int32],
    shear: wp.array[wp.float32],
    bulk: wp.array[wp.float32],
    bulk_relaxes: wp.array[wp.int32],
    viscous_time: wp.array[wp.float32],
    ratio: wp.array2d[wp.float32],
    kept: wp.array2d[wp.float32],
    former: wp.array2d[wp.float32],
    present: wp.array2d[wp.float32],
    hourglass: wp.float32,
    displacement: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    memory: wp.array[wp.vec3],
    stress: wp.array[vec6],
    relaxed: wp.array2d[vec6],
    gradient: wp.array[wp.mat33],
    force: wp.array2d[wp.vec3],
):
    """Compute displacement gradient, stress, and the force of each pair on the particle of the site (and its opposite).

    Energy of a site: V psi(I + H) + a G / 2 sum_k s_k |w_k - W X_k|^2, H = sum_k u_k a_k / V, and W is H with w for u.
    """
    s = wp.tid()
    i = owner[s]
    m = law[s]
    inverse_volume = 1.0 / volume[s]
    with_memory = remembers[s]
    h = wp.mat33()
    for k in range(count[s]):
        h += wp.outer(displacement[neighbour[s, k]] - displacement[i], area[s, k])
    h = h * inverse_volume
    gradient[s] = h

    f = scaled_identity(1.0) + h
    inverse = wp.inverse(f)
    change = volume_change(h)
    j = 1.0 + change
    narrowing = wp.pow(j, -2.0 / 3.0)
    shape = deviator(h + wp.transpose(h) + h * wp.transpose(h)) * shear[m]
    pressing = bulk[m] * change * j
    kirchhoff = shape * narrowing + scaled_identity(pressing)
    if viscous_time[m] > 0.0:
        rate = wp.mat33()
        for k in range(count[s]):
            rate += wp.outer(velocity[neighbour[s, k]] - velocity[i], area[s, k])
        rate = rate * inverse * inverse_volume
        dashpot = deviator(rate + wp.transpose(rate)) * shear[m]
        if bulk_relaxes[m] != 0:
            dashpot += scaled_identity(bulk[m] * wp.trace(rate))
        kirchhoff += dashpot * (viscous_time[m] * j)
    if ratio.shape[1] > 0:
        # Over-stress of the branches, driven by the isochoric second Piola stress (Simo 1987).
        drive = shape
        if bulk_relaxes[m] != 0:
            drive = shape * narrowing + scaled_identity(pressing)
        now = pack(inverse * drive * wp.transpose(inverse))
        over = vec6()
        for b in range(ratio.shape[1]):
            inside = kept[m, b] * relaxed[s, b] + former[m, b] * stress[s] + present[m, b] * now
            relaxed[s, b] = inside
            over += ratio[m, b] * (now - inside)
        stress[s] = now
        pushed = f * unpack(over) * wp.transpose(f)
        if bulk_relaxes[m] != 0:
            kirchhoff += pushed
        else:
            kirchhoff += deviator(pushed) * narrowing
    piola = kirchhoff * wp.transpose(inverse)

    # Deviations of pairs from the gradient of the site are penalised; otherwise modes of one spacing have no energy.
    stiffness = hourglass * shear[m]
    w = h
    strays = wp.mat33()
    if with_memory != 0:
        w = wp.mat33()
        for k in range(count[s]):
            n = neighbour[s, k]
            step = (displacement[n] - displacement[i]) + (memory[n] - memory[i])
            w += wp.outer(step, area[s, k])
            strays += wp.outer(step, spring[s, k] * offset[s, k])
        w = w * inverse_volume
    else:
        for k in range(count[s]):
            strays += wp.outer(displacement[neighbour[s, k]] - displacement[i], spring[s, k] * offset[s, k])
    piola = piola - (strays - w * moment[s]) * (stiffness * inverse_volume)
    for k in range(count[s]):
        n = neighbour[s, k]
        step = displacement[n] - displacement[i]
        if with_memory != 0:
            step += memory[n] - memory[i]
        force[s, k] = piola * area[s, k] + (stiffness * spring[s, k]) * (step - w * offset[s, k])


@wp.func
def net_force(
    i: wp.int32,
    site_start: wp.array[wp.int32],
    count: wp.array[wp.int32],
    incoming_count: wp.array[wp.int32],
    incoming: wp.array2d[wp.int32],
    slots: wp.int32,
    force: wp.array2d[wp.vec3],
) -> wp.vec3:
    total = wp.vec3()
    for s in range(site_start[i], site_start[i + 1]):
        for k in range(count[s]):
            total += force[s, k]
    for k in range(incoming_count[i]):
        place = incoming[i, k]
        total -= force[place // slots, place % slots]
    return total


@wp.kernel
def sum_forces(
    site_start: wp.array[wp.int32],
    count: wp.array[wp.int32],
    incoming_count: wp.array[wp.int32],
    incoming: wp.array2d[wp.int32],
    slots: wp.int32,
    force: wp.array2d[wp.vec3],
    total: wp.array[wp.vec3],
):
    i = wp.tid()
    total[i] = net_force(i, site_start, count, incoming_count, incoming, slots, force)


@wp.kernel
def move(
    site_start: wp.array[wp.int32],
    count: wp.array[wp.int32],
    incoming_count: wp.array[wp.int32],
    incoming: wp.array2d[wp.int32],
    slots: wp.int32,
    force: wp.array2d[wp.vec3],
    inverse_mass: wp.array[wp.float32],
    free: wp.array[wp.mat33],
    law: wp.array[wp.int32],
    viscous_time: wp.array[wp.float32],
    ratio: wp.array2d[wp.float32],
    kept: wp.array2d[wp.float32],
    former: wp.array2d[wp.float32],
    present: wp.array2d[wp.float32],
    surface: wp.array[wp.int32],
    face_area: wp.array[wp.vec3],
    pressure: wp.array2d[wp.float32],
    row: wp.int32,
    follower: wp.int32,
    gradient: wp.array[wp.mat33],
    step_s: wp.float32,
    displacement: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    memory: wp.array[wp.vec3],
    relaxed: wp.array2d[wp.vec3],
):
    """Advance by leapfrog: velocity from the present force, displacement from this velocity. memory: displacement of
    the relaxing part minus u."""
    i = wp.tid()
    total = net_force(i, site_start, count, incoming_count, incoming, slots, force)
    face = surface[i]
    s = site_start[i]
    if face >= 0:
        outward = face_area[face]
        if follower != 0:
            # Nanson: an area rotates and stretches by the cofactor of the deformation gradient.
            f = scaled_identity(1.0) + gradient[s]
            outward = wp.transpose(wp.inverse(f)) * outward * wp.determinant(f)
        total -= pressure[row, face] * outward
    v = velocity[i] + (step_s * inverse_mass[i]) * (free[i] * total)
    old = displacement[i]
    new = old + step_s * v
    velocity[i] = v
    displacement[i] = new
    m = law[s]
    excess = viscous_time[m] * v
    for b in range(ratio.shape[1]):
        inside = kept[m, b] * relaxed[i, b] + former[m, b] * old + present[m, b] * new
        relaxed[i, b] = inside
        excess += ratio[m, b] * (new - inside)
    memory[i] = excess


@wp.kernel
def spot_pressure(
    places: wp.array[wp.vec2],
    peak: wp.array[wp.float32],
    centre: wp.array[wp.vec2],
    sharpness: wp.float32,
    pressure: wp.array2d[wp.float32],
):
    """Compute the pressure of a Gaussian spot at the particles of the face [Pa], one row per step."""
    row, face = wp.tid()
    away = places[face] - centre[row]
    pressure[row, face] = peak[row] * wp.exp(-sharpness * wp.dot(away, away))


@wp.kernel
def read_points(
    particles: wp.array2d[wp.int32],
    weights: wp.array2d[wp.float32],
    displacement: wp.array[wp.vec3],
    row: wp.int32,
    result: wp.array2d[wp.vec3],
):
    """Compute the displacement at points as weighted sums over near particles."""
    p = wp.tid()
    total = wp.vec3()
    for k in range(weights.shape[1]):
        total += weights[p, k] * displacement[particles[p, k]]
    result[row, p] = total
