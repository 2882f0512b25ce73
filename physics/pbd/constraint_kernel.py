"""Compiled values, gradients and second derivatives of the constraints.

Liang 2024, section III-B, names distance, volume and shape matching; their forms are those of Müller 2005, Müller 2007
and Macklin 2016, as the paper doesn't say which it uses:

distance  C = |x₁ - x₂| - ℓ₀
volume    C = (x₂ - x₁)×(x₃ - x₁)·(x₄ - x₁)/6 - V₀
shape     C = √(Σ |xᵢ - x̄ - R qᵢ|²), R the rotation that makes it smallest. As R and x̄ are where the sum is smallest,
          its gradient is that with both held: it adds up to no force and to no moment, whatever the masses.

The rotation of a shape is carried along as a quaternion: Newton's method from the last one settles it to rounding in
two or three steps, so that it depends on where it began no more than a singular value decomposition would.
"""

import numpy as np

from palpate.physics.jit import inlined
from palpate.physics.pbd.body import NORM_GUARD

_NOTHING = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@inlined
def row(values, index):
    """A row of values [N, 3]."""
    return values[index, 0], values[index, 1], values[index, 2]


@inlined
def put(out, index, vector):
    """Make a vector a row of `out` [N, 3]."""
    out[index, 0], out[index, 1], out[index, 2] = vector


@inlined
def add(out, index, share, vector):
    """Add a share of a vector to a row of `out` [N, 3]."""
    out[index, 0] += share * vector[0]
    out[index, 1] += share * vector[1]
    out[index, 2] += share * vector[2]


@inlined
def less(points, first, second):
    """Difference of two rows of points [N, 3]."""
    return (
        points[first, 0] - points[second, 0],
        points[first, 1] - points[second, 1],
        points[first, 2] - points[second, 2],
    )


