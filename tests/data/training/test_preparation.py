"""One bad clip does not end the preparation of the others, whatever is wrong with it."""

from palpate.data.training import preparation
from palpate.data.training.preparation import prepare_all
from tests.data.clips import SETTINGS, write_clip


def test_even_an_unforeseen_error_costs_only_its_own_clip(tmp_path, monkeypatch):
    good, bad = write_clip(tmp_path / "good", frames=3), write_clip(tmp_path / "bad", frames=3)
    prepare = preparation.prepare

    def fails_on_one(path, *rest):
        if path == bad:
            raise OverflowError("Python int too large\nto convert")
        return prepare(path, *rest)

    monkeypatch.setattr(preparation, "prepare", fails_on_one)
    clips, failures = prepare_all({bad: (), good: ()}, SETTINGS, tmp_path / "cache", show=False)
    assert [clip.name for clip in clips] == ["good"]
    said = "unexpected OverflowError (Python int too large to convert); report it with the clip's files."
    assert failures == {bad: said}


def test_a_refused_clip_is_told_in_its_own_sentence(tmp_path):
    folder = write_clip(tmp_path / "bad", frames=3)
    (folder / "clip.json").write_text("{")
    clips, failures = prepare_all({folder: ()}, SETTINGS, tmp_path / "cache", show=False)
    assert clips == []
    assert failures[folder].startswith(f"{folder / 'clip.json'} is not a clip description")
