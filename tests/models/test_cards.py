"""Model cards in the form that the Hugging Face hub takes, with the figures of the reports."""

import re
from pathlib import Path

import pytest
from huggingface_hub import ModelCard

ROOT = Path(__file__).parents[2]
CARDS = "models/weights/contact", "data/depth/photometric"
SECTIONS = ("Intended use", "Out of scope", "Training data", "Evaluation", "Limitations")


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", text)]


@pytest.mark.parametrize("model", CARDS)
def test_a_card_has_the_hub_s_fields_and_sections(model: str) -> None:
    card = ModelCard.load(ROOT / f"{model}.md")
    assert (card.data.license, card.data.library_name, card.data.model_name) == ("apache-2.0", "onnx", Path(model).name)
    assert re.findall(r"^## (.*)$", card.text, re.MULTILINE) == [*SECTIONS]


def test_the_photometric_card_says_what_the_report_says() -> None:
    told: dict[str, list[float]] = {}
    for result in ModelCard.load(ROOT / "data/depth/photometric.md").data.eval_results:
        values = told.setdefault(result.dataset_name, numbers(result.dataset_name))
        values += [result.metric_value, *map(float, re.findall(r"(\d+) clear clips", result.metric_name))]
    lines = (ROOT / "docs" / "reports" / "depth.md").read_text().splitlines()
    row = r"\| `video.*\d \| [\d.]+, [\d.*]+ \|$"
    assert list(told.values()) == [numbers(line) for line in lines if re.match(row, line)]
    assert len(told) == 4
