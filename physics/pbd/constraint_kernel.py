"""Compiled values, gradients and second derivatives of the constraints.

Liang 2024, section III-B, names distance, volume and shape matching; their forms are those of Müller 2005, Müller 2007
and Macklin 2016, as the paper doesn't say which it uses:

distance  C = |x₁ - x₂| - ℓ₀
volume    C = (x₂ - x₁)×(x₃ - x₁)·(x₄ - x₁)/6 - V₀
shape     C = √(Σ |xᵢ - x̄ - R qᵢ|²), R the rotation that makes it smallest. As R and x̄ are where the sum is smallest,
          its gradient is that with both held: it adds up to no force and to no moment for any masses.

The rotation of a shape is carried along as a quaternion: Newton's method from the last one settles it to rounding in
two or three steps, so that it depends on where it began no more than a singular value decomposition would.
"""

import numpy as np

from palpate.physics.jit import inlined
from palpate.physics.mesh import NORM_GUARD

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
    put(out, index, plus(row(out, index), share, vector))


@inlined
def plus(a, share, b):
    """A vector plus a share of another."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@inlined
def scaled(a, share):
    """A share of a vector."""
    return share * a[0], share * a[1], share * a[2]


@inlined
def less(points, first, second):
    """Difference of two rows of points [N, 3]."""
    return plus(row(points, first), -1.0, row(points, second))


@inlined
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _times(matrix, a):
    """A matrix, by its rows, times a vector."""
    return dot(matrix[0], a), dot(matrix[1], a), dot(matrix[2], a)


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
    """Rᵀ A by columns, A without its rotation."""
    columns = _column(matrix, 0), _column(matrix, 1), _column(matrix, 2)
    x, y, z = _column(rotation, 0), _column(rotation, 1), _column(rotation, 2)
    return _times(columns, x), _times(columns, y), _times(columns, z)


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
    m11, m12, m22 = a * c - e * e, d * e - a * f, a * b - d * d
    return scaled(_times(((m00, m01, m02), (m01, m11, m12), (m02, m12, m22)), right), 1 / determinant), True


@inlined
def _settled(matrix, turn, index):
    """Rotation R that makes tr(Rᵀ A) largest, from `turn[index]` on, which becomes its quaternion."""
    w, x, y, z = turn[index, 0], turn[index, 1], turn[index, 2], turn[index, 3]
    for _ in range(60):
        left = _turned_back(_rotation_of((w, x, y, z)), matrix)
        skew = _axial(left)
        spin, sound = _solved(left, skew)
        if not sound:  # far from the best: uphill, as far as Müller 2016 goes
            spin = scaled(skew, 1 / (abs(left[0][0] + left[1][1] + left[2][2]) + 1e-300))
        a, b, c = scaled(spin, 0.5)
        first, second = w - x * a - y * b - z * c, x + w * a + y * c - z * b
        w, x, y, z = first, second, y + w * b + z * a - x * c, z + w * c + x * b - y * a
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
    return plus(matrix[0], a[0], b), plus(matrix[1], a[1], b), plus(matrix[2], a[2], b)


@inlined
def _moments(starts, members, offsets, points, index):
    """Mean of a shape's points, and A = Σ (xᵢ - x̄) qᵢᵀ."""
    first, last = starts[index], starts[index + 1]
    matrix, mean = _NOTHING, _NOTHING[0]
    for m in range(first, last):
        mean = plus(mean, 1.0, row(points, members[m]))
    mean = scaled(mean, 1.0 / (last - first))
    for m in range(first, last):
        matrix = _grown(matrix, plus(row(points, members[m]), -1.0, mean), row(offsets, m))
    return mean, matrix


@inlined
def stretched(points, one, other, rest):
    """C of a distance, and its gradient by the first particle; that by the other is its negative."""
    apart = less(points, one, other)
    length = np.sqrt(dot(apart, apart) + NORM_GUARD)
    return length - rest, scaled(apart, 1 / length)


