"""Ray casting of one triangle mesh with smooth normals, soft light and a colour map."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT | {"max_unroll": 1})


@wp.func
def cosine_direction(normal: wp.vec3, u: float, v: float) -> wp.vec3:
    """Return a cosine-weighted direction about `normal` from two numbers in [0, 1)."""
    helper = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(normal[0]) > 0.7:
        helper = wp.vec3(0.0, 1.0, 0.0)
    tangent = wp.normalize(wp.cross(normal, helper))
    bitangent = wp.cross(normal, tangent)
    radius = wp.sqrt(u)
    angle = 6.2831853 * v
    return (
        tangent * (radius * wp.cos(angle))
        + bitangent * (radius * wp.sin(angle))
        + normal * wp.sqrt(wp.max(0.0, 1.0 - u))
    )


@wp.func
def openness(
    mesh: wp.uint64, point: wp.vec3, normal: wp.vec3, reach: float, rays: int, sample: int, samples: int, seed: int
) -> float:
    """Return the share of cosine-weighted rays of length `reach` [m] without a hit (ambient occlusion).

    sample, samples: number of this sample of a pixel, and of all: their rays form one lattice of directions
    seed: number of the pixel, for a random shift of the lattice
    """
    state = wp.rand_init(11, seed)
    u, v = wp.randf(state), wp.randf(state)
    free = wp.float32(0.0)
    for ray in range(rays):
        place = float(sample * rays + ray)
        direction = cosine_direction(normal, (place + u) / float(samples * rays), v + 0.61803399 * place)
        if not wp.mesh_query_ray_anyhit(mesh, point, direction, reach):
            free += 1.0
    return free / float(rays)


@wp.kernel
def open_sky(
    mesh: wp.uint64,
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    reach: float,
    rays: int,
    vertices: wp.array[wp.int32],
    share: wp.array[float],
):
    """Compute the `openness` of some vertices, by number."""
    vertex = vertices[wp.tid()]
    normal = normals[vertex]
    share[vertex] = openness(mesh, points[vertex] + normal * 2.0e-5, normal, reach, rays, 0, 1, vertex)


@wp.kernel
def render(
    mesh: wp.uint64,
    solid: wp.uint64,
    faces: wp.array[wp.int32],
    normals: wp.array[wp.vec3],
    albedo: wp.array[wp.vec3],
    level: wp.array[float],
    gloss: wp.array[float],
    veil: wp.array[float],
    sky_share: wp.array[float],
    lut: wp.array[wp.vec3],
    eye: wp.vec3,
    corner: wp.vec3,
    right: wp.vec3,
    down: wp.vec3,
    key: wp.vec3,
    fill: wp.vec3,
    sky: wp.vec3,
    reach: float,
    width: int,
    height: int,
    supersampling: int,
    rays: int,
    pixels: wp.array[wp.int32],
    image: wp.array[wp.vec3],
):
    """Compute one linear RGB pixel per thread; pixels: numbers of the pixels, by rows.

    mesh: all objects; solid: objects that cast shadows
    faces: vertex of each corner, shape (3 m,); normals: unit, by vertex; albedo: linear RGB, by vertex
    level: position in the colour map, 0 to 1, by vertex, negative to use albedo; gloss: strength of the highlight
    veil: opacity by face, 1 is solid; sky_share: `openness` by vertex, negative to cast rays from each hit
    lut: linear RGB, shape (256,); rays: number of ambient rays of a sample
    eye: camera [m]; corner: from the camera to the top left corner of the image; right, down: sides of one pixel
    key, fill: unit directions towards the lights; sky: unit direction of the brighter half of the ambient light
    reach: length of the ambient rays [m]; image: linear RGB, shape (height * width,)
    """
    pixel = pixels[wp.tid()]
    row = pixel // width
    column = pixel - row * width
    total = wp.vec3(0.0, 0.0, 0.0)
    share = 1.0 / float(supersampling)
    for sample in range(supersampling * supersampling):
        x = float(column) + (float(sample % supersampling) + 0.5) * share
        y = float(row) + (float(sample // supersampling) + 0.5) * share
        direction = wp.normalize(corner + right * x + down * y)
        height_share = (float(row) + 0.5) / float(height)
        backdrop = wp.vec3(0.955, 0.965, 0.98) * (1.0 - height_share) + wp.vec3(0.80, 0.83, 0.87) * height_share
        start = eye
        clear = wp.float32(1.0)
        colour = wp.vec3(0.0, 0.0, 0.0)
        for _ in range(6):
            if clear > 0.02:
                hit = wp.mesh_query_ray(mesh, start, direction, 1.0e3)
                if not hit.result:
                    colour += backdrop * clear
                    clear = 0.0
                else:
                    point = start + direction * hit.t
                    a = faces[3 * hit.face]
                    b = faces[3 * hit.face + 1]
                    c = faces[3 * hit.face + 2]
                    w = 1.0 - hit.u - hit.v
                    normal = wp.normalize(normals[a] * hit.u + normals[b] * hit.v + normals[c] * w)
                    face_normal = hit.normal
                    if wp.dot(face_normal, direction) > 0.0:
                        face_normal = -face_normal
                    if wp.dot(normal, face_normal) < 0.0:
                        normal = -normal
                    paint = albedo[a] * hit.u + albedo[b] * hit.v + albedo[c] * w
                    place = level[a] * hit.u + level[b] * hit.v + level[c] * w
                    if place >= 0.0:
                        paint = lut[wp.clamp(int(place * 255.0 + 0.5), 0, 255)]
                    opacity = veil[hit.face]
                    outside = point + face_normal * 2.0e-5
                    lit = wp.max(0.0, wp.dot(normal, key))
                    shade = wp.float32(1.0)
                    open_here = wp.float32(1.0)
                    if opacity >= 1.0:
                        if lit == 0.0 or wp.mesh_query_ray_anyhit(solid, outside, key, 1.0e3):
                            shade = 0.0
                        open_here = sky_share[a] * hit.u + sky_share[b] * hit.v + sky_share[c] * w
                        if open_here < 0.0:
                            open_here = openness(
                                solid, outside, face_normal, reach, rays, sample, supersampling * supersampling, pixel
                            )
                    ambient = (0.27 + 0.11 * wp.dot(normal, sky)) * open_here
                    soft = 0.20 * wp.max(0.0, wp.dot(normal, fill)) * (0.4 + 0.6 * open_here)
                    light = 0.78 * lit * shade + soft + ambient
                    halfway = wp.normalize(key - direction)
                    glint = gloss[a] * shade * wp.pow(wp.max(0.0, wp.dot(normal, halfway)), 40.0)
                    colour += (paint * light + wp.vec3(glint, glint, glint)) * (clear * opacity)
                    clear *= 1.0 - opacity
                    start = point + direction * 2.0e-5
        total += colour
    image[pixel] = total / float(supersampling * supersampling)
