"""Model cards in the form that the Hugging Face hub takes, with the figures of the reports."""

import re
from pathlib import Path

import pytest
from huggingface_hub import ModelCard

ROOT = Path(__file__).parents[2]
CARDS = {
    "models/weights/contact": ("identifiability", r"\| network.* of \d+ \|$", 6),
}
"""By model the report, rows of a table in it, and how many there are."""
SECTIONS = ("Intended use", "Out of scope", "Training data", "Evaluation", "Limitations")


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", text)]


@pytest.mark.parametrize("model", CARDS)
def test_a_card_says_what_the_report_says(model: str) -> None:
    card, (report, row, count) = ModelCard.load(ROOT / f"{model}.md"), CARDS[model]
    assert (card.data.license, card.data.library_name, card.data.model_name) == ("apache-2.0", "onnx", Path(model).name)
    assert re.findall(r"^## (.*)$", card.text, re.MULTILINE) == [*SECTIONS]
    told: dict[str, list[float]] = {}
    for result in card.data.eval_results:
        values = told.setdefault(result.dataset_name, numbers(result.dataset_name))
        values += [result.metric_value, *map(float, re.findall(r"(\d+) clear clips", result.metric_name))]
    lines = (ROOT / "docs" / "reports" / f"{report}.md").read_text().splitlines()
    assert list(told.values()) == [numbers(line) for line in lines if re.match(row, line)]
    assert len(told) == count