@inlined
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _sum(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _sixth(a):
    return a[0] / 6, a[1] / 6, a[2] / 6


@inlined
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _rotation_of(q):
    """Rows of the matrix of a unit quaternion."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@inlined
def _column(matrix, index):
    return matrix[0][index], matrix[1][index], matrix[2][index]


@inlined
def _turned_back(rotation, matrix):
    """Rᵀ A by columns: what is left of A besides its rotation."""
    a, b, c = _column(matrix, 0), _column(matrix, 1), _column(matrix, 2)
    x, y, z = _column(rotation, 0), _column(rotation, 1), _column(rotation, 2)
    return ((dot(x, a), dot(x, b), dot(x, c)), (dot(y, a), dot(y, b), dot(y, c)), (dot(z, a), dot(z, b), dot(z, c)))


@inlined
def _axial(s):
    """Twice the axial vector of a matrix's skew part."""
    return s[2][1] - s[1][2], s[0][2] - s[2][0], s[1][0] - s[0][1]


@inlined
def _solved(s, right):
    """(tr S - S)⁻¹ right with S made symmetric, and whether that matrix is positive definite: R is then the best."""
    a, b, c = s[1][1] + s[2][2], s[0][0] + s[2][2], s[0][0] + s[1][1]
    d, e, f = -0.5 * (s[0][1] + s[1][0]), -0.5 * (s[0][2] + s[2][0]), -0.5 * (s[1][2] + s[2][1])
    m00, m01, m02 = b * c - f * f, e * f - d * c, d * f - b * e
    determinant = a * m00 + d * m01 + e * m02
    sound = a > 0.0 and a * b - d * d > 0.0 and determinant > 1e-30 * (a + b + c) ** 3
    if not sound:
        return (0.0, 0.0, 0.0), False
    x, y, z = right
    m11, m12, m22 = a * c - e * e, d * e - a * f, a * b - d * d
    return (
        (m00 * x + m01 * y + m02 * z) / determinant,
        (m01 * x + m11 * y + m12 * z) / determinant,
        (m02 * x + m12 * y + m22 * z) / determinant,
    ), True


@inlined
def _settled(matrix, turn, index):
    """Rotation R that makes tr(Rᵀ A) largest, from `turn[index]` on, which becomes its quaternion."""
    w, x, y, z = turn[index, 0], turn[index, 1], turn[index, 2], turn[index, 3]
    for _ in range(60):
        left = _turned_back(_rotation_of((w, x, y, z)), matrix)
        skew = _axial(left)
        spin, sound = _solved(left, skew)
        if not sound:  # far from the best: uphill, as far as Müller 2016 goes
            size = abs(left[0][0] + left[1][1] + left[2][2]) + 1e-300
            spin = skew[0] / size, skew[1] / size, skew[2] / size
        a, b, c = 0.5 * spin[0], 0.5 * spin[1], 0.5 * spin[2]
        w, x, y, z = (
            w - x * a - y * b - z * c,
            x + w * a + y * c - z * b,
            y + w * b + z * a - x * c,
            z + w * c + x * b - y * a,
        )
        scale = 1 / np.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w * scale, x * scale, y * scale, z * scale
        # Square of half a turn after which another would be its square: below rounding.
        if a * a + b * b + c * c < 1e-16:
            break
    turn[index, 0], turn[index, 1], turn[index, 2], turn[index, 3] = w, x, y, z
    return _rotation_of((w, x, y, z))


@inlined
def _grown(matrix, a, b):
    """A matrix plus a bᵀ."""
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = matrix
    return (
        (m00 + a[0] * b[0], m01 + a[0] * b[1], m02 + a[0] * b[2]),
        (m10 + a[1] * b[0], m11 + a[1] * b[1], m12 + a[1] * b[2]),
        (m20 + a[2] * b[0], m21 + a[2] * b[1], m22 + a[2] * b[2]),
    )


@inlined
def _moments(starts, members, offsets, points, index):
    """Mean of a shape's points, and A = Σ (xᵢ - x̄) qᵢᵀ."""
    first, last = starts[index], starts[index + 1]
    x, y, z = 0.0, 0.0, 0.0
    for m in range(first, last):
        particle = members[m]
        x += points[particle, 0]
        y += points[particle, 1]
        z += points[particle, 2]
    share = 1.0 / (last - first)
    x, y, z = x * share, y * share, z * share
    matrix = _NOTHING
    for m in range(first, last):
        particle = members[m]
        apart = points[particle, 0] - x, points[particle, 1] - y, points[particle, 2] - z
        matrix = _grown(matrix, apart, row(offsets, m))
    return (x, y, z), matrix


@inlined
def stretched(points, one, other, rest):
    """C of a distance, and its gradient by the first particle; that by the other is its negative."""
    x, y, z = less(points, one, other)
    length = np.sqrt(x * x + y * y + z * z + NORM_GUARD)
    return length - rest, (x / length, y / length, z / length)


@inlined
def stretched_bent(normal, length, apart):
    """Change of a distance's gradient by the first particle, where that moves by `apart` more than the other."""
    ahead = dot(normal, apart)
    return (
        (apart[0] - normal[0] * ahead) / length,
        (apart[1] - normal[1] * ahead) / length,
        (apart[2] - normal[2] * ahead) / length,
    )


@inlined
def _swelled(points, members, first, rest, slope):
    """C of a volume, and the way from its first particle to the others; its gradient is written to `slope` [M, 3]."""
    one = members[first]
    b, c = less(points, members[first + 1], one), less(points, members[first + 2], one)
    d = less(points, members[first + 3], one)
    by_b, by_c, by_d = _sixth(_cross(c, d)), _sixth(_cross(d, b)), _sixth(_cross(b, c))
    _put_corners(slope, first, by_b, by_c, by_d)
    return dot(by_d, d) - rest, (b, c, d)


@inlined
def _put_corners(out, first, by_b, by_c, by_d):
    """Rows of a volume, whose sum is none, by the last three."""
    put(out, first + 1, by_b)
    put(out, first + 2, by_c)
    put(out, first + 3, by_d)
    both = _sum(by_b, _sum(by_c, by_d))
    put(out, first, (-both[0], -both[1], -both[2]))


@inlined
def _swelled_bent(first, sides, along, out):
    """Return the energy as `bent` of a volume, by its sides."""
    b, c, d = sides
    db, dc, dd = less(along, first + 1, first), less(along, first + 2, first), less(along, first + 3, first)
    bent_b = _sixth(_sum(_cross(dc, d), _cross(c, dd)))
    bent_c = _sixth(_sum(_cross(dd, b), _cross(d, db)))
    _put_corners(out, first, bent_b, bent_c, _sixth(_sum(_cross(db, c), _cross(b, dc))))


@inlined
def _warped(starts, members, offsets, points, turn, shape, index, slope):
    """C of a shape, and Rᵀ A of its points, R searched from `turn[shape]` on, which becomes its quaternion.

    Its gradient by each member is written to `slope` [M, 3].
    """
    mean, matrix = _moments(starts, members, offsets, points, index)
    rotation = _settled(matrix, turn, shape)
    total = NORM_GUARD
    for m in range(starts[index], starts[index + 1]):
        particle = members[m]
        q = row(offsets, m)
        x = points[particle, 0] - mean[0] - dot(rotation[0], q)
        y = points[particle, 1] - mean[1] - dot(rotation[1], q)
        z = points[particle, 2] - mean[2] - dot(rotation[2], q)
        total += x * x + y * y + z * z
        put(slope, m, (x, y, z))
    value = np.sqrt(total)
    share = 1.0 / value
    for m in range(starts[index], starts[index + 1]):
        slope[m, 0] *= share
        slope[m, 1] *= share
        slope[m, 2] *= share
    return value, _turned_back(rotation, matrix)


@inlined
def met(layout, points, turn, index, slope):
    """C of a volume or a shape, and what `bent` needs of it besides its gradient [3, 3].

    Args:
        layout: a `Layout`.
        points: [N, 3].
        turn: quaternions of the shapes to begin at, [P, 4]; out: those found.
        index: of the constraint.
        slope: out, its gradient by each member, [M, 3].
    """
    starts, members, rest, offsets, firsts = layout
    if index < firsts[1]:
        return _swelled(points, members, starts[index], rest[index], slope)
    return _warped(starts, members, offsets, points, turn, index - firsts[1], index, slope)


@inlined
def bent(layout, index, quaternion, left, slope, value, along, out):
    """Change of the gradient of a volume or a shape by each member, [M, 3], where members move by `along` [M, 3].

    Args:
        layout, index: as in `met`.
        quaternion: of the shape's rotation R.
        left: what `met` gave: sides of a volume, Rᵀ A of a shape.
        slope: its gradient by each member, [M, 3].
        value: its C.
        along: direction of each member, [M, 3].
        out: change of the gradient by each member, [M, 3].
    """
    first, last = layout.starts[index], layout.starts[index + 1]
    if index < layout.firsts[1]:
        _swelled_bent(first, left, along, out)
        return
    rotation = _rotation_of(quaternion)
    x, y, z, ahead = 0.0, 0.0, 0.0, 0.0
    matrix = _NOTHING
    for m in range(first, last):
        way = row(along, m)
        x, y, z = x + way[0], y + way[1], z + way[2]
        ahead += dot(row(slope, m), way)
        matrix = _grown(matrix, way, row(layout.offsets, m))
    share = 1.0 / (last - first)
    x, y, z = x * share, y * share, z * share
    moved = _turned_back(rotation, matrix)
    spin, _ = _solved(left, _axial(moved))  # none where the rotation isn't determined
    over = 1.0 / value
    for m in range(first, last):
        swept = _cross(spin, row(layout.offsets, m))
        out[m, 0] = (along[m, 0] - x - dot(rotation[0], swept) - slope[m, 0] * ahead) * over
        out[m, 1] = (along[m, 1] - y - dot(rotation[1], swept) - slope[m, 1] * ahead) * over
        out[m, 2] = (along[m, 2] - z - dot(rotation[2], swept) - slope[m, 2] * ahead) * over
