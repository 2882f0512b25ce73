"""overlay.mp4: the clip with what was found drawn on it."""

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

from palpate.data.source.video import Video
from palpate.results import store
from palpate.results.artefacts.base import Artefact
from palpate.results.overlay import canvas_size, draw_overlay, panel_corner


class Overlay(Artefact):
    """Video whose pictures are drawn and coded in order in a thread of their own."""

    name, option, pictures = store.OVERLAY, "overlay", True

    def open(self) -> None:
        self._video = Video(self.path, canvas_size(self.clip.size), self.clip.fps, crf=23, fast=True)
        self._drawer = ThreadPoolExecutor(1, "overlay")
        self._corner = (0, 0)
        self._drawing: deque[Future[None]] = deque()

    def frame(self, estimate, image, labels) -> None:
        self._wait(3)
        self._drawing.append(self._drawer.submit(self._draw, estimate, image, labels))

    def _draw(self, estimate, image, labels) -> None:
        with self.clip.seconds.timed("overlay"):
            self._corner = panel_corner(labels, self._corner)
            self._video.write(draw_overlay(image, self.clip.size, labels, estimate, self._corner))

    def _wait(self, left: int) -> None:
        """Wait until so few pictures are left to be drawn."""
        while len(self._drawing) > left:
            self._drawing.popleft().result()

    def finish(self) -> None:
        self._wait(0)

    def close(self) -> None:
        self._drawer.shutdown()
        self._video.close()
