"""Settings of the online estimator: what a file may say, and what can't be used is a sentence that names it."""

from pathlib import Path

import pytest

from palpate.data.source.layout import InputError
from palpate.estimators.online.objective import Bounds
from palpate.estimators.online.session import Method
from palpate.estimators.online.settings import OnlineSettings, load_settings


@pytest.fixture
def told(tmp_path: Path):
    """`told(text)`: settings of such a file."""

    def load(text: str) -> OnlineSettings:
        path = tmp_path / "online.yaml"
        path.write_text(text)
        return load_settings(path)

    return load


def test_what_a_file_leaves_out_keeps_its_default(told) -> None:
    assert told("{}") == OnlineSettings()
    found = told("bounds: {distance: 5.0}\nmethod: {name: PBD}\n")
    expected = OnlineSettings(bounds=Bounds(5.0), method=Method("PBD"))
    assert found == expected


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("speed: 1", "online.yaml has the unknown key 'speed'"),
        ("weights: {gap: 1, colour: 2}", "online.yaml, weights, has the unknown key 'colour'"),
        ("weights: {gap: -1}", "online.yaml, weights, can't be used: the weight of gap is -1"),
        ("weights: 3", "online.yaml, weights, is not a mapping"),
        ("particles: many", "online.yaml gives particles 'many'; give a whole number"),
        ("particles: 3", "particles is 3; give 30 to 10000"),
        ("fitted: 51", "fitted is 51; give 0 to 50"),
        ("thickness: 0.0", "thickness is 0.0; give a positive number"),
        ("points: 0", "points is 0; give 1 or more"),
        ("stepping: {iterations: 100000}", "iterations is 100000; give 1 to 1000"),
        ("mapping: {steps: 0}", "steps is 0; give 1 to 1000"),
        ("method: {rate: -1}", "rate is -1; give a positive number"),
        ("strain: -0.1", "strain is -0.1; give 0 or more"),
        ("start: {distance: 12.0}", "the start of distance is 12, its bound 10; begin inside"),
        ("start: {shape: 0.0}", "the start of shape is 0.0; give a positive number"),
        ("method: {name: DiffCloud}", "online.yaml, method, gives name 'DiffCloud'"),
        ("- 1", "is not a file of settings; write a mapping"),
        ("a: !!python/object/apply:os.getcwd []", "is not a file of settings"),
    ],
)
def test_what_can_t_be_used_is_a_sentence(told, text: str, sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        told(text)
    assert sentence in str(caught.value)
