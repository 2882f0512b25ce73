"""The pages of a folder of results: what they show is in the tables, nothing is loaded, no name runs as a script."""

import errno
import json
import os
import re
import shutil
import subprocess
from collections import Counter
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import av
import pytest
from rich.console import Console

from palpate.__main__ import main
from palpate.common.output import is_own
from palpate.data.prepared import OUT_OF_CONTACT
from palpate.data.synthetic.clip import write_clip
from palpate.results.outcome import DONE, Outcome, conclude
from palpate.results.page.gather import contact_numbers
from palpate.results.page.render import write_pages
from palpate.results.record import PERSISTENT
from palpate.results.store import OutputError
from palpate.results.verdicts import NOTES, rounded
from tests.chromium import CHROMIUM, tab
from tests.tables import read_rows
from tests.test_infer import SCENE

ODD = "a & 'b' #1 50%"
BROKEN = "<img src=x onerror=alert(1)>.mp4"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory, blank_module: None) -> Path:
    """Results of a clip, and of a file that is no video, both with names that a page must escape."""
    folder = tmp_path_factory.mktemp("pages")
    clip = write_clip(folder / "clips", 1, SCENE, 3)
    clip.with_suffix(".mp4").unlink()
    clip.rename(clip.with_name(ODD))
    clip.with_name(BROKEN).write_bytes(b"no video")
    options = ["--output", str(folder / "out"), "--onset", "stamp", "--force-limit", "0.045"]
    assert main(["infer", str(clip.parent), *options]) == 1
    return folder / "out"


