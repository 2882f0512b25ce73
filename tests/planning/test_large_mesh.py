"""What the times of a large mesh are measured on."""

import re

import trimesh

from tests.planning import large_mesh


def test_the_file_holds_a_closed_body_as_long_as_said(tmp_path):
    scene, body = large_mesh.write_scene(tmp_path, 4)
    found = trimesh.load_mesh(tmp_path / "fold.obj")
    assert (scene.name, len(found.faces), found.is_watertight) == ("scene.yaml", 20 * 4**4, True)
    assert 0.115 < found.extents[0] <= 0.12
    assert 0 < found.volume < body.extents.prod()


def test_a_small_one_is_planned_twice(capfd):
    assert large_mesh.main(["--subdivisions", "4"]) == 0
    size, *times = capfd.readouterr().out.splitlines()
    assert size == "5,120 triangles, 12 cm"
    found = [re.fullmatch(r"(\w+): [\d.]+ s, processors [\d.]+ s, the path alone [\d.]+ s", line) for line in times]
    assert [line and line[1] for line in found] == ["first", "again"]
