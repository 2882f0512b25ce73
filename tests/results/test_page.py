"""The pages of a folder of results: what they show is in the tables, nothing is loaded, no name runs as a script."""

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

from palpate.__main__ import main
from palpate.data.prepared import OUT_OF_CONTACT
from palpate.data.synthetic.clip import write_clip
from palpate.results.page.gather import TEXTS, advice
from palpate.results.page.own import is_own
from palpate.results.page.render import write_pages
from palpate.results.record import PERSISTENT, UNCALIBRATED, UNDRIVEN
from palpate.results.store import WRITTEN, OutputError
from palpate.results.verdicts import COLORS, MEANINGS
from tests.tables import read_rows
from tests.test_infer import SCENE

pytestmark = pytest.mark.usefixtures("blank_pictures")
ODD = "a & 'b' #1 50%"
BROKEN = "<img src=x onerror=alert(1)>.mp4"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip and a file that is no video, both with names that a page must escape."""
    folder = tmp_path_factory.mktemp("clips")
    clip = write_clip(folder, 1, SCENE, 3)
    clip.with_suffix(".mp4").unlink()
    clip.rename(folder / ODD)
    (folder / BROKEN).write_bytes(b"no video")
    return folder


@pytest.fixture(scope="module")
def results(clips: Path, tmp_path_factory: pytest.TempPathFactory, blank_module: None) -> Path:
    output = tmp_path_factory.mktemp("results")
    options = ["--output", str(output), "--onset", "stamp", "--force-limit", "0.045"]
    assert main(["infer", str(clips), *options]) == 1
    return output


class Page(HTMLParser):
    """A page's tags, with a test that they are closed."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.tags, self.open, self.scripts = path, [], [], {}
        self.feed(path.read_text(encoding="utf-8"))
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "input", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts[self.tags[-1][1].get("id")] = data

    def all_of(self, attribute: str) -> list[str]:
        return [attributes[attribute] for _, attributes in self.tags if attribute in attributes]


def test_pages_load_nothing_from_elsewhere_and_names_do_nothing(results: Path) -> None:
    for page in map(Page, (results / "index.html", results / ODD / "page.html")):
        links = page.all_of("href") + page.all_of("src")
        assert not [link for link in links if re.match(r"\w+:|//", link)]
        assert all((page.path.parent / unquote(link)).exists() for link in links)
        text = page.path.read_text(encoding="utf-8")
        assert re.findall(r"url\(|@import|fetch\(|XMLHttp|import\(", text) == []
        assert set(re.findall(r"https?://[^\"]*", text)) <= {"http://www.w3.org/2000/svg"}
        assert Counter(page.all_of("id")).most_common(1)[0][1] == 1
        assert not [attributes for tag, attributes in page.tags if "onerror" in attributes]
        assert "Research software, not a medical device." in text
        assert is_own(page.path)
    assert text.count("What to do:") == 1  # the force limit's
    index = (results / "index.html").read_text(encoding="utf-8")
    assert "&lt;img src=x onerror=alert(1)&gt;.mp4 can&#39;t be opened as a video" in index
    assert 'href="a%20%26%20%27b%27%20%231%2050%25/page.html"' in index