@inlined
def stretched_bent(normal, length, apart):
    """Change of a distance's gradient by the first particle, where that moves by `apart` more than the other."""
    return scaled(plus(apart, -dot(normal, apart), normal), 1 / length)


@inlined
def _swelled(points, members, first, rest, slope):
    """C of a volume, and the way from its first particle to the others; its gradient is written to `slope` [M, 3]."""
    one = members[first]
    b, c = less(points, members[first + 1], one), less(points, members[first + 2], one)
    d = less(points, members[first + 3], one)
    by_b, by_c, by_d = scaled(_cross(c, d), 1 / 6), scaled(_cross(d, b), 1 / 6), scaled(_cross(b, c), 1 / 6)
    _put_corners(slope, first, by_b, by_c, by_d)
    return dot(by_d, d) - rest, (b, c, d)


@inlined
def _put_corners(out, first, by_b, by_c, by_d):
    """Rows of a volume, whose sum is none, by the last three."""
    put(out, first + 1, by_b)
    put(out, first + 2, by_c)
    put(out, first + 3, by_d)
    put(out, first, scaled(plus(by_b, 1.0, plus(by_c, 1.0, by_d)), -1.0))


@inlined
def _swelled_bent(first, sides, along, out):
    """Return the energy as `bent` of a volume, by its sides."""
    b, c, d = sides
    db, dc, dd = less(along, first + 1, first), less(along, first + 2, first), less(along, first + 3, first)
    bent_b = scaled(plus(_cross(dc, d), 1.0, _cross(c, dd)), 1 / 6)
    bent_c = scaled(plus(_cross(dd, b), 1.0, _cross(d, db)), 1 / 6)
    _put_corners(out, first, bent_b, bent_c, scaled(plus(_cross(db, c), 1.0, _cross(b, dc)), 1 / 6))


@inlined
def _warped(starts, members, offsets, points, turn, shape, index, slope):
    """C of a shape, and Rᵀ A of its points, R searched from `turn[shape]` on, which becomes its quaternion.

    Its gradient by each member is written to `slope` [M, 3].
    """
    mean, matrix = _moments(starts, members, offsets, points, index)
    rotation = _settled(matrix, turn, shape)
    total = NORM_GUARD
    for m in range(starts[index], starts[index + 1]):
        apart = plus(plus(row(points, members[m]), -1.0, mean), -1.0, _times(rotation, row(offsets, m)))
        total += dot(apart, apart)
        put(slope, m, apart)
    value = np.sqrt(total)
    for m in range(starts[index], starts[index + 1]):
        put(slope, m, scaled(row(slope, m), 1.0 / value))
    return value, _turned_back(rotation, matrix)


@inlined
def met(layout, points, turn, index, slope):
    """C of a volume or a shape, and what `bent` needs of it besides its gradient [3, 3].

    Args:
        layout: a `Layout`.
        points: [N, 3].
        turn: quaternions of the shapes to begin at, [P, 4]; out: those found.
        index: number of the constraint.
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
        layout, index: arguments of `met`.
        quaternion: quaternion of the shape's rotation R.
        left: output of `met`: sides of a volume, Rᵀ A of a shape.
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
    matrix, mean, ahead = _NOTHING, _NOTHING[0], 0.0
    for m in range(first, last):
        way = row(along, m)
        mean = plus(mean, 1.0, way)
        ahead += dot(row(slope, m), way)
        matrix = _grown(matrix, way, row(layout.offsets, m))
    mean = scaled(mean, 1.0 / (last - first))
    spin, _ = _solved(left, _axial(_turned_back(rotation, matrix)))  # none where the rotation isn't determined
    for m in range(first, last):
        swept = _times(rotation, _cross(spin, row(layout.offsets, m)))
        change = plus(plus(plus(row(along, m), -1.0, mean), -1.0, swept), -ahead, row(slope, m))
        put(out, m, scaled(change, 1.0 / value))
