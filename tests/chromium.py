"""A browser without a screen, driven through its own protocol over pipes (Chrome DevTools)."""

import itertools
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Tab:
    """One tab: scripts, the mouse and pictures of it."""

    def __init__(self, to: Any, answers: Any) -> None:
        self._to, self._answers, self._numbers, self._session = to, answers, itertools.count(1), None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def call(self, method: str, **given: Any) -> dict[str, Any]:
        """What the browser answers to a command of its protocol."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": given}
        self._to.write(json.dumps(message | ({"sessionId": self._session} if self._session else {})).encode() + b"\0")
        self._to.flush()
        while True:
            text = bytearray()
            while (letter := self._answers.read(1)) != b"\0":
                assert letter, "the browser has ended"
                text += letter
            answer = json.loads(text)
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def value(self, script: str) -> Any:
        """Value of a script's expression."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, script: str, seconds: float = 30) -> Any:
        """The value once it is true."""
        end = time.monotonic() + seconds
        while not (found := self.value(script)):
            assert time.monotonic() < end, f"{script} stays {found!r}"
            time.sleep(0.1)
        return found

    def drag(self, *places: tuple[float, float]) -> None:
        """Press the mouse at the first place [px], move it through the others, and let it go."""
        kinds = ("mousePressed", *["mouseMoved"] * (len(places) - 1), "mouseReleased")
        for kind, (x, y) in zip(kinds, (*places, places[-1]), strict=True):
            held = {"button": "left", "buttons": 0 if kind == "mouseReleased" else 1, "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **held)

    def press(self, selector: str) -> None:
        """Click an element in its middle."""
        box = self.value(
            f"(r => [r.x + r.width / 2, r.y + r.height / 2])({_element(selector)}.getBoundingClientRect())"
        )
        self.drag(tuple(box))


def _element(selector: str) -> str:
    return f"document.querySelector({json.dumps(selector)})"


@contextmanager
def tab(profile: Path, size: tuple[int, int] = (1280, 900)) -> Iterator[Tab]:
    """A tab of that size in a new browser, whose profile lies in a folder."""
    (their_in, to), (answers, their_out) = os.pipe(), os.pipe()
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={size[0]},{size[1]}"]
    command += [f"--user-data-dir={profile}", "--remote-debugging-pipe"]

    def as_three_and_four() -> None:
        high = [os.dup(their_in), os.dup(their_out)]
        os.dup2(high[0], 3)
        os.dup2(high[1], 4)

    browser = subprocess.Popen(command, preexec_fn=as_three_and_four, close_fds=False, stderr=subprocess.DEVNULL)
    os.close(their_in)
    os.close(their_out)
    try:
        with os.fdopen(to, "wb") as into, os.fdopen(answers, "rb") as out:
            yield Tab(into, out)
    finally:
        browser.kill()
        browser.wait()
