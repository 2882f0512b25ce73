"""Model cards in the form that the Hugging Face hub takes, with the figures of the reports."""

import re
from pathlib import Path

import pytest
from huggingface_hub import ModelCard

ROOT = Path(__file__).parents[2]
CARDS = ("models/weights/contact",)
SECTIONS = ("Intended use", "Out of scope", "Training data", "Evaluation", "Limitations")


@pytest.mark.parametrize("model", CARDS)
def test_a_card_has_the_hub_s_fields_and_sections(model: str) -> None:
    card = ModelCard.load(ROOT / f"{model}.md")
    assert (card.data.license, card.data.library_name, card.data.model_name) == ("apache-2.0", "onnx", Path(model).name)
    assert re.findall(r"^## (.*)$", card.text, re.MULTILINE) == [*SECTIONS]
