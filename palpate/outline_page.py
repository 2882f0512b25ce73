"""A page on this machine on which instruments are outlined by strokes, followed through a clip, and saved."""

import json
import secrets
import threading
import webbrowser
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from palpate.common.files import as_json
from palpate.data.masks.outlining import OutlineSession


class OutlinePage:
    """Server of the page until it is closed; a notebook shows it in a cell.

    Args:
        clip: a video file or a folder of frames.
        output: YAML file that `--masks` reads; outlines that it holds are shown and go on.
        port: of 127.0.0.1; 0 = a free one.

    Raises:
        InputError: the clip or the file can't be used.
        OSError: the port is taken.
    """

    def __init__(self, clip: str | Path, output: str | Path, port: int = 0) -> None:
        secret = secrets.token_urlsafe(12)
        self.session = OutlineSession(Path(clip), Path(output))
        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), _handler(self.session, f"/{secret}/"))
        except OSError:
            self.session.close()
            raise
        self.url = f"http://127.0.0.1:{self._server.server_port}/{secret}/"
        """Address of the page, which nobody can guess."""
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="720"></iframe>'

    def open(self) -> None:
        """Show the page in a browser, and wait until Ctrl-C."""
        webbrowser.open(self.url)
        threading.Event().wait()

    def close(self) -> None:
        """Stop serving; what was saved stays."""
        self._server.shutdown()
        self._server.server_close()
        self.session.close()

    def __enter__(self) -> "OutlinePage":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _handler(session: OutlineSession, top: str) -> type[BaseHTTPRequestHandler]:
    """Return a handler that answers below a secret path alone."""
    asked: dict[str, Callable[..., Any]] = {"cut": session.cut, "follow": session.follow}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            name = self.path.removeprefix(top)
            if name == "":
                self._answer(200, "text/html; charset=utf-8", Path(__file__).with_suffix(".html").read_bytes())
            elif name == "state":
                self._answer(200, "application/json", as_json(session.state()).encode())
            elif name.isdecimal() and session.picture(int(name)).is_file():
                self._answer(200, "image/jpeg", session.picture(int(name)).read_bytes())
            else:
                self._answer(404, "text/plain", b"not found")

        def do_POST(self) -> None:
            name = self.path.removeprefix(top)
            given = self.rfile.read(int(self.headers["Content-Length"] or 0))
            try:
                self._answer(200, "application/json", as_json(asked[name](**json.loads(given))).encode())
            except (KeyError, TypeError, ValueError, OSError) as error:
                self._answer(400, "text/plain; charset=utf-8", str(error).encode())

        def _answer(self, status: int, kind: str, content: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            """Print nothing about requests."""

    return Handler
