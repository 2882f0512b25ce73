"""What an installation gives: one package, whatever the user's own folders are called."""

import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

from palpate.data.synthetic.clip import write_clip
from tests.conftest import CHECKOUT
from tests.palpate.test_api import SCENE

pytestmark = pytest.mark.slow
FOLDERS = ("common", "physics", "data", "models", "estimators", "planning", "results")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel, and with the libraries of this one, but not its link to the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    sources = folder / "sources"
    shutil.copytree(
        CHECKOUT, sources, symlinks=True, ignore=shutil.ignore_patterns(".venv", ".git", "runs", "build", "*.egg-info")
    )
    home = folder / "environment"
    venv.create(home, with_pip=False)
    site = home / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    options = ["--disable-pip-version-check", "--quiet", "--no-deps", "--no-compile", "--target", site]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, sources], check=True, timeout=300)
    (site / "libraries.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    return home


def test_only_palpate_stands_in_site_packages(installed: Path) -> None:
    (site,) = installed.glob("lib/*/site-packages")
    names = {path.name.split("-")[0] for path in site.iterdir()} - {"libraries.pth", "__pycache__"}
    assert names == {"palpate", "bin"}
    assert {path.name for path in (site / "palpate").iterdir() if path.is_dir()} >= {*FOLDERS, "cli"}
    assert (site / "palpate" / "results" / "results.schema.json").is_file()


def test_it_works_in_a_folder_with_packages_of_the_same_names(installed: Path, tmp_path: Path) -> None:
    for name in ("data", "models"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("OWN = True\n")
    clip = write_clip(tmp_path / "clips", 1, SCENE, 3)
    program = f"""
import data, models, runpy, sys
import palpate
assert data.OWN and models.OWN
assert {str(installed)!r} in palpate.__file__, palpate.__file__
(run,) = palpate.estimate({str(clip)!r})
print(run.onset_frame, run.verdict, *run.estimate.theta)
sys.argv = ["palpate", "infer", {str(clip)!r}, "--output", "out", "--no-overlay"]
try:
    runpy.run_module("palpate", run_name="__main__", alter_sys=True)
except SystemExit as ended:
    assert not ended.code
assert "torch" not in sys.modules
"""
    python = installed / "bin" / "python"
    done = subprocess.run([python, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    import palpate

    (run,) = palpate.estimate(clip)
    frame, verdict, *theta = done.stdout.splitlines()[0].split()
    assert (int(frame), verdict) == (run.onset_frame, run.verdict)
    assert [float(value) for value in theta] == pytest.approx(run.estimate.theta, rel=1e-6)
    assert (tmp_path / "out" / clip.name / "interactions.csv").is_file()
    assert f'href="{clip.name}/page.html"' in (tmp_path / "out" / "index.html").read_text()