def test_the_numbers_are_those_of_the_tables(results: Path) -> None:
    page = Page(results / ODD / "page.html")
    data, frames = json.loads(page.scripts["data"]), read_rows(results / ODD / "parameters.csv")
    (run,) = read_rows(results / ODD / "interactions.csv")
    (forces,) = json.loads((results / ODD / "forces.json").read_text())["contacts"]
    for name in ("frame", "time_s", "stiffness", "stiffness_low", "stiffness_high"):
        assert data[name] == [float(row[name]) if row[name] else None for row in frames]
    assert data["sure"] == ["stiffness" in row["determined"].split(";") for row in frames]
    for name, values in (
        ("state", [row["verdict"] or row["status"] for row in frames]),
        ("alarm", None),
        ("detail", None),
    ):
        shown = [data[name]["names"][code] for code in data[name]["index"]]
        assert shown == (values or [row[name] for row in frames])
    (contact,) = data["contacts"]
    assert contact["stiffness_high"] == float(run["stiffness_high"])
    assert [contact[name] for name in ("force", "unit", "time_s")] == [
        forces[name] for name in ("force", "unit", "time_s")
    ]
    assert len(forces["time_s"]) == sum(row["contact"] == "1" for row in frames)
    assert forces["limit_unknown_s"] == pytest.approx(sum(row["alarm"] == "unknown" for row in frames) / 25)
    text = page.path.read_text(encoding="utf-8")
    assert f"0 of {forces['contact_s']:.4g} s (0 of {forces['contact_frames']} frames)" in text
    for name, cell in run.items():
        assert not cell or f"<td>{cell}</td>" in text.replace("&#39;", "'"), name


def test_the_video_plays_in_browsers(results: Path, tmp_path: Path) -> None:
    path = results / ODD / "overlay.mp4"
    with av.open(str(path)) as video:
        assert (video.streams.video[0].codec.name, video.streams.video[0].pix_fmt) == ("h264", "yuv420p")
    assert path.read_bytes().index(b"moov") < path.read_bytes().index(b"mdat")
    for encoder, said in (("mp4v", "many browsers do not play it"), (None, "no overlay video (--no-overlay)")):
        folder = tmp_path / str(encoder)
        shutil.copytree(results / ODD, folder / "clip")
        record = json.loads((folder / "clip" / "run.json").read_text())
        (folder / "clip" / "run.json").write_text(json.dumps(record | {"overlay_encoder": encoder}))
        if encoder is None:
            (folder / "clip" / "overlay.mp4").unlink()
        write_pages(folder, anew=True)
        assert said in (folder / "clip" / "page.html").read_text()
        assert [tag for tag, _ in Page(folder / "clip" / "page.html").tags].count("video") == (encoder is not None)


