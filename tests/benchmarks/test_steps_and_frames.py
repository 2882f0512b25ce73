"""The benchmarks of the online estimator's steps and of stereo frames run, whatever their times."""

import pytest

from tests.benchmarks import online_steps, stereo_frames


def rows(out: str) -> list[list[str]]:
    """Cells of a table in Markdown, without its head."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in out.splitlines() if line[:1] == "|"][2:]


@pytest.mark.slow
def test_every_case_of_a_step_is_timed(capsys: pytest.CaptureFixture[str]) -> None:
    assert online_steps.main(["--frames", "4", "--particles", "100", "--rounds", "1"]) == 0
    found = rows(capsys.readouterr().out)
    bodies, matches = ("sheet", "volume"), ("points", "clouds", "both")
    assert [row[:3] for row in found] == [
        [body, optimizer, match] for body in bodies for optimizer in ("gauss-newton", "adam") for match in matches
    ]
    assert [float(row[5]) for row in found[::6]] == [1.0, 1.0]
    assert all(0 < float(row[3]) <= float(row[4]) for row in found)


def test_a_stereo_frame_and_its_parts_are_timed(capsys: pytest.CaptureFixture[str]) -> None:
    assert stereo_frames.main(["--frames", "3"]) == 0
    whole, reading, _ = rows(capsys.readouterr().out)
    assert float(whole[3]) == 1.0
    assert float(reading[1]) <= float(reading[2])
