"""A small synthetic clip and an untrained posterior, shared by the tests of the estimators."""

import dataclasses

import pytest
import torch

from palpate.data.contact.features import FEATURES
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.synthetic.clip import SyntheticClip
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.source import open_synthetic
from palpate.estimators.network.fits import MECHANICS
from palpate.models.onnx_export import export
from palpate.models.onnx_session import PosteriorModel
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import RECOMMENDED
from tests.data.clips import make_clip
from tests.estimators.sessions import SIZE, clip_info
from tests.inference_inputs import metadata


@pytest.fixture(scope="session")
def pressed() -> SyntheticClip:
    """A clip of 28 frames whose tissue is pressed for 0.3 s."""
    width, height = SIZE
    settings = SceneSettings(width=width, height=height, depth_noise=0.001, frames=28, press_seconds=(0.3, 0.3))
    return make_clip(settings, 4)


@pytest.fixture(scope="session")
def frames(pressed: SyntheticClip) -> list[PreparedFrame]:
    """Prepared frames of that clip."""
    return list(open_synthetic(pressed, PrepareSettings(geometry=clip_info().geometry)))


@pytest.fixture(scope="session")
def posterior(tmp_path_factory: pytest.TempPathFactory) -> PosteriorModel:
    """An untrained posterior, exported."""
    torch.manual_seed(0)
    path, features = tmp_path_factory.mktemp("posterior") / "contact.onnx", FEATURES + SEQUENCE_FEATURES
    sections = {"geometry": clip_info().geometry, "mechanics": MECHANICS, "bounds": RECOMMENDED}
    told = {name: dataclasses.asdict(section) for name, section in sections.items()}
    document = metadata(**told, observation="trajectory", contact={"press_seconds": (0.24, 0.48)})
    export(ContactPosterior(features, torch.tensor(RECOMMENDED.log_box), width=16, blocks=1), path, document)
    return PosteriorModel(path)
