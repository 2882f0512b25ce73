"""Sheets and blocks of particles."""

import numpy as np

from palpate.physics.fem.meshing import box
from palpate.physics.fem.solid import outer_faces
from palpate.physics.pbd.body import Body, make_body


def sheet(rows: int, columns: int, spacing: float = 0.005, *, pinned_rows: int = 0) -> Body:
    """In the plane z = 0, row 0 at y = 0; its first rows pinned."""
    at = np.arange(rows * columns).reshape(rows, columns)
    places = np.stack([*np.meshgrid(np.arange(columns), np.arange(rows)), np.zeros((rows, columns))], axis=-1)
    one, two, three, four = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    odd = (np.add.outer(np.arange(rows - 1), np.arange(columns - 1)) % 2 == 1)[..., None]
    first = np.where(odd, np.stack([one, three, four], -1), np.stack([one, three, two], -1))
    second = np.where(odd, np.stack([one, four, two], -1), np.stack([two, three, four], -1))
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    pinned = np.arange(rows * columns) < pinned_rows * columns
    return make_body(spacing * places.reshape(-1, 3), faces, pinned=pinned)


def block(cells: tuple[int, int, int] = (2, 2, 2), spacing: float = 0.005) -> Body:
    """Tetrahedra that fill a box."""
    nodes, tetrahedra = box((spacing * cells[0], spacing * cells[1], spacing * cells[2]), cells)
    return make_body(nodes, outer_faces(tetrahedra), tetrahedra)
