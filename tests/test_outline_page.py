"""The page on which instruments are outlined: in a browser, as a user draws, and what it answers."""

import json
import urllib.request
from pathlib import Path
from urllib.error import HTTPError

import numpy as np
import pytest

from palpate.__main__ import main
from palpate.data.masks.outlined import OutlinedMasks
from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout, InputError
from palpate.data.source.video import Video
from palpate.outline_page import OutlinePage
from tests.chromium import CHROMIUM, tab
from tests.data.masks.test_outlined import HEIGHT, WIDTH, overlap, picture

PATH = [((110.0 + 6 * step, 150.0 + 2 * step), 0.15 + 0.01 * step) for step in range(12)]
"""Tip and angle of a shaft that comes in, by frame."""


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    video = Video(tmp_path / "press.mp4", (WIDTH, HEIGHT), 25.0)
    for place in PATH:
        video.write(picture(place)[0])
    video.close()
    return tmp_path / "press.mp4"


def outlined(clip: Path, outlines: Path) -> list[float]:
    """How well the masks of saved outlines overlap the shaft, by frame."""
    masks = OutlinedMasks(outlines)
    return [overlap(masks(f), picture(PATH[f.number])[1]) for f in open_source(clip, ClipLayout())]


def along(place: tuple[tuple[float, float], float]) -> list[tuple[float, float]]:
    """A line that a person draws along a shaft, from near its tip to the picture's side [px]."""
    (u, v), angle = place
    return [(u - t * np.cos(angle), v - t * np.sin(angle)) for t in np.linspace(6, (u - 4) / np.cos(angle), 8)]


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_stroke_outlines_an_instrument_through_the_clip(clip: Path, tmp_path: Path) -> None:
    saved = tmp_path / "press.yaml"
    with OutlinePage(clip, saved) as page, tab(tmp_path / "profile") as browser:
        browser.call("Page.navigate", url=page.url)
        browser.wait(f"typeof clip == 'object' && clip.numbers.length == {len(PATH)} && picture.naturalWidth > 0")
        script = "(b => [b.left, b.top, b.width, b.height])(view.getBoundingClientRect())"
        left, top, width, height = browser.value(script)
        share = min(width / WIDTH, height / HEIGHT)
        corner = left + (width - share * WIDTH) / 2, top + (height - share * HEIGHT) / 2
        browser.drag(*((corner[0] + share * u, corner[1] + share * v) for u, v in along(PATH[0])))
        browser.wait("keys[0] && keys[0][0].polygons.length > 0")
        browser.press("#follow")
        assert "Followed through the clip" in browser.wait("said.textContent.startsWith('Saved') && said.textContent")
        assert browser.value("Object.keys(shown).length") == len(PATH)
        found = outlined(clip, saved)
        assert min(found) > 0.75
        # What finds nothing, or is taken back, leaves no frame without instruments behind.
        browser.value("go(5)")
        browser.drag((corner[0] - 30, corner[1] + 5), (corner[0] - 20, corner[1] + 5), (corner[0] - 10, corner[1] + 5))
        browser.wait("said.textContent.includes('nothing found')")
        (u, v), _ = PATH[5]
        browser.drag((corner[0] + share * (u - 20), corner[1] + share * v))
        assert browser.value("active") == 0
        browser.press("#none")
        browser.press("#undo")
        assert browser.value("Object.keys(keys)") == ["0"]
        # None in view counts from its frame on.
        browser.value(f"go({len(PATH) - 1})")
        browser.press("#none")
        browser.press("#follow")
        browser.wait(f"'{len(PATH) - 1}' in shown && shown[{len(PATH) - 1}].length == 0")
    assert sorted(json.loads(saved.read_text()), key=int) == ["0", str(len(PATH) - 1)]
    assert outlined(clip, saved) == [*found[:-1], 0]


def asked(url: str, body: object = None) -> bytes:
    data = None if body is None else json.dumps(body).encode()
    with urllib.request.urlopen(urllib.request.Request(url, data), timeout=30) as answer:
        return answer.read()


def test_only_who_knows_the_address_is_answered_and_wrong_requests_are_refused(clip: Path, tmp_path: Path) -> None:
    with OutlinePage(clip, tmp_path / "o.yaml") as page:
        assert f'src="{page.url}"' in page._repr_html_()
        assert json.loads(asked(f"{page.url}state"))["size"] == [WIDTH, HEIGHT]
        host = page.url.split("/")[2]
        for path in ("state", "", "x/state"):
            with pytest.raises(HTTPError, match="404"):
                asked(f"http://{host}/{path}")
        for name, body in (
            ("cut", {"place": 10**6, "strokes": [], "begin": []}),
            ("follow", {"outlines": {"0": [[[1, 2]]]}}),
            ("x", {}),
        ):
            with pytest.raises(HTTPError, match="400"):
                asked(page.url + name, body)
        assert not (tmp_path / "o.yaml").exists()


def test_saved_outlines_go_on(clip: Path, tmp_path: Path) -> None:
    saved = tmp_path / "o.yaml"
    saved.write_text("3: [[[10, 10], [60, 10], [60, 60]]]")
    with OutlinePage(clip, saved) as page:
        assert page.session.state()["outlines"] == {3: [[[10, 10], [60, 10], [60, 60]]]}
    with pytest.raises(InputError, match="can't be written"):
        OutlinePage(clip, tmp_path / "none" / "o.yaml")


def test_what_can_not_be_outlined_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str], clip: Path) -> None:
    (tmp_path / "text.mp4").write_text("none")
    assert main(["outline", str(tmp_path / "text.mp4")]) == 1
    assert "text.mp4" in capsys.readouterr().err
    with OutlinePage(clip, tmp_path / "o.yaml") as page:
        assert main(["outline", str(clip), "--port", page.url.split(":")[2].split("/")[0]]) == 1
    assert "give another port" in capsys.readouterr().err
    (tmp_path / "bad.yaml").write_text("a: b")
    with pytest.raises(InputError, match=r"bad\.yaml"):
        OutlinePage(clip, tmp_path / "bad.yaml")
