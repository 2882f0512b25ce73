"""Estimators opened by name say all that their numbers depend on."""

import pytest

from estimators.open import EstimatorOptions, open_estimator


@pytest.mark.parametrize("name", ["network", "direct"])
def test_what_an_estimator_is_opened_with_is_in_its_description(name: str) -> None:
    usual = open_estimator(EstimatorOptions(name)).described
    assert (usual["name"], usual["onset"], usual["horizon"]) == (name, "between", None)
    assert open_estimator(EstimatorOptions(name, horizon=3)).described == usual | {"horizon": 3}
    assert open_estimator(EstimatorOptions(name, onset="stamp")).described == usual | {"onset": "stamp"}
