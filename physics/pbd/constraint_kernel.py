"""Compiled values, gradients and second derivatives of the constraints; equations as in `physics.pbd.constraints`.

The rotation of a shape is carried along as a quaternion: Newton's method from the last one settles it to rounding in
two or three steps, so that it depends on where it began no more than a singular value decomposition would.
"""

from __future__ import annotations

import numpy as np

from physics.jit import inlined
from physics.pbd.body import NORM_GUARD

_TURNS = 60


@inlined
def _less(points, first, second):
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
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _rotation(q):
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
    """Rᵀ A by columns: what is left of A beside its rotation."""
    a, b, c = _column(matrix, 0), _column(matrix, 1), _column(matrix, 2)
    x, y, z = _column(rotation, 0), _column(rotation, 1), _column(rotation, 2)
    return (
        (_dot(x, a), _dot(x, b), _dot(x, c)),
        (_dot(y, a), _dot(y, b), _dot(y, c)),
        (_dot(z, a), _dot(z, b), _dot(z, c)),
    )


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
    for _ in range(_TURNS):
        left = _turned_back(_rotation((w, x, y, z)), matrix)
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
        if a * a + b * b + c * c < 1e-26:
            break
    turn[index, 0], turn[index, 1], turn[index, 2], turn[index, 3] = w, x, y, z
    return _rotation((w, x, y, z))


@inlined
def _moments(layout, points, index):
    """Mean of a shape's points, and A = Σ (xᵢ - x̄) qᵢᵀ."""
    first, last = layout.starts[index], layout.starts[index + 1]
    x, y, z = 0.0, 0.0, 0.0
    for m in range(first, last):
        particle = layout.members[m]
        x += points[particle, 0]
        y += points[particle, 1]
        z += points[particle, 2]
    share = 1.0 / (last - first)
    x, y, z = x * share, y * share, z * share
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(first, last):
        particle = layout.members[m]
        dx, dy, dz = points[particle, 0] - x, points[particle, 1] - y, points[particle, 2] - z
        qx, qy, qz = layout.offsets[m, 0], layout.offsets[m, 1], layout.offsets[m, 2]
        a00 += dx * qx
        a01 += dx * qy
        a02 += dx * qz
        a10 += dy * qx
        a11 += dy * qy
        a12 += dy * qz
        a20 += dz * qx
        a21 += dz * qy
        a22 += dz * qz
    return (x, y, z), ((a00, a01, a02), (a10, a11, a12), (a20, a21, a22))


@inlined
def evaluated(layout, points, turn, index, slope):
    """C of one constraint; its gradient by each member is written to `slope` [M, 3], a shape's rotation to `turn`."""
    first = layout.starts[index]
    if index < layout.firsts[0]:
        x, y, z = _less(points, layout.members[first], layout.members[first + 1])
        length = np.sqrt(x * x + y * y + z * z + NORM_GUARD)
        x, y, z = x / length, y / length, z / length
        slope[first, 0], slope[first, 1], slope[first, 2] = x, y, z
        slope[first + 1, 0], slope[first + 1, 1], slope[first + 1, 2] = -x, -y, -z
        return length - layout.rest[index]
    if index < layout.firsts[1]:
        one = layout.members[first]
        b = _less(points, layout.members[first + 1], one)
        c = _less(points, layout.members[first + 2], one)
        d = _less(points, layout.members[first + 3], one)
        by_b, by_c, by_d = _cross(c, d), _cross(d, b), _cross(b, c)
        for axis in range(3):
            slope[first + 1, axis] = by_b[axis] / 6
            slope[first + 2, axis] = by_c[axis] / 6
            slope[first + 3, axis] = by_d[axis] / 6
            slope[first, axis] = -(by_b[axis] + by_c[axis] + by_d[axis]) / 6
        return _dot(by_d, d) / 6 - layout.rest[index]
    mean, matrix = _moments(layout, points, index)
    r0, r1, r2 = _settled(matrix, turn, index - layout.firsts[1])
    total = NORM_GUARD
    for m in range(first, layout.starts[index + 1]):
        particle = layout.members[m]
        q = layout.offsets[m, 0], layout.offsets[m, 1], layout.offsets[m, 2]
        x = points[particle, 0] - mean[0] - _dot(r0, q)
        y = points[particle, 1] - mean[1] - _dot(r1, q)
        z = points[particle, 2] - mean[2] - _dot(r2, q)
        total += x * x + y * y + z * z
        slope[m, 0], slope[m, 1], slope[m, 2] = x, y, z
    value = np.sqrt(total)
    for m in range(first, layout.starts[index + 1]):
        slope[m, 0] /= value
        slope[m, 1] /= value
        slope[m, 2] /= value
    return value


