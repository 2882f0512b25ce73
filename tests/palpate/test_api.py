"""The public face: the same numbers as the program's, and sentences for what can't be done."""

import importlib
import pydoc
import re
from pathlib import Path

import numpy as np
import pytest

import palpate
from palpate.cli import infer
from palpate.data.synthetic.clip import write_clip
from tests.tables import read_rows
from tests.test_infer import SCENE


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clips"), 1, SCENE, 3)


@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize("name", ["network", "direct"])
def test_estimate_gives_the_numbers_that_the_program_writes(clip: Path, tmp_path: Path, name: str) -> None:
    found = palpate.estimate(clip, palpate.open_estimator(name, onset="stamp"))
    options = ["--estimator", name, "--onset", "stamp", "--no-overlay"]
    assert infer.main([str(clip), "--output", str(tmp_path), *options]) == 0
    rows = read_rows(tmp_path / clip.name / "interactions.csv")
    assert [run.onset_frame for run in found] == [int(row["onset_frame"]) for row in rows]
    assert [run.verdict for run in found] == [row["verdict"] for row in rows]
    for run, row in zip(found, rows, strict=True):
        kinds = type(run), type(run.interaction), type(run.estimate)
        assert kinds == (palpate.InteractionEstimate, palpate.Interaction, palpate.PressResult)
        written = [float(row[column]) for column in ("stiffness", "damping", "force")]
        np.testing.assert_allclose(np.abs(run.estimate.theta), written, rtol=1e-5)


def test_an_opened_estimator_serves_many_clips_and_an_opened_clip_is_taken_as_it_is(clip: Path) -> None:
    """And the simulator is one call away from what is told of it."""
    estimator = palpate.open_estimator("network", onset="stamp")
    (run,) = palpate.estimate(clip, estimator)
    (again,) = palpate.estimate(palpate.open_clip(clip, estimator), estimator)
    np.testing.assert_array_equal(run.estimate.theta, again.estimate.theta)
    contact, mechanics = run.interaction, palpate.Mechanics()
    path = palpate.simulate(run.estimate.theta, contact.mesh, contact.load, mechanics)
    assert path.shape == (contact.load.steps, 3)
    assert (path @ contact.load.direction).min() < -0.005  # it is pressed in


@pytest.mark.parametrize(
    ("choices", "error", "sentence"),
    [
        ({"mask": "automatic"}, TypeError, "unexpected keyword argument 'mask'"),
        ({"depth": "nonsense"}, ValueError, "'nonsense' is no depth preset"),
        ({"layout": "missing.yaml"}, ValueError, r"missing\.yaml"),
    ],
)
def test_a_choice_that_cannot_be_used_is_a_sentence(clip, choices, error, sentence) -> None:
    with pytest.raises(error, match=sentence):
        palpate.estimate(clip, **choices)


def test_help_shows_the_public_functions_and_no_module_takes_their_place() -> None:
    shown = pydoc.plain(pydoc.render_doc(palpate))
    assert all(f"\n    {name}(" in shown for name in ("estimate", "calibrate", "plan", "simulate"))
    assert re.search(r"\nVERSION\n    \d+\.\d+", shown)
    assert set(dir(palpate)) >= {"estimate", "calibrate", "plan", "PressResult", "__version__"}
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("palpate.calibrate")
    assert callable(palpate.calibrate)


def test_choices_of_an_open_clip_a_missing_one_and_an_unknown_estimator_are_sentences(clip, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="the clip is open already; give masks to open_clip"):
        palpate.estimate(palpate.open_clip(clip), masks="automatic")
    with pytest.raises(ValueError, match=r"nothing\.mp4"):
        palpate.estimate(tmp_path / "nothing.mp4")
    with pytest.raises(ValueError, match="there is no estimator nonsense; choose network, gan, direct, online"):
        palpate.estimate(tmp_path, "nonsense")
