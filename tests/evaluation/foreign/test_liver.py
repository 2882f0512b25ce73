"""Files of pulled livers: what is read, what is refused, and a frame of the real ones."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.evaluation.foreign.liver import HELD, MESH, judge_pull, read_gmsh, read_pull
from tests.evaluation.foreign.pulls import FORCES, write_mesh, write_pull


def test_a_mesh_is_read_as_it_was_written(tmp_path: Path) -> None:
    nodes, tetrahedra = write_mesh(tmp_path)
    found = read_gmsh(tmp_path / MESH)
    np.testing.assert_array_equal(found[0], nodes)
    np.testing.assert_array_equal(found[1], tetrahedra)


def test_a_sequence_is_read_with_what_lies_beside_it(tmp_path: Path) -> None:
    pull = read_pull(write_pull(tmp_path, "neohookean"))
    assert pull.material.law == "neo_hookean"
    np.testing.assert_array_equal(pull.force, FORCES["neohookean"])
    assert [len(points) for points in pull.points] == [200, 200]
    assert np.isclose(pull.body.rest[pull.pulled, 0], 0.08).all()
    np.testing.assert_allclose(pull.motion, 0, atol=1e-8)


def test_what_is_missing_or_broken_is_named(tmp_path: Path) -> None:
    path = write_pull(tmp_path, "linear")
    other = path.rename(tmp_path / "plastic_s1.npz")
    with pytest.raises(InputError, match="tells no law"):
        read_pull(other)
    other.rename(path)
    (tmp_path / "linear_broken.npz").write_bytes(b"PK\x03\x04")
    with pytest.raises(InputError):
        read_pull(tmp_path / "linear_broken.npz")
    np.savez(tmp_path / "linear_empty.npz", pc=np.zeros((1, 4)))
    with pytest.raises(InputError, match="lacks positions, true_forces, force_vertices"):
        read_pull(tmp_path / "linear_empty.npz")
    (tmp_path / MESH).write_text("$Nodes\n1\n1 0 0\n")
    with pytest.raises(InputError, match="no text mesh of Gmsh's format 2"):
        read_pull(path)
    (tmp_path / HELD).unlink()
    with pytest.raises(InputError, match=f"no {HELD} beside it"):
        read_pull(path)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"positions": np.float64(3)}, "positions holds something else than finite numbers"),
        ({"positions": np.full((2, 112, 3), np.nan)}, "positions holds something else than finite numbers"),
        ({"positions": np.array(["a"])}, "positions holds something else than finite numbers"),
        ({"true_forces": np.zeros((3, 3))}, "don't fit 112 nodes"),
        ({"tool_vertices": np.array([112])}, "tool_vertices are no numbers of the 112 nodes"),
        ({"tool_vertices": np.array([np.nan])}, "tool_vertices are no numbers of the 112 nodes"),
        ({"pc": np.zeros((5, 3))}, r"pc has shape \(5, 3\)"),
        ({"positions": np.zeros((400, 1000, 1000), np.float32)}, "it unpacks to more than 1024 MB"),
    ],
)
def test_a_sequence_that_does_not_fit_is_a_sentence(tmp_path: Path, change: dict, told: str) -> None:
    path = write_pull(tmp_path, "linear")
    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez_compressed(path, **arrays | change)
    with pytest.raises(InputError, match=rf"^linear_s1.npz.*{told}"):
        read_pull(path)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"\xff" * 5000, "it is no text"),
        (b"x" * 5_000_000, "its sections are not as announced"),
        (b"$Nodes\n1\n1e308 0 0 0\n$Elements\n0\n", "its sections are not as announced"),
    ],
)
def test_a_mesh_that_is_none_is_a_sentence_without_its_content(tmp_path: Path, content: bytes, told: str) -> None:
    (tmp_path / MESH).write_bytes(content)
    with pytest.raises(InputError) as refused:
        read_gmsh(tmp_path / MESH)
    assert str(refused.value) == f"{MESH} is no text mesh of Gmsh's format 2 ({told}); export it as that."


def test_a_header_that_numpy_does_not_understand_is_a_sentence(tmp_path: Path) -> None:
    """Its tokenizer, which reads headers of the first versions, has errors of its own."""
    path = write_pull(tmp_path, "linear")
    content = (tmp_path / HELD).read_bytes()
    (tmp_path / HELD).write_bytes(content.replace(b"(", b"["))
    with pytest.raises(InputError, match=f"linear_s1.npz or {HELD} can't be read"):
        read_pull(path)


@pytest.mark.parametrize("name", ["linear_s1.npz", HELD, MESH])
def test_a_pipe_is_not_waited_for(tmp_path: Path, name: str) -> None:
    path = write_pull(tmp_path, "linear")
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=f"{name}.*(no file but a pipe|beside it; put it there)"):
        read_pull(path)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear_s1", "neohookean_s2"])
def test_force_and_modulus_of_a_real_sequences_first_frame(name: str, real_data: Path) -> None:
    found = judge_pull(real_data / "fem_liver" / f"{name}.npz", frames=1)
    assert found["force error, median where above 1 N"] < 1e-3
    assert abs(found["E error, median"]) < 1e-3
    assert found["force error, median where above 1 N with 0.6 mm of noise added"] < 0.1
    assert abs(found["E error, median with 0.6 mm of noise added"]) < 0.15