@inlined
def bent(layout, points, turn, index, slope, value, along, out):
    """Second derivatives of one constraint times a direction: change of its gradient along `along`.

    Args:
        layout … slope: as after `evaluated` at these points.
        value: its C.
        along: direction of each member, [M, 3].
        out: change of the gradient by each member, [M, 3].
    """
    first = layout.starts[index]
    if index < layout.firsts[0]:
        length = value + layout.rest[index]
        n = slope[first, 0], slope[first, 1], slope[first, 2]
        apart = _less(along, first, first + 1)
        ahead = _dot(n, apart)
        for axis in range(3):
            change = (apart[axis] - n[axis] * ahead) / length
            out[first, axis] = change
            out[first + 1, axis] = -change
    elif index < layout.firsts[1]:
        one = layout.members[first]
        b = _less(points, layout.members[first + 1], one)
        c = _less(points, layout.members[first + 2], one)
        d = _less(points, layout.members[first + 3], one)
        db, dc, dd = _less(along, first + 1, first), _less(along, first + 2, first), _less(along, first + 3, first)
        dc_d, c_dd = _cross(dc, d), _cross(c, dd)
        dd_b, d_db = _cross(dd, b), _cross(d, db)
        db_c, b_dc = _cross(db, c), _cross(b, dc)
        for axis in range(3):
            by_b, by_c, by_d = dc_d[axis] + c_dd[axis], dd_b[axis] + d_db[axis], db_c[axis] + b_dc[axis]
            out[first + 1, axis] = by_b / 6
            out[first + 2, axis] = by_c / 6
            out[first + 3, axis] = by_d / 6
            out[first, axis] = -(by_b + by_c + by_d) / 6
    else:
        shape = index - layout.firsts[1]
        rotation = _rotation((turn[shape, 0], turn[shape, 1], turn[shape, 2], turn[shape, 3]))
        matrix = _moments(layout, points, index)[1]
        last = layout.starts[index + 1]
        x, y, z, ahead = 0.0, 0.0, 0.0, 0.0
        a00, a01, a02, a10, a11, a12, a20, a21, a22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for m in range(first, last):
            dx, dy, dz = along[m, 0], along[m, 1], along[m, 2]
            qx, qy, qz = layout.offsets[m, 0], layout.offsets[m, 1], layout.offsets[m, 2]
            x += dx
            y += dy
            z += dz
            ahead += slope[m, 0] * dx + slope[m, 1] * dy + slope[m, 2] * dz
            a00 += dx * qx
            a01 += dx * qy
            a02 += dx * qz
            a10 += dy * qx
            a11 += dy * qy
            a12 += dy * qz
            a20 += dz * qx
            a21 += dz * qy
            a22 += dz * qz
        share = 1.0 / (last - first)
        x, y, z = x * share, y * share, z * share
        left = _turned_back(rotation, matrix)
        moved = _turned_back(rotation, ((a00, a01, a02), (a10, a11, a12), (a20, a21, a22)))
        spin, _ = _solved(left, _axial(moved))  # none where the rotation isn't determined
        for m in range(first, last):
            q = layout.offsets[m, 0], layout.offsets[m, 1], layout.offsets[m, 2]
            swept = _cross(spin, q)
            out[m, 0] = (along[m, 0] - x - _dot(rotation[0], swept) - slope[m, 0] * ahead) / value
            out[m, 1] = (along[m, 1] - y - _dot(rotation[1], swept) - slope[m, 1] * ahead) / value
            out[m, 2] = (along[m, 2] - z - _dot(rotation[2], swept) - slope[m, 2] * ahead) / value