def test_pages_are_rebuilt_failures_stay_until_tried_again_and_a_user_s_page_stays(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = shutil.copytree(results, tmp_path / "out")
    pages = (output / "index.html", output / ODD / "page.html")
    before = [page.read_bytes() for page in pages]
    pages[1].unlink()
    assert main(["page", str(output)]) == 0
    assert [page.read_bytes() for page in pages] == before
    write_pages(output, [], [BROKEN], anew=False)
    assert 'class="failed"' not in pages[0].read_text()
    (output / ODD / "forces.json").write_text("{")
    write_pages(output, anew=True)
    assert "its results are damaged or of another version" in pages[0].read_text()
    pages[0].write_text("mine")
    with pytest.raises(OutputError, match=r"index.html is not as this program wrote it; move it away"):
        write_pages(output, anew=False)
    assert main(["page", str(output)]) == 1
    assert pages[0].read_text() == "mine"
    with pytest.raises(SystemExit, match="2"):
        main(["page", str(tmp_path)])
    assert "holds no results of palpate infer" in capsys.readouterr().err


def test_every_status_verdict_file_and_warning_has_a_remedy() -> None:
    statuses = {"ok", *OUT_OF_CONTACT, *PERSISTENT, "no_tool", "no_tissue", "no_contact"}
    assert set(TEXTS["statuses"]) == statuses
    assert set(TEXTS["verdicts"]) == {*MEANINGS, "no_estimate"} == set(COLORS) - statuses - {"doubtful"}
    assert set(TEXTS["files"]) == set(WRITTEN)
    told = [UNCALIBRATED, UNDRIVEN, *(f"3 of 9 frames are {name}, the first is 1: x" for name in PERSISTENT)]
    assert TEXTS["other_warning"] not in map(advice, told)
    assert advice("anything else") == TEXTS["other_warning"]


@pytest.fixture(scope="module")
def many(results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two hundred clips."""
    output = tmp_path_factory.mktemp("many")
    for number in range(200):
        shutil.copytree(results / ODD, output / f"clip {number}", ignore=shutil.ignore_patterns("*.mp4", "*.png"))
        record = json.loads((output / f"clip {number}" / "run.json").read_text())
        kind = "determined" if number % 4 else "undetermined"
        record |= {"contacts": {kind: number % 7 + 1}, "overlay_encoder": None}
        (output / f"clip {number}" / "run.json").write_text(json.dumps(record))
        os.utime(output / f"clip {number}" / "page.html")
    write_pages(output, [("last.mp4", "last.mp4: failed.")], anew=False)
    return output


def test_the_page_of_a_batch_is_light(many: Path) -> None:
    page = Page(many / "index.html")
    assert page.path.stat().st_size < 300_000
    assert not {"video", "img", "svg", "iframe"} & {tag for tag, _ in page.tags}
    assert len([value for value in page.all_of("data-kinds") if value == "undetermined"]) == 50
    assert page.all_of("data-kinds")[0] == "failed"


INDEX_ACTS = """
const rows = () => [...document.querySelectorAll('tbody tr')].filter(row => !row.hidden);
const said = [rows().length, rows()[1].cells[0].textContent];
const heads = document.querySelectorAll('thead button');
heads[0].click(); heads[0].click();
said.push(rows()[0].cells[0].textContent, heads[0].parentElement.getAttribute('aria-sort'));
const kind = document.getElementById('kind'); kind.value = 'undetermined'; kind.dispatchEvent(new Event('change'));
const words = document.getElementById('words'); words.value = 'CLIP 19'; words.dispatchEvent(new Event('input'));
said.push(rows().map(row => row.cells[0].textContent), document.getElementById('counted').textContent);
"""
CLIP_ACTS = """
const box = document.getElementById('curves'), now = document.getElementById('now');
const key = name => box.dispatchEvent(new KeyboardEvent('keydown', {key: name}));
const said = [box.querySelectorAll('svg').length, box.querySelectorAll('polygon.interval').length];
key('End'); said.push(now.textContent.slice(0, 8));
key('Home'); key('PageUp'); said.push(now.textContent.slice(0, 30), box.getAttribute('aria-valuenow'));
said.push(document.documentElement.scrollWidth <= innerWidth);
"""


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
@pytest.mark.parametrize("size", ["390,844", "820,1180", "1440,900"])
def test_the_pages_work_in_a_browser(size: str, results: Path, many: Path, tmp_path: Path) -> None:
    def acted(page: Path, acts: str) -> list:
        copy = page.with_name(f"driven {size}.html")
        script = f"<script>{acts}\ndocument.body.dataset.said = JSON.stringify(said);</script></body>"
        copy.write_text(page.read_text(encoding="utf-8").replace("</body>", script), encoding="utf-8")
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            f"--user-data-dir={tmp_path}",
            f"--window-size={size}",
        ]
        options += ["--enable-logging=stderr", "--virtual-time-budget=2000", "--dump-dom", copy.as_uri()]
        done = subprocess.run([CHROMIUM, *options], capture_output=True, text=True, timeout=120)
        copy.unlink()
        assert "CONSOLE" not in done.stderr
        return json.loads(unescape(re.search(r'data-said="([^"]*)"', done.stdout)[1]))

    found = acted(many / "index.html", INDEX_ACTS)
    assert found[:4] == [201, "clip 0", "last.mp4", "descending"]
    assert found[4:] == [["clip 196", "clip 192"], "2 of 201 clips"]
    frames = read_rows(results / ODD / "parameters.csv")
    said = acted(results / ODD / "page.html", CLIP_ACTS)
    assert said[0] == 6  # force, stiffness by contact and by frame, verdicts, alarms, time
    assert (said[1] > 0, said[2], said[4:]) == (True, f"frame {frames[-1]['frame']}", ["10", True])
    assert said[3].startswith(f"frame {frames[10]['frame']}, {float(frames[10]['time_s']):.2f} s: ")
