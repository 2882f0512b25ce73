"""Estimators opened by name say all that their numbers depend on."""

import pytest

from estimators.open import EstimatorOptions, open_estimator


@pytest.mark.parametrize("name", ["network", "direct"])
def test_what_an_estimator_is_opened_with_is_in_its_description(name: str) -> None:
    usual = open_estimator(EstimatorOptions(name)).described
    assert (usual["name"], usual["onset"], usual["horizon"]) == (name, "between", None)
    assert open_estimator(EstimatorOptions(name, horizon=3)).described == usual | {"horizon": 3}
    assert open_estimator(EstimatorOptions(name, onset="stamp")).described == usual | {"onset": "stamp"}


def test_direct_alone_is_told_what_to_compare() -> None:
    usual = open_estimator(EstimatorOptions("direct"))
    point = open_estimator(EstimatorOptions("direct", observation="contact"))
    assert usual.observation == usual.described["observation"] == "field"
    assert point.observation == "contact"
    assert point.described == usual.described | {"observation": "contact"}
    assert "observation" not in open_estimator(EstimatorOptions("network")).described
    for name in ("network", "gan"):
        with pytest.raises(ValueError, match="--observation is for --estimator direct; leave it out"):
            open_estimator(EstimatorOptions(name, observation="field"))
