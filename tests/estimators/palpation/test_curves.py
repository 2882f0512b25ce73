"""Tables as they come, and what is wrong with some."""

from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.estimators.palpation import read_hold, read_probes


def test_probes_are_sorted_by_depth_and_slips_left_out(tmp_path: Path) -> None:
    rows = ["probe,step,contact_x,contact_y,contact_z,depth_mm,fn_N"]
    rows += [f"7,{step},1,2,3,{depth},{depth / 2}" for step, depth in enumerate((2.0, 0.0, 1.0, 3.0, -61.0))]
    rows += ["8,0,1,2,3,0,0", "8,1,1,2,3,1,nan"]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    (probe,) = read_probes(tmp_path / "a.csv")
    assert probe.name == "7"
    assert probe.depth.tolist() == [0, 1, 2, 3]
    assert probe.force.tolist() == [0, 0.5, 1, 1.5]
    assert probe.place.tolist() == [1, 2, 3]


def test_a_hold_begins_where_the_depth_is_reached(tmp_path: Path) -> None:
    depth = np.minimum(np.maximum(np.arange(30) - 3.0, 0), 10)
    rows = ["t_s,force_N,displacement_mm"] + [f"{i / 10},{5 + d},{7 + d}" for i, d in enumerate(depth)]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    hold = read_hold(tmp_path / "a.csv")
    assert np.flatnonzero(hold.held).tolist() == list(range(13, 30))
    assert hold.force[0] == 0
    assert hold.depth.max() == 10


@pytest.mark.parametrize(
    ("reader", "text", "says"),
    [
        (read_probes, "a,b\n1,2\n", "is no table of probes"),
        (read_probes, "probe,contact_x,contact_y,contact_z,depth_mm,fn_N\n1,0,0,0,1,1\n", "holds no probe"),
        (read_hold, "t_s,force_N,displacement_mm\n" + "0,1,1\n" * 20, "times that don't rise"),
        (read_hold, "t_s,force_N,displacement_mm\n" + "".join(f"{i},1,1\n" for i in range(20)), "shows no indentation"),
        (read_hold, "t_s,force_N,displacement_mm\n" + "".join(f"{i},1,{i}\n" for i in range(20)), "a longer hold"),
    ],
)
def test_what_is_wrong_is_a_sentence(tmp_path: Path, reader, text: str, says: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=says):
        reader(tmp_path / "a.csv")