class Page(HTMLParser):
    """A page's tags, all of which must be closed."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.text, self.tags, self.open = path, path.read_text(encoding="utf-8"), [], []
        self.feed(self.text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append((tag, dict(attrs)))
        self.open += [tag] if tag not in ("meta", "input", "img", "br") else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def all_of(self, attribute: str) -> list[str]:
        return [attributes[attribute] for _, attributes in self.tags if attribute in attributes]


def test_pages_load_nothing_from_elsewhere_and_names_do_nothing(results: Path) -> None:
    index, clip = (Page(results / name) for name in ("index.html", f"{ODD}/page.html"))
    for page in (index, clip):
        links = page.all_of("href") + page.all_of("src")
        assert not [link for link in links if re.match(r"\w+:|//", link)]
        assert all((page.path.parent / unquote(link)).exists() for link in links if link[0] != "#")
        assert {link[1:] for link in links if link[0] == "#"} <= {*page.all_of("id")}
        loaded = re.findall(r"url\(|@import|fetch\(|XMLHttp|import\(|https?://(?!www.w3.org/2000/svg)", page.text)
        assert (loaded, page.all_of("onerror")) == ([], [])
        assert set(Counter(page.all_of("id")).values()) == {1}
        assert "Research software, not a medical device." in page.text
        assert is_own(page.path)
    assert "&lt;img src=x onerror=alert(1)&gt;.mp4 can&#39;t be opened as a video" in index.text
    assert index.all_of("href") == ["a%20%26%20%27b%27%20%231%2050%25/page.html"]


def test_the_numbers_are_those_of_the_tables(results: Path) -> None:
    page, folder = Page(results / ODD / "page.html"), results / ODD
    data, frames = json.loads(re.search('id="data">(.*?)</script>', page.text)[1]), read_rows(folder / "parameters.csv")
    (run,), (contact,) = read_rows(folder / "interactions.csv"), data["contacts"]
    (forces,) = json.loads((folder / "forces.json").read_text())["contacts"]
    for name in ("frame", "time_s", "stiffness", "stiffness_low", "stiffness_high"):
        assert data[name] == [float(row[name]) if row[name] else None for row in frames]
    for name, values in (("state", [row["verdict"] or row["status"] for row in frames]), ("alarm", None)):
        assert [data[name]["names"][at] for at in data[name]["index"]] == (values or [row[name] for row in frames])
    shown = {name: float(run[name]) for name in ("stiffness", "stiffness_low", "stiffness_high")}
    known = json.loads((folder / "results.json").read_text())["frames"]
    assert [row["stiffness"] for row in known] == data["stiffness"]
    shown |= {name: forces[name] for name in ("unit", "time_s", "frame_s", "force", "force_low", "force_high")}
    assert contact == shown | {"words": NOTES[run["verdict"]].words, "sure": True, "flat": True}
    assert len(forces["time_s"]) == sum(row["contact"] == "1" for row in frames)
    assert f"unknown for 0 of {forces['contact_s']:.4g} s" in page.text
    half = (shown["stiffness_high"] - shown["stiffness_low"]) / 2
    assert f"<dd>{rounded(shown['stiffness'], half)} <small>f/u</small></dd>" in page.text
    assert frames[data["open"]]["time_s"] == f"{forces['time_s'][-1]:.6f}"
    counts = Counter(row["verdict"] or row["status"] for row in frames)
    assert dict(re.findall(r"<code>(\w+)</code>, (\d+) frame", page.text)) == {x: str(n) for x, n in counts.items()}
    assert f"misfit {float(run['misfit']):.4g} (" in page.text
    assert f"Contact from frame {run['onset_frame']} ({float(run['onset_time_s']):.4g} s), instrument 1: " in page.text


def test_the_video_plays_in_browsers_or_the_page_says_that_there_is_none(results: Path, tmp_path: Path) -> None:
    content = (results / ODD / "overlay.mp4").read_bytes()
    with av.open(str(results / ODD / "overlay.mp4")) as video:
        assert (video.streams.video[0].codec.name, video.streams.video[0].pix_fmt) == ("h264", "yuv420p")
    assert content.index(b"moov") < content.index(b"mdat")
    folder = shutil.copytree(results / ODD, tmp_path / "out" / "clip")
    for name in ("overlay.mp4", "mine.mp4"):
        (folder / "overlay.mp4").rename(folder / name)
        write_pages(folder.parent, anew=True)
        page = Page(folder / "page.html")
        assert ("no overlay video (--no-overlay)" in page.text) == (name == "mine.mp4")
        assert ("video" in dict(page.tags)) == (name == "overlay.mp4")


def test_pages_are_rebuilt_and_a_user_s_page_stays(results, tmp_path, capsys) -> None:
    output = shutil.copytree(results, tmp_path / "out")
    index, clip = output / "index.html", output / ODD / "page.html"
    before = index.read_bytes(), clip.read_bytes()
    clip.unlink()
    assert before[0].count(b'class="failed"') == 1
    assert main(["page", str(output)]) == 0
    assert clip.read_bytes() == before[1]
    assert 'class="failed"' not in index.read_text()
    kept = (output / ODD / "forces.json").rename(output / "kept")
    write_pages(output, anew=True)
    assert "its results are damaged or of another version (FileNotFoundError" in index.read_text()
    kept.rename(output / ODD / "forces.json")
    write_pages(output, anew=True)
    assert 'class="failed"' not in index.read_text()
    index.write_text("mine")
    with pytest.raises(OutputError, match=r"index.html is not as this program wrote it; move it away"):
        write_pages(output, anew=False)
    assert (main(["page", str(output)]), index.read_text()) == (1, "mine")
    with pytest.raises(SystemExit, match="2"):
        main(["page", str(tmp_path)])
    assert "holds no results, or can't be read" in capsys.readouterr().err


@pytest.mark.parametrize("columns", [40, 50, 80])
def test_no_number_of_the_closing_table_is_lost_on_a_narrow_terminal(
    results, tmp_path, capsys, monkeypatch, columns
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    output = shutil.copytree(results, tmp_path / "out")
    conclude(output, [Outcome.of(ODD, DONE, output / ODD)], Console(stderr=True))
    shown, (run,) = capsys.readouterr().out, read_rows(results / ODD / "interactions.csv")
    for name, unit in (("stiffness", "f/u"), ("damping", "f·s/u"), ("force", "f")):
        value, low, high = (float(run[f"{name}{end}"]) for end in ("", "_low", "_high"))
        assert f"{rounded(value, (high - low) / 2)} {unit}" in shown


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_a_page_that_can_not_be_written_or_found_is_one_sentence(results, tmp_path, capsys, monkeypatch, number):
    shutil.copytree(results, copied := tmp_path / "copied")

    def refuse(path: Path, _: bytes) -> None:
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    assert main(["page", str(copied)]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"{copied}: ")
    assert said.count("\n") == 1
    with pytest.raises(SystemExit, match=r"^2$"):
        main(["page", "a" * 300])
    assert "holds no results, or can't be read" in capsys.readouterr().err


def test_every_status_and_verdict_has_a_remedy() -> None:
    statuses = {"ok", *OUT_OF_CONTACT, *PERSISTENT, "no_tissue"}
    assert statuses <= set(NOTES)
    assert {name for name, note in NOTES.items() if not note.remedy} == {"ok", "doubtful"}


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_answer_is_in_view_at_once_and_nothing_is_wider_than_the_screen(results: Path, tmp_path: Path) -> None:
    with tab(tmp_path) as browser:
        for width, height in ((1280, 720), (768, 1024), (390, 844)):
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
            browser.call("Emulation.setDeviceMetricsOverride", **size)
            browser.call("Page.navigate", url=(results / ODD / "page.html").as_uri())
            browser.wait("document.querySelectorAll('#curves svg').length")
            ends = browser.value(
                "[...document.querySelectorAll('.numbers')].map(e => e.getBoundingClientRect().bottom)"
            )
            assert len(ends) == 1
            assert ends[0] < height
            assert browser.value("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_a_clip_s_page_works_in_a_browser(results: Path, tmp_path: Path) -> None:
    page = results / ODD / "page.html"
    acts = Path(__file__).with_name("page_acts.js").read_text()
    copy, script = page.with_name("driven.html"), f"<script>{{{acts}}}</script></body>"
    copy.write_text(page.read_text(encoding="utf-8").replace("</body>", script), encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}", "--window-size=390,844"]
    options += ["--enable-logging=stderr", "--virtual-time-budget=2000", "--dump-dom", copy.as_uri()]
    done = subprocess.run([str(CHROMIUM), *options], capture_output=True, text=True, timeout=120)
    copy.unlink()
    assert "CONSOLE" not in done.stderr
    said = json.loads(unescape(re.search(r'data-said="([^"]*)"', done.stdout)[1]))
    frames = read_rows(results / ODD / "parameters.csv")
    tenth = f"frame {frames[10]['frame']}, {float(frames[10]['time_s']):.2f} s"
    # stiffness by contact and by frame, verdict by frame, alarms, time
    told = [4, True, f"frame {frames[-1]['frame']}", tenth, "10", True]
    assert said == told


def test_a_single_ratio_that_is_determined_stands_on_the_page() -> None:
    """Other quantities of the contact, as results.json has it, are not determined."""
    ends = {"": 0.1, "_low": 0.088, "_high": 0.112}
    run = {f"damping_over_stiffness{end}": value for end, value in ends.items()}
    run |= {"newtons": None, "verdict": "undetermined", "detail": "", "determined": ["damping_over_stiffness"]}
    assert contact_numbers(run, {}) == [("k_d/k_s", "0.100 ± 0.012", "s")]
