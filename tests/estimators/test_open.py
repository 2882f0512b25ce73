"""Estimators opened by name say all that their numbers depend on."""

import pytest

from palpate.estimators.open import EstimatorOptions, open_estimator
from tests.inference_inputs import write_model


@pytest.mark.parametrize("name", ["network", "direct"])
def test_what_an_estimator_is_opened_with_is_in_its_description(name: str) -> None:
    usual = open_estimator(EstimatorOptions(name)).described
    assert (usual["name"], usual["onset"], usual["horizon"]) == (name, "between", None)
    assert usual["observation"] == "auto"  # depth where it is given, else light
    for chosen in ({"horizon": 3}, {"onset": "stamp"}, {"observation": "depth"}):
        assert open_estimator(EstimatorOptions(name, **chosen)).described == usual | chosen


def test_only_the_network_can_be_fast(tmp_path) -> None:
    assert open_estimator(EstimatorOptions("network", rate="fast")).described["rate"] == "fast"
    for options in (
        EstimatorOptions("direct", rate="fast"),
        EstimatorOptions("online", rate="fast"),
        EstimatorOptions("gan", write_model(tmp_path / "gan.onnx"), rate="fast"),
    ):
        with pytest.raises(ValueError, match="--rate fast"):
            open_estimator(options)


def test_a_network_of_single_frames_has_no_choice_of_what_to_look_at(tmp_path) -> None:
    options = EstimatorOptions("gan", write_model(tmp_path / "gan.onnx"), observation="depth")
    with pytest.raises(ValueError, match="sees single frames; leave --observation depth out"):
        open_estimator(options)


def test_the_network_goes_by_one_observation() -> None:
    with pytest.raises(ValueError, match="shading is for --estimator direct; take that"):
        open_estimator(EstimatorOptions("network", observation="shading"))


def test_online_alone_takes_settings_and_nothing_else(tmp_path) -> None:
    path = tmp_path / "online.yaml"
    path.write_text("particles: 90\nmethod: {name: PBD-RM}\n")
    usual = open_estimator(EstimatorOptions("online")).described
    chosen = open_estimator(EstimatorOptions("online", settings=path)).described
    assert chosen == usual | {"particles": 90, "method": {"name": "PBD-RM", "optimizer": "gauss-newton", "rate": 0.1}}
    for name in ("network", "direct"):
        with pytest.raises(ValueError, match=r"online\.yaml is for --estimator online; leave it out"):
            open_estimator(EstimatorOptions(name, settings=path))
    for told in ({"model": path}, {"onset": "stamp"}, {"observation": "depth"}, {"noise": 0.1}, {"horizon": 3}):
        with pytest.raises(ValueError, match=f"--{next(iter(told))} is not for --estimator online; leave it out"):
            open_estimator(EstimatorOptions("online", **told))
