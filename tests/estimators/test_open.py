"""Estimators opened by name say all that their numbers depend on."""

import pytest

from palpate.estimators.open import ESTIMATORS, default_estimator, open_estimator
from tests.inference_inputs import write_model


@pytest.mark.parametrize("name", ["network", "direct"])
def test_what_an_estimator_is_opened_with_is_in_its_description(name: str) -> None:
    usual = open_estimator(name).described
    assert (usual["name"], usual["onset"], usual["horizon"]) == (name, "between", None)
    assert not usual["observation"]  # depth where it is given, else light
    for chosen in (
        {"horizon": 3},
        {"onset": "stamp"},
        {"observation": {"network": "depth", "direct": ("depth",)}[name]},
    ):
        assert open_estimator(name, **chosen).described == usual | chosen


def test_a_file_tells_whose_it_is(tmp_path) -> None:
    model = write_model(tmp_path / "gan.onnx")
    assert [default_estimator(each) for each in (None, model, tmp_path / "none.onnx")] == ["network", "gan", "network"]
    assert open_estimator(model=model).name == "gan"
    with pytest.raises(ValueError, match=r"gan\.onnx is of another estimator than network"):
        open_estimator("network", model=model)


@pytest.mark.parametrize("name", ESTIMATORS.entries)
def test_an_option_of_another_estimator_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"strange is no option of the estimator {name}; choose from "):
        open_estimator(name, strange=1)
    for option in {"noise", "rate", "settings"} - set(ESTIMATORS[name].__dataclass_fields__):
        with pytest.raises(ValueError, match=f"{option} is no option"):
            open_estimator(name, **{option: 1})


def test_the_network_goes_by_one_observation() -> None:
    with pytest.raises(ValueError, match="observation is 'shading'; give one of depth"):
        open_estimator("network", observation="shading")


def test_online_takes_a_file_of_settings(tmp_path) -> None:
    path = tmp_path / "online.yaml"
    path.write_text("particles: 90\nmethod: {name: PBD-RM}\n")
    usual, chosen = open_estimator("online").described, open_estimator("online", settings=path).described
    assert chosen == usual | {"particles": 90, "method": {"name": "PBD-RM", "optimizer": "gauss-newton", "rate": 0.1}}
